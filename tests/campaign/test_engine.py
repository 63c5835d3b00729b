"""Workers that are not there, not the same, or die."""

import contextlib
import errno
import gc
import os
import re
import signal
import stat
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

import distributed
import numba
import pytest

from palpate import __version__
from palpate.campaign import engine as engine_file, started_engine
from palpate.campaign.engine import Engine, WorkerError, worker_share
from palpate.errors import InputError, MeshError


@pytest.mark.parametrize("address", ["tls://127.0.0.1:9", "tls://127.0.0.1:no"])
def test_no_scheduler_at_that_address(address, monkeypatch):
    monkeypatch.setattr(engine_file, "_CONNECT_TIMEOUT", 1)
    expected = f"no scheduler answers at {re.escape(address)} .*start one with `dask scheduler`"
    with pytest.raises(InputError, match=expected), started_engine(address, None):
        pass
    # By type: asking a weak proxy of what is gone for its class raises.
    clients = [x for x in gc.get_objects() if issubclass(type(x), distributed.Client)]
    assert all(client.status == "closed" for client in clients)


def test_a_scheduler_without_workers(monkeypatch):
    monkeypatch.setattr(engine_file, "_FIRST_WORKER_TIMEOUT", 0.2)
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, protocol="tls", dashboard_address=":0"
        ) as cluster,
        pytest.raises(InputError, match=r"has no workers after 0.2 s; start some with `dask"),
        started_engine(cluster.scheduler_address, None),
    ):
        pass


@pytest.mark.parametrize(
    ("who", "package", "version", "said"),
    [
        ("scheduler", "distributed", "2021.1.0", "distributed 2021.1.0 instead of"),
        ("scheduler", "python", "3.9.2.final.0", "python 3.9.2.final.0 instead of"),
        ("worker", "palpate", None, f"Palpate not at all instead of {__version__}"),
        ("worker", "palpate", "0.0.7", f"Palpate 0.0.7 instead of {__version__}"),
    ],
)
def test_other_versions_are_refused(scheduler, monkeypatch, who, package, version, said):
    asked = distributed.Client.get_versions

    def answered(self, **options):
        engine = asked(self, **options)
        there = (
            engine["scheduler"] if who == "scheduler" else next(iter(engine["workers"].values()))
        )
        there["packages"][package] = version
        return engine

    monkeypatch.setattr(distributed.Client, "get_versions", answered)
    with pytest.raises(InputError) as raised, started_engine(scheduler, None):
        pass
    assert f"the {who} at tls://" in str(raised.value)
    assert said in str(raised.value)
    assert f"pip install 'palpate[batch]=={__version__}'" in str(raised.value)


def test_without_dask_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(InputError, match=r"pip install 'palpate\[batch\]'"),
        started_engine(None, 1),
    ):
        pass


class _Client:
    """A client whose every piece of work ends with an error."""

    status = "running"

    def __init__(self, error):
        self.error = error

    def nthreads(self):
        return {"worker": 1}

    def submit(self, *_, **__):
        return _Ended(self.error)

    def as_current(self):
        return contextlib.nullcontext()


class _Ended:
    """A future that has ended with an error."""

    status = "error"

    def __init__(self, error):
        self._error = error

    def exception(self):
        return self._error


class _Library:
    """Dask, as far as an engine calls it."""

    KilledWorker, CancelledError = distributed.KilledWorker, distributed.CancelledError

    @staticmethod
    def wait(futures, return_when):
        return SimpleNamespace(done=set(futures))


def _engine(error):
    return Engine(_Client(error), "tcp://there", _Library)


def _found(error):
    """What a piece of work gives that ends with an error."""
    workers = _engine(error)
    (future,) = workers.wait_for_ended([workers.submit(abs, -1)])
    return workers.result(future)


def test_a_worker_that_lost_the_package_ends_the_run():
    with pytest.raises(InputError, match="a worker at tcp://there has no Palpate"):
        _found(ModuleNotFoundError("No module named 'palpate'", name="palpate"))


def test_work_that_kills_its_workers_is_given_up():
    message = _found(distributed.KilledWorker("k", None, 3))
    assert isinstance(message, WorkerError)
    assert "every worker that took it died" in str(message)


@pytest.mark.slow
def test_work_beside_one_that_kills_its_workers_is_done(monkeypatch):
    monkeypatch.setitem(engine_file._SETTINGS, "distributed.scheduler.allowed-failures", 2)
    with started_engine(None, 2) as workers:
        deadly, after, good = (
            workers.submit(_killed, None), workers.submit(abs, -2), workers.submit(_slept, 0.1)
        )  # fmt: skip
        beside = workers.submit(max, [good, after])
        for future in (deadly, beside):
            workers.wait_for_ended([future])
        assert isinstance(workers.result(deadly), WorkerError)
        assert workers.result(beside) == 2


def _killed(_):
    os.kill(os.getpid(), signal.SIGKILL)


def test_an_error_of_the_program_is_said_to_be_one():
    message = _found(ZeroDivisionError("by\nzero"))
    assert str(message) == "an error of the program, not of yours (ZeroDivisionError: by zero)"


def test_a_worker_without_a_place_to_work_is_said_to_be_one():
    message = str(_found(OSError(errno.ENOSPC, "No space left on device", "worker/palpate")))
    assert message.startswith("an error of a worker's machine, not of yours (OSError: ")
    assert "No space left on device: 'worker/palpate'" in message


def test_an_error_of_the_user_comes_as_it_is():
    error = MeshError("it is open")
    assert _found(error) is error
    with pytest.raises(MeshError, match="it is open"):
        list(_engine(error).map(abs, [-1]))


@pytest.mark.slow
def test_mapped_work_comes_in_order_a_few_items_at_a_time():
    taken = []

    def items():
        for k in range(12):
            taken.append(k)
            yield 0.3 if k == 0 else -0.001 * k

    with started_engine(None, 2) as workers:
        results = workers.map(_slept, items())
        assert next(results) == 0.3
        # The others went on while the first one slept: four done and four to do, at the most.
        assert 1 < len(taken) <= 9
        assert list(results) == [-0.001 * k for k in range(1, 12)]
        assert list(workers.map(_slept, [])) == []


def _slept(item):
    time.sleep(max(item, 0.0))
    return item


@pytest.mark.slow
def test_a_cluster_of_ones_own_bounds_threads_and_memory():
    before = dict(os.environ)
    with started_engine(None, 2) as workers:
        assert workers.threads == 2
        threads = list(workers.map(_threads, range(4)))
        limits = [w["memory_limit"] for w in workers.client.scheduler_info()["workers"].values()]
        blocked = workers.client.run(_blocked_signals)
        folders = {Path(folder) for folder in workers.map(_folder, range(8))}
        assert all(f"{tempfile.gettempdir()}/palpate-workers-" in str(folder) for folder in folders)
        assert all(stat.S_IMODE(folder.parents[2].stat().st_mode) == 0o700 for folder in folders)
    assert not any(folder.parents[2].exists() for folder in folders)
    assert threads == [("1", "1", 1)] * 4
    # Ctrl-C reaches all processes; it is this one that stops the others.
    assert list(blocked.values()) == [{signal.SIGINT}] * 2
    assert signal.SIGINT not in _blocked_signals()
    assert dict(os.environ) == before
    assert sum(limits) <= 0.91 * distributed.system.MEMORY_LIMIT


def test_workers_of_another_cluster_have_a_folder_each(scheduler):
    with started_engine(scheduler, None) as workers:
        folders = set(workers.map(_folder, range(8)))
        configured = {
            worker["local_directory"]
            for worker in workers.client.scheduler_info()["workers"].values()
        }
    assert {str(Path(folder).parent) for folder in folders} <= configured


def _folder(_):
    return str(worker_share()[0])


def _threads(_):
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
    return (*(os.environ.get(name) for name in names), numba.get_num_threads())


@pytest.mark.slow
def test_this_process_compiles_beside_its_workers_and_after_them():
    """It measures pictures while workers render others, maybe for the first time: numba refuses to
    compile where the environment asks for another number of threads than were launched."""
    before = numba.get_num_threads()
    kernel = numba.njit(lambda x: x + 1)
    with started_engine(None, 1) as workers:
        assert kernel(1) == 2
        assert list(workers.map(abs, [-1])) == [1]
        assert kernel(1.0) == 2.0
        assert numba.get_num_threads() == before
    assert kernel(1j) == 1 + 1j
    assert numba.get_num_threads() == before


def _blocked_signals():
    return signal.pthread_sigmask(signal.SIG_BLOCK, [])


class _Gone:
    """A client whose scheduler has gone."""

    status = "closed"

    def nthreads(self):
        raise OSError("connection closed")


def test_a_scheduler_that_goes_away_is_said():
    workers = Engine(_Gone(), "tcp://there", distributed)
    said = "the scheduler at tcp://there does not answer any more; all results that had come are"
    with pytest.raises(InputError, match=said):
        assert workers.threads
    with pytest.raises(InputError, match=said):
        workers.submit(abs, -1)

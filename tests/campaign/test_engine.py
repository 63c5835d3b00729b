"""Workers that are not there, not the same, or die."""

import errno
import gc
import os
import re
import sys

import distributed
import numba
import pytest

from palpate import __version__
from palpate.campaign import FitOptions, Work, engine as engine_file, started_engine
from palpate.campaign.engine import Engine
from palpate.errors import InputError


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://here", "127.0.0.1:no"])
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
            n_workers=0, processes=False, protocol="tcp", dashboard_address=":0"
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
        found = asked(self, **options)
        there = found["scheduler"] if who == "scheduler" else next(iter(found["workers"].values()))
        there["packages"][package] = version
        return found

    monkeypatch.setattr(distributed.Client, "get_versions", answered)
    with pytest.raises(InputError) as raised, started_engine(scheduler, None):
        pass
    assert f"the {who} at tcp://" in str(raised.value)
    assert said in str(raised.value)
    assert f"pip install 'palpate[batch]=={__version__}'" in str(raised.value)


def test_without_dask_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(InputError, match=r"pip install 'palpate\[batch\]'"),
        started_engine(None, 1),
    ):
        pass


class _Ended:
    """A future that has ended with an error."""

    status = "error"

    def __init__(self, error):
        self._error = error

    def exception(self):
        return self._error


def _found(error, work):
    return Engine(None, "tcp://there", distributed)._outcome(_Ended(error), work)


def test_a_worker_that_lost_the_package_ends_the_run(packed_cube):
    work = Work("fit", packed_cube, FitOptions())
    with pytest.raises(InputError, match="a worker at tcp://there has no Palpate"):
        _found(ModuleNotFoundError("No module named 'palpate'", name="palpate"), work)


def test_work_that_kills_its_workers_is_given_up(packed_cube):
    work = Work("fit", packed_cube, FitOptions())
    workers = Engine(None, "tcp://there", distributed)
    dead = distributed.KilledWorker("k", None, 3)
    assert [workers._outcome(_Ended(dead), work) for _ in range(2)] == [None, None]
    assert "every worker that took it died" in workers._outcome(_Ended(dead), work).failure


def test_an_error_of_the_program_is_a_row(packed_cube):
    outcome = _found(ZeroDivisionError("by\nzero"), Work("fit", packed_cube, FitOptions()))
    assert outcome.failure == "an error of the program, not of yours (ZeroDivisionError: by zero)"


def test_a_worker_without_a_place_to_work_is_a_row(packed_cube):
    full = OSError(errno.ENOSPC, "No space left on device", "worker/palpate")
    outcome = _found(full, Work("fit", packed_cube, FitOptions()))
    assert outcome.failure.startswith("an error of a worker's machine, not of yours (OSError: ")
    assert "No space left on device: 'worker/palpate'" in outcome.failure


@pytest.mark.slow
def test_a_cluster_of_ones_own_bounds_threads_and_memory():
    before = dict(os.environ)
    with started_engine(None, 2) as workers:
        assert workers.threads == 2
        threads = workers.client.run(_threads)
        limits = [w["memory_limit"] for w in workers.client.scheduler_info()["workers"].values()]
    assert list(threads.values()) == [("1", "1", "1", 1)] * 2
    assert dict(os.environ) == before
    assert sum(limits) <= 0.91 * distributed.system.MEMORY_LIMIT


def _threads():
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
    return (*(os.environ.get(name) for name in names), numba.get_num_threads())


class _Gone:
    """A client whose scheduler has gone."""

    status = "closed"

    def nthreads(self):
        raise OSError("connection closed")


def test_a_scheduler_that_goes_away_is_said(packed_cube):
    workers = Engine(_Gone(), "tcp://there", distributed)
    said = "the scheduler at tcp://there does not answer any more; all results that had come are"
    with pytest.raises(InputError, match=said):
        assert workers.threads
    with pytest.raises(InputError, match=said):
        workers.submit(Work("fit", packed_cube, FitOptions()))
    assert not workers.is_busy

"""Workers of a campaign: a local cluster on this machine's cores, or a running Dask cluster.

Dask distributed starts, feeds and monitors them; the work of a worker that dies is given to another
one.
"""

import os
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

from palpate import __version__
from palpate.campaign.package import pack_files
from palpate.campaign.work import Outcome, Work, do_work
from palpate.errors import InputError
from palpate.optional_imports import late_import

# Timeouts for a scheduler to answer, and for the first worker to appear [s].
_CONNECT_TIMEOUT, _FIRST_WORKER_TIMEOUT = 10, 60
# Pieces of work queued per worker thread, so that none is idle.
_QUEUED_PER_THREAD = 2
# Number of times that Dask may give up on a piece of work, after several workers died, before it
# counts as failed.
_MAX_DEATHS = 3
# Fraction of the memory that is divided among the workers.
_USABLE_SHARE = 0.9
# Environment of the workers, set before libraries are loaded: one thread each.
_ONE_THREAD = {
    f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM")
}
_SETTINGS = {
    "distributed.nanny.pre-spawn-environ": _ONE_THREAD,
    # Pictures are sent with the work, so large messages are expected.
    "distributed.admin.large-graph-warning-threshold": "4 GiB",
    "distributed.comm.timeouts.connect": f"{_CONNECT_TIMEOUT}s",
}
_MATCHED_PACKAGES = ("python", "dask", "distributed")


@dataclass(slots=True, eq=False)
class Engine:
    """Connection to the workers.

    Attributes
    ----------
    client : distributed.Client
    address : str                   of the scheduler
    """

    client: Any
    address: str
    _library: ModuleType
    _submitted: dict[Any, Work] = field(default_factory=dict)
    _deaths: dict[str, int] = field(default_factory=dict)

    @property
    def has_room(self) -> bool:
        """Whether more work may be submitted; work that waits takes memory."""
        return len(self._submitted) < max(_QUEUED_PER_THREAD, _QUEUED_PER_THREAD * self.threads)

    @property
    def is_busy(self) -> bool:
        """Whether there is work that has not ended."""
        return bool(self._submitted)

    @property
    def threads(self) -> int:
        """Number of pieces of work that can run at the same time.

        Raises
        ------
        InputError                  the scheduler is gone
        """
        try:
            return sum(self.client.nthreads().values())
        except OSError as error:
            raise self._lost_scheduler() from error

    def submit(self, work: Work) -> None:
        """Submit a piece of work.

        Parameters
        ----------
        work : Work

        Raises
        ------
        InputError                  the scheduler is gone
        """
        if self.client.status not in ("running", "connecting"):
            raise self._lost_scheduler()
        # Not pure: identical work of another client must get a key of its own.
        future = self.client.submit(_work_on_worker, work, pure=False)
        self._submitted[future] = work

    def wait_for_ended(self) -> list[tuple[Work, Outcome]]:
        """Wait until at least one piece of work has ended.

        Returns
        -------
        list of (Work, Outcome)     all that have ended, in any order

        Raises
        ------
        InputError                  the scheduler is gone, or a worker lacks Palpate
        """
        try:
            with self.client.as_current():
                found = self._library.wait(list(self._submitted), return_when="FIRST_COMPLETED")
        except (OSError, self._library.CancelledError) as error:
            raise self._lost_scheduler() from error
        ended = []
        for future in found.done:
            work = self._submitted.pop(future)
            outcome = self._outcome(future, work)
            if outcome is None:
                self.submit(work)
            else:
                ended.append((work, outcome))
        return ended

    def _outcome(self, future: Any, work: Work) -> Outcome | None:
        """Outcome of a piece of work; None if it is to be tried again."""
        if future.status == "finished":
            found: Outcome = future.result()
            return found
        if future.status != "error":
            raise self._lost_scheduler()
        error = future.exception()
        if isinstance(error, ModuleNotFoundError) and str(error.name).startswith("palpate"):
            raise InputError(f"a worker at {self.address} has no Palpate; {_install_advice()}")
        if isinstance(error, self._library.KilledWorker):
            self._deaths[work.digest] = self._deaths.get(work.digest, 0) + 1
            if self._deaths[work.digest] < _MAX_DEATHS:
                return None
            text = (
                "every worker that took it died, as when memory runs out; use a coarser mesh, or"
                " workers with more memory"
            )
            return Outcome(pack_files({}), text, 0.0)
        text = " ".join(f"{type(error).__name__}: {error}".split())[:400]
        source = "a worker's machine" if isinstance(error, OSError) else "the program"
        return Outcome(pack_files({}), f"an error of {source}, not of yours ({text})", 0.0)

    def _lost_scheduler(self) -> InputError:
        return InputError(
            f"the scheduler at {self.address} does not answer any more; all results that had come"
            " are kept: start the same command again when it is back, and it goes on"
        )


def _work_on_worker(work: Work) -> Outcome:
    """Do a piece of work in the worker's own folder, within its share of the memory."""
    distributed = late_import("distributed", extra="batch", purpose="a campaign's worker")
    worker = distributed.get_worker()
    limit = worker.memory_manager.memory_limit
    share = None if not limit else limit / worker.state.nthreads
    return do_work(work, folder=Path(worker.local_directory) / "palpate", memory=share)


@contextmanager
def started_engine(scheduler: str | None, workers: int | None) -> Iterator[Engine]:
    """Connect to workers for the duration of the block.

    Parameters
    ----------
    scheduler : str or None         address of a running scheduler, `tcp://HOST:PORT`; None: start a
                                    cluster on this machine, which ends with the block
    workers : int or None           number of workers of that cluster; None: one per core

    Yields
    ------
    Engine

    Raises
    ------
    InputError                      Dask is not installed; no scheduler at that address; no worker;
                                    scheduler or worker with other versions, or without Palpate
    """
    library = late_import("distributed", extra="batch", purpose="a campaign")
    with ExitStack() as stack:
        stack.enter_context(_own_environment())
        settings = late_import("dask.config", extra="batch", purpose="a campaign")
        stack.enter_context(settings.set(_SETTINGS))
        # Versions are compared below, with a message of our own.
        stack.enter_context(warnings.catch_warnings(action="ignore"))
        if scheduler is None:
            folder = stack.enter_context(
                tempfile.TemporaryDirectory(prefix="palpate-workers-", ignore_cleanup_errors=True)
            )
            client = stack.enter_context(_local_client(library, workers or cores(), folder))
        else:
            client = stack.enter_context(_connected_client(library, scheduler))
        address = scheduler or str(client.scheduler.address)
        _check_workers(client, address)
        yield Engine(client, address, library)


@contextmanager
def _own_environment() -> Iterator[None]:
    """Restore the environment variables after the block. Dask sets those of its workers in our own
    process too, and numba refuses to compile once its number of threads has changed."""
    before = dict(os.environ)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def _local_client(library: ModuleType, workers: int, folder: str) -> Iterator[Any]:
    """A client of a local cluster of processes, each with one thread and an equal memory share."""
    share = int(_USABLE_SHARE * library.system.MEMORY_LIMIT / workers)
    with (
        library.LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, memory_limit=share,
            dashboard_address="127.0.0.1:0", local_directory=folder, silence_logs=50,
        ) as cluster,
        library.Client(cluster, set_as_default=False) as client,
    ):  # fmt: skip
        yield client


@contextmanager
def _connected_client(library: ModuleType, address: str) -> Iterator[Any]:
    """A client of a running scheduler."""
    try:
        # Check the address first: a client refuses it only when it is half constructed, and would
        # then be finalised by the garbage collector, where it may deadlock on Dask's global lock.
        library.comm.get_address_host_port(address)
        client = library.Client(address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        why = " ".join(str(error).split())[:200]
        raise InputError(
            f"no scheduler answers at {address} ({why}); start one with `dask scheduler` and give"
            " the address that it prints, as in tcp://192.168.1.7:8786"
        ) from error
    with client:
        yield client


def _check_workers(client: Any, address: str) -> None:
    """Refuse schedulers and workers whose versions differ from this machine's."""
    try:
        client.wait_for_workers(1, timeout=_FIRST_WORKER_TIMEOUT)
    except TimeoutError as error:
        raise InputError(
            f"the scheduler at {address} has no workers after {_FIRST_WORKER_TIMEOUT} s; start some"
            f" with `dask worker {address} --nworkers auto --nthreads 1`"
        ) from error
    found = client.get_versions(check=False, packages=["palpate"])
    ours = found["client"]["packages"]
    others = {f"the scheduler at {address}": found["scheduler"]} | {
        f"the worker at {name}": info for name, info in found["workers"].items()
    }
    for who, info in others.items():
        theirs = info["packages"] if info else {}
        wrong = [
            f"{name} {theirs.get(name) or 'not at all'} instead of {ours[name]}"
            for name in _MATCHED_PACKAGES
            if _comparable_version(name, theirs.get(name)) != _comparable_version(name, ours[name])
        ]
        if theirs.get("palpate") != __version__:
            wrong.append(
                f"Palpate {theirs.get('palpate') or 'not at all'} instead of {__version__}"
            )
        if wrong:
            raise InputError(f"{who} has {', '.join(wrong)}; {_install_advice()}")


def _comparable_version(name: str, version: str | None) -> str:
    """The part of a version that must agree: Python's without the last number, else all of it."""
    return ".".join((version or "").split(".")[:2]) if name == "python" else version or ""


def _install_advice() -> str:
    return (
        "install the same everywhere, scheduler and workers: pip install"
        f" 'palpate[batch]=={__version__}'"
    )

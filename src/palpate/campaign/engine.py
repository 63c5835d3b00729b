"""Work of a campaign: handed to workers, their results awaited.

Workers are a local cluster on this machine's cores, or a running Dask cluster. Dask distributed
feeds and monitors them; the work of one that dies is given to another one.
"""

import os
import signal
import tempfile
import warnings
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import islice
from multiprocessing import resource_tracker
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from palpate import __version__
from palpate.errors import InputError, PalpateError, quoted
from palpate.optional_imports import late_import
from palpate.threads import one_thread

S = TypeVar("S")
T = TypeVar("T")
# Items of a map that are taken per worker thread, before the first of them is given.
_TAKEN_PER_THREAD = 4
# Timeouts for a scheduler to answer, and for the first worker to appear [s].
_CONNECT_TIMEOUT, _FIRST_WORKER_TIMEOUT = 10, 60
# Workers per core: they wait for pictures, not for each other; more of them only share the memory.
_MAX_PER_CORE = 16
# Fraction of the memory that is divided among the workers; smallest share of a worker [bytes] where
# their number is not given: a fit of a fine mesh takes this much, a virtual probing less.
_USABLE_SHARE = 0.9
_LEAST_SHARE = 2 * 2**30
# Environment of the workers, set before libraries are loaded: one thread each. Dask sets it in this
# process, too, where numba would not compile any more: the engine limits numba in the workers.
_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "VECLIB_MAXIMUM")}
_SETTINGS = {
    "distributed.nanny.pre-spawn-environ": _ONE_THREAD,
    # Work that was only beside what killed a worker must not fail with it.
    "distributed.scheduler.allowed-failures": 9,
    # Pictures are sent with the work, so large messages are expected.
    "distributed.admin.large-graph-warning-threshold": "4 GiB",
    "distributed.comm.timeouts.connect": f"{_CONNECT_TIMEOUT}s",
    # Dask looks after itself less often: by default it takes 6 % of a core on two idle workers.
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.worker.memory.monitor-interval": "500ms",
    "distributed.worker.profile.enabled": False,
    # Scheduler and workers have a web server each, with sessions and logs for whoever asks: of ours
    # they have no pages.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
# Python starts processes that would first look for their modules in the current folder.
_NOT_FROM_THE_CURRENT_FOLDER = {"PYTHONSAFEPATH": "1"}
# What addresses begin with where both sides show a certificate.
_TLS = "tls://"
_MATCHED_PACKAGES = ("python", "dask", "distributed")


class WorkerError(PalpateError):
    """A piece of work that ended with an error which is not the user's: workers died of it, their
    machines failed, or the program has a defect."""


@dataclass(frozen=True, slots=True, eq=False)
class Engine:
    """Connection to the workers.

    Attributes
    ----------
    client : distributed.Client
    address : str                   of the scheduler
    """

    client: Any
    address: str
    _library: Any

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

    def submit(self, function: Callable[..., Any], *items: Any) -> Any:
        """Submit a piece of work, which begins when the futures in its arguments have ended.

        Parameters
        ----------
        function : callable         of a module of Palpate; runs on a worker, with one thread
        *items                      its arguments, which are sent to the worker: futures, lists of
                                    futures, anything else

        Returns
        -------
        distributed.Future

        Raises
        ------
        InputError                  the scheduler is gone
        """
        if self.client.status not in ("running", "connecting"):
            raise self._lost_scheduler()
        # Not pure: identical work of another client must get a key of its own.
        return self.client.submit(_work_on_worker, function, *items, pure=False)

    def wait_for_ended(self, futures: Iterable[Any]) -> Collection[Any]:
        """Wait until at least one of some futures has ended; gives all that have.

        Parameters
        ----------
        futures : iterable of Future

        Raises
        ------
        InputError                  the scheduler is gone
        """
        try:
            with self.client.as_current():
                return self._library.wait(list(futures), return_when="FIRST_COMPLETED").done
        except (OSError, self._library.CancelledError) as error:
            raise self._lost_scheduler() from error

    def result(self, future: Any) -> Any:
        """What a piece of work gave that has ended.

        Parameters
        ----------
        future : Future

        Returns
        -------
        any                         what the function returned, or a PalpateError that it raised; of
                                    another error, a `WorkerError`

        Raises
        ------
        InputError                  the scheduler is gone, or a worker lacks Palpate
        """
        if future.status == "finished":
            return future.result()
        if future.status != "error":
            raise self._lost_scheduler()
        error = future.exception()
        if isinstance(error, ModuleNotFoundError) and str(error.name).startswith("palpate"):
            raise InputError(f"a worker at {self.address} has no Palpate; {_install_advice()}")
        if isinstance(error, PalpateError):
            return error
        if isinstance(error, self._library.KilledWorker):
            return WorkerError(
                "every worker that took it died, as when memory runs out; use a coarser mesh, or"
                " workers with more memory"
            )
        text = " ".join(f"{type(error).__name__}: {error}".split())[:400]
        source = "a worker's machine" if isinstance(error, OSError) else "the program"
        return WorkerError(f"an error of {source}, not of yours ({text})")

    def map(self, function: Callable[[S], T], items: Iterable[S]) -> Iterator[T]:
        """Results of a function for independent items, in their order: `map`, on the workers.

        Parameters
        ----------
        function : callable         as in `submit`
        items : iterable            a few are taken at a time, so that they do not fill the memory

        Yields
        ------
        any                         results in the order of the items

        Raises
        ------
        PalpateError                the first that the function raised, in the order of the items
        WorkerError, InputError     as in `result`
        """
        left, waiting = iter(items), deque[Any]()
        limit = _TAKEN_PER_THREAD * max(1, self.threads)
        while True:
            waiting.extend(self.submit(function, x) for x in islice(left, limit - len(waiting)))
            if not waiting:
                return
            self.wait_for_ended([waiting[0]])
            result = self.result(waiting.popleft())
            if isinstance(result, PalpateError):
                raise result
            yield result

    def _lost_scheduler(self) -> InputError:
        return InputError(
            f"the scheduler at {self.address} does not answer any more; all results that had come"
            " are kept: start the same command again when it is back, and it goes on"
        )


def _work_on_worker(function: Callable[..., T], *items: Any) -> T:
    """Do a piece of work with one thread: one worker per core is more efficient than many threads
    in one."""
    with one_thread():
        return function(*items)


def worker_share() -> tuple[Path, float | None]:
    """Folder and share of the memory of the worker that runs this piece of work.

    Returns
    -------
    folder : Path                   its own, which need not exist
    memory : float or None [byte]   None: unlimited
    """
    distributed = late_import("distributed", extra="batch", purpose="a campaign's worker")
    worker = distributed.get_worker()
    limit = worker.memory_manager.memory_limit
    share = None if not limit else limit / worker.state.nthreads
    return Path(worker.local_directory) / "palpate", share


def _install_advice() -> str:
    """What to install on scheduler and workers, for messages."""
    return (
        "install the same everywhere, scheduler and workers: pip install"
        f" 'palpate[batch]=={__version__}'"
    )


def check_workers(scheduler: str | None, workers: int | None, *, insecure: bool = False) -> None:
    """Refuse a number of workers that is out of range, or given for a running scheduler, and a
    scheduler without TLS.

    Parameters
    ----------
    scheduler, workers, insecure    as in `started_engine`

    Raises
    ------
    InputError
    """
    limit = _MAX_PER_CORE * cores()
    if workers is not None and (scheduler is not None or not 1 <= workers <= limit):
        raise InputError(
            f"--workers is {workers}; must be 1 to {limit}, {_MAX_PER_CORE} for every core, and is"
            " for the cluster that the command starts itself, not for one with --scheduler"
        )
    if insecure and scheduler is None:
        raise InputError(
            "--insecure without --scheduler: the cluster that the command starts itself has TLS;"
            " leave --insecure out"
        )
    if scheduler is not None and not insecure and not scheduler.startswith(_TLS):
        raise InputError(
            f"the scheduler at {quoted(scheduler)} has no TLS: anybody who reaches it can run code"
            f" as you; start it with certificates and give {_TLS}HOST:PORT, or add --insecure where"
            " you trust everybody who can reach it"
        )


@contextmanager
def started_engine(
    scheduler: str | None, workers: int | None, *, insecure: bool = False
) -> Iterator[Engine]:
    """Connect to workers for the duration of the block.

    Parameters
    ----------
    scheduler : str or None         address of a running scheduler, `tls://HOST:PORT`, with the
                                    certificates of Dask's configuration; None: start a cluster on
                                    this machine, which ends with the block; its certificate is made
                                    for it, and nobody else has it
    workers : int or None           number of workers of that cluster; None: one per core, fewer
                                    where each would have less than 2 GiB of memory
    insecure : bool                 accept an address without TLS, `tcp://HOST:PORT`: anybody who
                                    reaches the scheduler can then run code as this user

    Yields
    ------
    Engine

    Raises
    ------
    InputError                      Dask is not installed; as `check_workers`; no certificates; no
                                    scheduler at that address; no worker; scheduler or worker with
                                    other versions, or without Palpate
    """
    check_workers(scheduler, workers, insecure=insecure)
    library = late_import("distributed", extra="batch", purpose="a campaign")
    with ExitStack() as stack:
        stack.enter_context(_own_environment())
        settings = late_import("dask.config", extra="batch", purpose="a campaign")
        stack.enter_context(settings.set(_SETTINGS))
        # Versions are compared below, with a message of our own.
        stack.enter_context(warnings.catch_warnings(action="ignore"))
        if scheduler is None:
            client = stack.enter_context(_local_client(library, workers))
        else:
            client = stack.enter_context(_connected_client(library, scheduler))
        address = scheduler or str(client.scheduler.address)
        _check_workers(client, address)
        yield Engine(client, address, library)


@contextmanager
def _own_environment() -> Iterator[None]:
    """Environment variables of the processes that the block starts. All are restored after it: Dask
    sets those of its workers in our own process too."""
    before = dict(os.environ)
    os.environ.update(_NOT_FROM_THE_CURRENT_FOLDER)
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
def _local_client(library: ModuleType, workers: int | None) -> Iterator[Any]:
    """A client of a local cluster of processes, each with one thread and an equal memory share."""
    usable = int(_USABLE_SHARE * library.system.MEMORY_LIMIT)
    count = workers or max(1, min(cores(), usable // _LEAST_SHARE))
    late_import("cryptography", extra="batch", purpose="a certificate of the workers")
    with ExitStack() as stack:
        # A folder of this user alone: by default Dask takes one that another user may have made.
        folder = stack.enter_context(
            tempfile.TemporaryDirectory(prefix="palpate-workers-", ignore_cleanup_errors=True)
        )
        with _interrupts_held_back():
            cluster = stack.enter_context(library.LocalCluster(
                n_workers=count, threads_per_worker=1, processes=True, memory_limit=usable // count,
                dashboard_address="127.0.0.1:0", scheduler_kwargs={"dashboard": False},
                security=library.Security.temporary(), local_directory=folder, silence_logs=50,
            ))  # fmt: skip
        yield stack.enter_context(library.Client(cluster, set_as_default=False))


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Block SIGINT for the duration of the block, and for good in threads and processes that start
    in it: Ctrl-C reaches all of them at once, and workers are stopped by this process."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Its start unblocks SIGINT in the thread that starts the first process.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _connected_client(library: ModuleType, address: str) -> Iterator[Any]:
    """A client of a running scheduler; with TLS every connection has it, those to workers too."""
    try:
        security = library.Security(require_encryption=address.startswith(_TLS))
        # Check certificates and address first: a client refuses them only when it is half
        # constructed, and would then be finalised by the garbage collector, where it may deadlock
        # on Dask's global lock.
        if (
            security.require_encryption
            and not security.get_connection_args("client")["ssl_context"]
        ):
            raise ValueError("no certificate is named")
        library.comm.get_address_host_port(address)
        client = library.Client(
            address, timeout=_CONNECT_TIMEOUT, set_as_default=False, security=security
        )
    except (OSError, ValueError, TypeError) as error:
        why = " ".join(str(error).split())[:200]
        raise InputError(
            f"no scheduler answers at {address} ({why}); start one with `dask scheduler`, give the"
            " address that it prints, as in tls://192.168.1.7:8786, and name the certificates in"
            " Dask's configuration, at distributed.comm.tls"
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
    versions = client.get_versions(check=False, packages=["palpate"])
    ours = versions["client"]["packages"]
    others = {f"the scheduler at {address}": versions["scheduler"]} | {
        f"the worker at {name}": info for name, info in versions["workers"].items()
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

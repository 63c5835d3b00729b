"""Work of a campaign: handed to workers, their results awaited.

Workers are a local cluster on this machine's cores, or a running Dask cluster. Dask distributed
feeds and monitors them; the work of one that dies is given to another one.
"""

import os
import shutil
import signal
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from palpate import __version__
from palpate.disk import is_abandoned, release_lock, take_lock
from palpate.errors import InputError, PalpateError, quoted
from palpate.optional_imports import late_import
from palpate.threads import one_thread

S = TypeVar("S")
T = TypeVar("T")
# Pieces of work queued per worker thread, so that none is idle.
_QUEUED_PER_THREAD = 2
# Name of the temporary folder of a local cluster, in which Dask has one for all workers, and in
# that one for each; all of it is removed with the cluster.
_LOCAL_FOLDER_PREFIX = "palpate-workers-"
# Number of times that Dask may give up on a piece of work, after several workers died, before it
# counts as failed.
_MAX_DEATHS = 3
# Timeouts for a scheduler to answer, and for the first worker to appear [s].
_CONNECT_TIMEOUT, _FIRST_WORKER_TIMEOUT = 10, 60
# In the folder of local workers, which holds gigabytes: the lock of the command they are of.
_LOCK_NAME = ".lock"
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


@dataclass(slots=True, eq=False)
class _Task:
    """A function and its argument; `deaths`: how often Dask gave up on it."""

    function: Callable[[Any], Any]
    item: Any
    deaths: int = 0


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
    _library: Any
    _submitted: dict[Any, _Task] = field(default_factory=dict)

    @property
    def has_room(self) -> bool:
        """Whether more work may be submitted; work that waits takes memory."""
        return len(self._submitted) < self._limit

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

    @property
    def _limit(self) -> int:
        """Number of items that may wait, before or after they are done."""
        return _QUEUED_PER_THREAD * max(1, self.threads)

    def submit(self, function: Callable[[S], T], item: S) -> None:
        """Submit a piece of work.

        Parameters
        ----------
        function : callable         of a module of Palpate; runs on a worker, with one thread
        item : any                  its argument, which is sent to the worker

        Raises
        ------
        InputError                  the scheduler is gone
        """
        self._submit(_Task(function, item))

    def wait_for_ended(self) -> list[tuple[Any, Any]]:
        """Wait until at least one piece of work has ended.

        Returns
        -------
        list of (item, result)      all that have ended, in any order; the result is what the
                                    function returned, the PalpateError that it raised, or a
                                    `WorkerError`

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
            task = self._submitted.pop(future)
            if future.status == "error" and self._gave_up(future, task):
                self._submit(task)
            else:
                ended.append((task.item, self._result(future, task)))
        return ended

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
        WorkerError                 as in `wait_for_ended`
        """
        waiting, results = enumerate(items), dict[int, Any]()
        number, all_taken = 0, False
        while not all_taken or self.is_busy or results:
            while not all_taken and self.has_room and len(results) < self._limit:
                task = next(waiting, None)
                all_taken = task is None
                if task is not None:
                    self.submit(_numbered, (function, *task))
            if self.is_busy:
                results |= {item[1]: result for item, result in self.wait_for_ended()}
            while number in results:
                result = results.pop(number)
                if isinstance(result, Exception):
                    raise result
                yield result
                number += 1

    def _submit(self, task: _Task) -> None:
        if self.client.status not in ("running", "connecting"):
            raise self._lost_scheduler()
        # Not pure: identical work of another client must get a key of its own.
        future = self.client.submit(_work_on_worker, task.function, task.item, pure=False)
        self._submitted[future] = task

    def _gave_up(self, future: Any, task: _Task) -> bool:
        """Whether Dask gave up on a task because its workers died, and it is worth another try."""
        killed = isinstance(future.exception(), self._library.KilledWorker)
        task.deaths += killed
        return killed and task.deaths < _MAX_DEATHS

    def _result(self, future: Any, task: _Task) -> Any:
        """What a task gave: a result, or an error."""
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

    def _lost_scheduler(self) -> InputError:
        return InputError(
            f"the scheduler at {self.address} does not answer any more; all results that had come"
            " are kept: start the same command again when it is back, and it goes on"
        )


def _numbered(task: tuple[Callable[[S], T], int, S]) -> T:
    """Apply a function of `Engine.map` to its item; the number is for the engine."""
    function, _, item = task
    return function(item)


def _work_on_worker(function: Callable[[S], T], item: S) -> T:
    """Do a piece of work with one thread: one worker per core is more efficient than many threads
    in one."""
    with one_thread():
        return function(item)


def worker_share() -> tuple[Path, float | None]:
    """Folder and share of the memory of the worker that runs this piece of work.

    Returns
    -------
    folder : Path                   its own, or that of all workers of a local cluster; need not
                                    exist
    memory : float or None [byte]   None: unlimited
    """
    distributed = late_import("distributed", extra="batch", purpose="a campaign's worker")
    worker = distributed.get_worker()
    limit = worker.memory_manager.memory_limit
    share = None if not limit else limit / worker.state.nthreads
    own = Path(worker.local_directory)
    is_local = own.parents[1].name.startswith(_LOCAL_FOLDER_PREFIX)
    return (own.parent if is_local else own) / "palpate", share


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
            folder = stack.enter_context(_workers_folder())
            client = stack.enter_context(_local_client(library, workers, folder))
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


@contextmanager
def _workers_folder() -> Iterator[str]:
    """A temporary folder for the workers; those of commands that were killed are removed."""
    for other in Path(tempfile.gettempdir()).glob(f"{_LOCAL_FOLDER_PREFIX}*"):
        if is_abandoned(other / _LOCK_NAME):
            shutil.rmtree(other, ignore_errors=True)
    folder = Path(tempfile.mkdtemp(prefix=_LOCAL_FOLDER_PREFIX))
    lock = folder / _LOCK_NAME
    handle = take_lock(lock, folder)
    try:
        yield str(folder)
    finally:
        _remove_all_but(lock)
        # A worker that is being stopped may still write. The lock is left, then: the next command
        # takes the folder for what it is.
        if os.listdir(folder) == [_LOCK_NAME]:
            release_lock(lock, handle)
            folder.rmdir()
        else:
            os.close(handle)


def _remove_all_but(file: Path) -> None:
    """Remove what lies beside a file, as far as possible."""
    for path in file.parent.iterdir():
        if path != file:
            shutil.rmtree(path, ignore_errors=True)


def cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def _local_client(library: ModuleType, workers: int | None, folder: str) -> Iterator[Any]:
    """A client of a local cluster of processes, each with one thread and an equal memory share."""
    usable = int(_USABLE_SHARE * library.system.MEMORY_LIMIT)
    count = workers or max(1, min(cores(), usable // _LEAST_SHARE))
    late_import("cryptography", extra="batch", purpose="a certificate of the workers")
    with ExitStack() as stack:
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

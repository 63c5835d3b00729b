"""Work of a campaign: handed to workers, their results awaited.

Dask distributed feeds and monitors the workers; the work of one that dies is given to another one.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from palpate import __version__
from palpate.errors import InputError, PalpateError
from palpate.optional_imports import late_import
from palpate.threads import one_thread

S = TypeVar("S")
T = TypeVar("T")

# Pieces of work queued per worker thread, so that none is idle.
_QUEUED_PER_THREAD = 2
# Name of the temporary folder of a local cluster, in which Dask has one for all workers, and in
# that one for each; all of it is removed with the cluster.
LOCAL_FOLDER_PREFIX = "palpate-workers-"
# Number of times that Dask may give up on a piece of work, after several workers died, before it
# counts as failed.
_MAX_DEATHS = 3


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
            raise InputError(f"a worker at {self.address} has no Palpate; {install_advice()}")
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
    is_local = own.parents[1].name.startswith(LOCAL_FOLDER_PREFIX)
    return (own.parent if is_local else own) / "palpate", share


def install_advice() -> str:
    """What to install on scheduler and workers, for messages."""
    return (
        "install the same everywhere, scheduler and workers: pip install"
        f" 'palpate[batch]=={__version__}'"
    )

"""Loops over independent items, run in several threads or processes at once."""

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

import numba
from threadpoolctl import ThreadpoolController

T = TypeVar("T")

# Results of a function for independent items, in their order: the builtin `map`, or one that
# computes several at a time, in other processes or on other machines, and pickles both.
Distribute = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]

# Ranges per thread: items that take longer than others delay the end by one range at most.
_RANGES_PER_THREAD = 4
# Rows of a matrix from which linear algebra gains by several threads.
_LARGE = 3000


def in_threads(
    kernel: Callable[..., None], count: int, *arguments: Any, min_items: int = 1
) -> None:
    """Call `kernel(start, stop, *arguments)` for ranges that together cover 0 to `count`.

    Uses `numba.get_num_threads()` threads. The kernel must be compiled with `nogil=True` and write
    only the entries of its own range; the result then does not depend on the number of threads. A
    numba parallel loop would do the same, but takes up to three times as long to compile, because
    its body is optimised again for every enclosing loop.

    Parameters
    ----------
    kernel : callable
    count : int             number of items
    *arguments              further arguments of the kernel, after its range
    min_items : int         least number of items for which a range of its own pays
    """
    # Compile the kernel, if necessary, before several threads call it at once.
    kernel(0, 0, *arguments)
    threads = numba.get_num_threads()
    ranges = min(_RANGES_PER_THREAD * threads, count // min_items)
    if threads == 1 or ranges <= 1:
        kernel(0, count, *arguments)
        return
    bounds = [count * i // ranges for i in range(ranges + 1)]
    remaining = iter(list(itertools.pairwise(bounds)))

    def work() -> None:
        for start, stop in remaining:
            kernel(start, stop, *arguments)

    # This thread works, too: starting another takes as long as a small kernel.
    helpers = min(threads, ranges) - 1
    with ThreadPoolExecutor(helpers) as pool:
        helping = [pool.submit(work) for _ in range(helpers)]
        work()
    for helper in helping:
        helper.result()


def map_in_threads(function: Callable[..., T], *items: Iterable[Any]) -> Iterator[T]:
    """Results of a function for independent items, in their order; as `map`, but several at once.

    Uses `numba.get_num_threads()` threads. It pays where a call spends its time in OpenCV or in
    numpy on large arrays, which let other threads work.

    Parameters
    ----------
    function : callable
    *items : iterables      of its arguments, equally long

    Yields
    ------
    any                     results in the order of the items
    """
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        yield from pool.map(function, *items)


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit numba to one thread for the duration of the block."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)


@contextmanager
def serial_algebra() -> Iterator[None]:
    """Limit linear algebra to one thread for the duration of the block.

    The libraries of numpy and scipy have threads of their own, as many each as there are cores. For
    the small matrices of an estimate they wait for each other, busily: twice the processor time for
    a whole fit, and several times the time where other programs run.
    """
    controller, _ = _linear_algebra()
    with controller.limit(limits=1):
        yield


@contextmanager
def parallel_algebra(rows: int) -> Iterator[None]:
    """Give linear algebra its threads back for the duration of the block, if that pays.

    Parameters
    ----------
    rows : int              of the matrix
    """
    controller, threads = _linear_algebra()
    if rows < _LARGE:
        yield
        return
    with controller.limit(limits=threads):
        yield


@functools.cache
def _linear_algebra() -> tuple[ThreadpoolController, int]:
    """The libraries in use, and the threads that they began with."""
    controller = ThreadpoolController().select(user_api="blas")
    return controller, max((library["num_threads"] for library in controller.info()), default=1)

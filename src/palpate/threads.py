"""Loops over things that do not depend on each other, in several threads at once."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba

# Ranges for each thread: things that take longer than others delay the end by one range at most.
_RANGES = 4


def in_threads(kernel: Callable[..., None], count: int, *arguments: Any, fewest: int = 1) -> None:
    """Call `kernel(start, stop, *arguments)` for ranges that together are 0 to `count`.

    As many threads as `numba.get_num_threads()` says. The kernel is compiled with `nogil=True`
    and writes only what belongs to the things of its range, so the result does not depend on the
    number of threads. A parallel loop of numba would do the same, but takes up to three times as
    long to compile: it optimises its body again for every layer around it.

    Parameters
    ----------
    kernel : callable
    count : int
    *arguments              what the kernel takes after its range
    fewest : int            things that are worth a range of their own
    """
    # Compiles the kernel, where that is still to be done, before several threads ask for it.
    kernel(0, 0, *arguments)
    threads = numba.get_num_threads()
    ranges = min(_RANGES * threads, count // fewest)
    if threads == 1 or ranges <= 1:
        kernel(0, count, *arguments)
        return
    bounds = [count * i // ranges for i in range(ranges + 1)]
    with ThreadPoolExecutor(min(threads, ranges)) as pool:
        done = pool.map(lambda a, b: kernel(a, b, *arguments), bounds[:-1], bounds[1:])
        for _ in done:
            pass

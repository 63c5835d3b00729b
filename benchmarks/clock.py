"""Wall times on a machine that does other things too."""

import time
from collections.abc import Callable


def shortest(work: Callable[[], object], *, repeats: int = 3, warm: bool = True) -> float:
    """Shortest wall time [s] of several runs: what disturbs a run only ever makes it longer.

    Parameters
    ----------
    work : callable
    repeats : int
    warm : bool               True: one run before, not counted (compilation, caches)
    """
    seconds = []
    for _ in range(repeats + warm):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return min(seconds[warm:])

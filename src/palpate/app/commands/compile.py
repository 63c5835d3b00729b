"""`palpate compile`: the kernels of this machine, before they are needed."""

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from numba.core import event

from palpate.app.terminal import print_text, progress_bar
from palpate.pipeline import rehearse_fit, rehearse_flow


def compile_kernels() -> int:
    """Compile the kernels of the flow and the fit for this machine, once after installing.

    Without it the first measurement does. Where they are up to date already, nothing changes.

    Returns
    -------
    int
    """
    start = time.perf_counter()
    rehearsals = (rehearse_flow, rehearse_fit)
    # Each in a process of its own: a compiler has one lock.
    with (
        progress_bar() as progress,
        ProcessPoolExecutor(len(rehearsals), mp_context=get_context("spawn")) as processes,
    ):
        progress("kernels of the flow and the fit", 0.0)
        compiled = sum(processes.map(_compiled, rehearsals))
    seconds = time.perf_counter() - start
    if compiled:
        print_text(f"{compiled} kernels compiled in {seconds:.0f} s: the first fit need not wait")
    else:
        print_text("all kernels of the flow and the fit were up to date")
    return 0


def _compiled(rehearsal: Callable[[], None]) -> int:
    """Number of kernels that a rehearsal had to compile."""
    # Once: the list of fonts, which the pictures of a result are drawn with, takes seconds, too.
    import matplotlib.font_manager  # noqa: F401, PLC0415

    with event.install_recorder("numba:compile") as recorder:
        rehearsal()
    return sum(each.is_start for _, each in recorder.buffer)

"""`palpate compile`: the kernels of this machine, before they are needed."""

import time
from importlib import import_module

from numba.core import event

from palpate.app.environment import check_kernel_cache
from palpate.app.terminal.output import print_text
from palpate.app.terminal.progress import progress_bar
from palpate.pipeline import warm_up


def compile_kernels() -> int:
    """Compile the numerical kernels once, so that the first fit need not wait.

    Otherwise the first measurement compiles them. Does nothing if they are up to date.

    Returns
    -------
    int
    """
    check_kernel_cache()
    start = time.perf_counter()
    with progress_bar() as progress, event.install_recorder("numba:compile") as recorder:
        warm_up(progress)
        progress("the list of fonts", 0.99)
        # The figures of a result need it; it takes seconds, once, too.
        import_module("matplotlib.font_manager")
    compiled = sum(each.is_start for _, each in recorder.buffer)
    seconds = time.perf_counter() - start
    if compiled:
        print_text(f"{compiled} kernels compiled in {seconds:.0f} s: the first fit need not wait")
    else:
        print_text("all kernels of the flow and the fit were up to date")
    return 0

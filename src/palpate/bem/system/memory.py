"""What a model takes in memory, said before it is built."""

import os

from palpate.errors import InputError

# Doubles per pair of vertices: nine fields, the matrix of three by three, four fields of its slope.
DOUBLES_A_PAIR = 22
USABLE_SHARE = 0.9


def check_memory(n_vertices: int, *, available: float | None = None) -> None:
    """Refuse a mesh whose dense matrices do not fit.

    Parameters
    ----------
    n_vertices : int
    available : float [byte]          memory of the machine; None: asked of the system, unlimited
                                      where it does not tell

    Raises
    ------
    InputError                        more memory is needed than there is
    """
    needed = 8.0 * DOUBLES_A_PAIR * n_vertices**2
    usable = USABLE_SHARE * (_physical_memory() if available is None else available)
    if needed > usable:
        most = int((usable / (8.0 * DOUBLES_A_PAIR)) ** 0.5) // 100 * 100
        raise InputError(
            f"the mesh has {n_vertices} vertices, whose model needs {needed / 1e9:.0f} GB of "
            f"memory; {usable / 1e9:.1f} GB can be used here: simplify the surface to at most "
            f"{most} vertices (1000 to 3000 serve most objects)"
        )


def _physical_memory() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE")) * float(os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return float("inf")

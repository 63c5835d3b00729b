"""Memory that the model of an object needs, dense or compressed, checked before it is built."""

import os
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

from palpate.errors import InputError

try:
    import resource
except ModuleNotFoundError:  # Windows has no such limits
    resource = None  # type: ignore[assignment]

# The program and its libraries [bytes].
_PROGRAM = 0.4e9
# Doubles per pair of vertices: nine of the matrix and four of its slope, and a fifth more for a
# support on an eighth of the surface, whose vertices have several unknowns; for rollers the matrix
# twice. Each further factorisation that is held at the same time takes another matrix.
_DOUBLES_PER_PAIR, _DOUBLES_PER_PAIR_WITH_ROLLERS, _DOUBLES_PER_FACTORS = 16, 27, 11
# Vectors of unknowns that are kept for each of a probing's three directions of force and three
# changes of its contact: right-hand sides, at most 80 basis vectors of the reduced model, and what
# is needed to find the next one.
_VECTORS_PER_COLUMN = 90
_COLUMNS_PER_PROBING = 6
# Above this many vertices a compressed operator takes less time than dense matrices, and far less
# memory; it handles only rigid supports that hold all directions.
LARGEST_DENSE = 5000
# Memory of the operator and its preconditioners per vertex [bytes], and vectors per column that the
# iteration and the reduced basis keep.
_BYTES_PER_VERTEX = 170e3
_COMPRESSED_VECTORS_PER_COLUMN = 110
_USABLE_FRACTION = 0.9
# A surface of fewer vertices does not represent an object: other cures are offered then.
_MIN_VERTICES = 100
# Files in which Linux states the memory limit of a container.
_CONTAINER_LIMITS = (
    Path("/sys/fs/cgroup/memory.max"),
    Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"),
)


def check_memory(
    n_vertices: int,
    n_probings: int = 1,
    *,
    rollers: bool = False,
    dense: bool = False,
    n_factors: int = 1,
    available: float | None = None,
) -> None:
    """Refuse a mesh whose model does not fit into memory.

    Parameters
    ----------
    n_vertices : int
    n_probings : int                  probings fitted together, or pushes predicted
    rollers : bool                    whether a support holds some directions only
    dense : bool                      whether dense matrices are required at any size: for compliant
                                      supports, for Green's functions
    n_factors : int                   factorisations held at the same time
    available : float [byte]          memory of the machine; None: that reported by the operating
                                      system, unlimited if it reports none

    Raises
    ------
    InputError                        more than 90 % of the available memory is needed
    """
    needed_for = partial(
        memory_needed, n_probings=n_probings, rollers=rollers, dense=dense, n_factors=n_factors
    )
    needed = needed_for(n_vertices)
    usable = _USABLE_FRACTION * (_machine_memory() if available is None else available)
    if needed > usable:
        model = "model needs"
        if rollers or dense:
            model = "dense matrices (as supports that roll or give take them) need"
        max_vertices = _max_vertices(needed_for, usable)
        cure = (
            f"simplify the surface to at most {max_vertices} vertices in a mesh program (decimate,"
            " remesh; 1000 to 3000 serve most objects)"
        )
        if max_vertices < _MIN_VERTICES:
            fewer = "choose fewer probings (--probe), or " if n_probings > 1 else ""
            cure = f"{fewer}decimate the surface, or use a machine with more memory"
        raise InputError(
            f"the mesh has {n_vertices} vertices, whose {model} {needed / 1e9:.1f} GB of"
            f" memory {_for(n_probings)}; {usable / 1e9:.1f} GB can be used here: {cure}"
        )


def memory_needed(
    n_vertices: int,
    n_probings: int,
    *,
    rollers: bool = False,
    dense: bool = False,
    n_factors: int = 1,
) -> float:
    """Peak memory of a fit of some probings.

    Parameters
    ----------
    n_vertices : int
    n_probings : int
    rollers, dense, n_factors         see `check_memory`

    Returns
    -------
    float [byte]
    """
    columns = 3.0 * n_vertices * _COLUMNS_PER_PROBING * n_probings
    if n_vertices > LARGEST_DENSE and not rollers and not dense:
        return (
            _PROGRAM
            + _BYTES_PER_VERTEX * n_vertices
            + 8.0 * _COMPRESSED_VECTORS_PER_COLUMN * columns
        )
    doubles = _DOUBLES_PER_PAIR_WITH_ROLLERS if rollers else _DOUBLES_PER_PAIR
    doubles += (n_factors - 1) * _DOUBLES_PER_FACTORS
    return _PROGRAM + 8.0 * (doubles * float(n_vertices) ** 2 + _VECTORS_PER_COLUMN * columns)


def _for(n_probings: int) -> str:
    return "for one probing" if n_probings == 1 else f"for {n_probings} probings"


def _max_vertices(needed_for: Callable[[int], float], usable: float) -> int:
    """The largest number of vertices that fits, in hundreds; zero: none.

    Memory grows up to the largest dense mesh, drops there, and grows again.
    """
    for low, high in ((LARGEST_DENSE, 10_000_000), (0, LARGEST_DENSE + 1)):
        first = low
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if needed_for(middle) <= usable else (low, middle)
        if low > first:
            return low // 100 * 100
    return 0


def _machine_memory() -> float:
    """Memory that this process may use at most [bytes]."""
    limits = [float("inf")]
    with suppress(AttributeError, OSError, ValueError):
        limits.append(float(os.sysconf("SC_PAGE_SIZE")) * float(os.sysconf("SC_PHYS_PAGES")))
    for path in _CONTAINER_LIMITS:
        # The file reads "max" where there is no limit.
        with suppress(OSError, ValueError):
            limits.append(float(path.read_text(encoding="ascii")))
    if resource is not None:
        limits += [float(n) for n in resource.getrlimit(resource.RLIMIT_AS)[:1] if n > 0]
    return min(limits)

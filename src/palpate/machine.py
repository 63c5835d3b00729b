"""What this machine has for a piece of work, and the refusal of work that needs more."""

import os
import shutil
from contextlib import suppress
from pathlib import Path

from palpate.errors import InputError

try:
    import resource
except ModuleNotFoundError:  # Windows has no such limits
    resource = None  # type: ignore[assignment]
# Files in which Linux states the memory limit of a container.
_CONTAINER_LIMITS = (
    Path("/sys/fs/cgroup/memory.max"),
    Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"),
)
# Of memory and disk: the system and other programs need some, too.
_USABLE = 0.9


def machine_memory() -> float:
    """Memory that this process may use at most [bytes]; infinite where the system reports none."""
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


def usable_memory(available: float | None = None) -> float:
    """The part of the memory that a piece of work may take [bytes].

    Parameters
    ----------
    available : float or None [byte]    None: all of the machine's
    """
    return _USABLE * (machine_memory() if available is None else available)


def free_disk(folder: Path) -> float:
    """What is free on the disk of a folder [bytes]; infinite if the system does not say.

    Parameters
    ----------
    folder : Path                   must exist
    """
    try:
        return float(shutil.disk_usage(folder).free)
    except OSError:
        return float("inf")


def check_memory_for(
    what: str, needed: float, cure: str, *, available: float | None = None
) -> None:
    """Refuse work that does not fit into memory, before it begins.

    Parameters
    ----------
    what : str                      the work, subject of a sentence: "4 million points"
    needed : float [byte]           peak of the memory
    cure : str                      what to do instead
    available : float or None       as in `usable_memory`

    Raises
    ------
    InputError                      90 % of the available memory are less
    """
    _check(what, needed, usable_memory(available), "memory", cure)


def check_disk_for(what: str, needed: float, cure: str, folder: Path) -> None:
    """Refuse work whose files do not fit on a disk, before it begins.

    Parameters
    ----------
    what, cure : str                as in `check_memory_for`
    needed : float [byte]           size of all files
    folder : Path                   existing folder on that disk

    Raises
    ------
    InputError                      90 % of what is free are less
    """
    _check(what, needed, _USABLE * free_disk(folder), f"disk in {folder}", cure)


def _check(what: str, needed: float, usable: float, kind: str, cure: str) -> None:
    if needed > usable:
        raise InputError(
            f"{what} would take {_size(needed)} of {kind}; {_size(usable)} can be used here: {cure}"
        )


def _size(number: float) -> str:
    return f"{number / 1e9:.1f} GB" if number > 1e8 else f"{number / 1e6:.1f} MB"

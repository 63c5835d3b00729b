"""Progress callbacks of long computations: the current step, and the fraction completed."""

from collections.abc import Callable

# Called with the current step (text) and the fraction of the work that is done, 0 to 1.
Progress = Callable[[str, float], None]


def silent(_text: str, _fraction: float) -> None:
    """Progress callback that ignores its arguments."""


def part_of(progress: Progress, begin: float, end: float, *, prefix: str = "") -> Progress:
    """Progress callback for one part of the work, mapped to progress of the whole.

    Parameters
    ----------
    progress : callable             progress callback of the whole
    begin, end : float              fractions of the whole at which the part begins and ends, 0 to 1
    prefix : str                    put before the texts of the part

    Returns
    -------
    callable                        progress callback of the part
    """
    return lambda text, fraction: progress(prefix + text, begin + (end - begin) * fraction)

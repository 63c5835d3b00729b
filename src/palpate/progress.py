"""How long work tells what it is doing and how far it is."""

from collections.abc import Callable

# What is being done, and which fraction of the work is behind it, 0 to 1.
Progress = Callable[[str, float], None]


def silent(_text: str, _fraction: float) -> None:
    """Progress of a caller who does not want to know."""


def part_of(say: Progress, begin: float, end: float, *, prefix: str = "") -> Progress:
    """Progress of a part of the work as progress of the whole.

    Parameters
    ----------
    say : callable                  of the whole
    begin, end : float              fractions of the whole where the part begins and ends
    prefix : str                    put before what the part is doing
    """
    return lambda text, fraction: say(prefix + text, begin + (end - begin) * fraction)

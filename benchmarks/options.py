"""Choices of a run that every subject gets."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Options:
    """Choices of a run.

    Parameters
    ----------
    quick : bool        small meshes and few repeats: shows that everything runs
    peers : bool        other programs' environments may be made (from the package index)
    """

    quick: bool = False
    peers: bool = False

"""What another program measured of a surface: points and their displacements, in its own frame."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.arrays import fixed_array
from palpate.errors import InputError, RecordError
from palpate.shapes import Flags, Points

LENGTH_UNITS = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
_SPELLINGS = {
    "\u00b5m": "um",
    "\u03bcm": "um",
    "micron": "um",
    "meter": "m",
    "metre": "m",
    "inch": "in",
    "inches": "in",
}


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPoints:
    """Points that a program looked at, and how they moved from rest to load.

    Parameters
    ----------
    points : (n, 3) float [m]       at rest; NaN where a failed point has no place
    displacement : (n, 3) float [m] NaN rows: looked at and not measured
    std : (n, 3) float [m] or None  one standard deviation of the displacement, > 0 where measured
    kind : str                      the program, e.g. "vic3d"
    source : str                    file they came from, for messages
    notes : tuple of str            what was assumed, converted or left out, in sentences about the
                                    file, which they do not name

    Raises
    ------
    InputError                      shapes that differ, a measured point without a place, nothing
                                    measured, a standard deviation that is not positive
    """

    points: Points
    displacement: Points
    std: Points | None
    kind: str
    source: str
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        points = fixed_array(self.points, name="points", shape=(None, 3), nan_allowed=True)
        n = len(points)
        moved = fixed_array(self.displacement, name="displacement", shape=(n, 3), nan_allowed=True)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "displacement", moved)
        measured = ~np.isnan(moved).any(axis=1)
        if not measured.any():
            raise InputError(f"not one of {n} points was measured")
        nowhere = np.flatnonzero(measured & np.isnan(points).any(axis=1))
        if len(nowhere):
            raise InputError(f"measured point {nowhere[0]} has no place; give x, y and z")
        if self.std is not None:
            std = fixed_array(self.std, name="std", shape=(n, 3), nan_allowed=True)
            if not (std[measured] > 0.0).all():
                raise InputError("std of a measured point is not positive")
            object.__setattr__(self, "std", std)


@dataclass(frozen=True, slots=True, eq=False)
class ProgramPoints:
    """The same as a program wrote it: in its unit, with its own signs of failure.

    Parameters
    ----------
    points : (n, 3) float           at rest
    displacement : (n, 3) float
    failed : (n,) bool              what the program itself says it could not measure
    std : (n, 3) float or None      one standard deviation of the displacement
    """

    points: Points
    displacement: Points
    failed: Flags
    std: Points | None = None


def from_program(
    given: ProgramPoints, *, kind: str, source: Path, metres: float, notes: tuple[str, ...]
) -> MeasuredPoints:
    """Points in metres, with everything that was not measured as rows of NaN.

    A failed point at exactly (0, 0, 0) has no place: programs write zeros where triangulation did
    not happen. Standard deviations go, with a note, where some measured point has none.

    Parameters
    ----------
    given : ProgramPoints
    kind : str
    source : Path
    metres : float [m]              length of the program's unit
    notes : tuple of str

    Raises
    ------
    RecordError                     nothing measured, or nothing moved at all
    """
    moved = np.where(np.isinf(given.displacement), np.nan, given.displacement)
    points = np.where(np.isinf(given.points), np.nan, given.points)
    failed = given.failed | np.isnan(moved).any(axis=1) | np.isnan(points).any(axis=1)
    if failed.all():
        raise RecordError(
            f"{source}: not one of its {len(failed)} points was measured (failed or NaN);"
            " is it the right file and state? Evaluate it again"
        )
    if not moved[~failed].any():
        raise RecordError(
            f"{source}: every displacement is exactly zero: this is the reference state itself;"
            " give the file of the loaded state, or its number with --frame"
        )
    nowhere = failed & (np.isnan(points).any(axis=1) | ~points.any(axis=1))
    std = given.std
    if std is not None:
        blank = int((~(std[~failed] > 0.0) | np.isinf(std[~failed])).any(axis=1).sum())
        if blank:
            notes += (f"{blank} measured points have no sigma; that of the others was left out.",)
            std = None
    return MeasuredPoints(
        points=metres * np.where(nowhere[:, None], np.nan, points),
        displacement=metres * np.where(failed[:, None], np.nan, moved),
        std=None if std is None else metres * np.where(failed[:, None], np.nan, std),
        kind=kind,
        source=str(source),
        notes=notes,
    )


def measured_rows(measured: MeasuredPoints) -> Flags:
    """True for the points that were measured, (n,) bool."""
    return ~np.isnan(measured.displacement).any(axis=1)


def metres_per_unit(
    path: Path, *, found: str | None, given: str | None, usual: str | None
) -> tuple[float, tuple[str, ...]]:
    """Length of a file's unit, from what the file, the user and the program's habit say.

    Parameters
    ----------
    path : Path                     for messages
    found : str or None             unit that the file itself names
    given : str or None             unit that the user named
    usual : str or None             unit that the program writes when nothing is said

    Returns
    -------
    metres : float [m]
    notes : tuple of str            what was assumed

    Raises
    ------
    RecordError                     an unknown unit, a contradiction, or nobody says
    """
    names = " ".join(LENGTH_UNITS)
    said = _SPELLINGS.get(found.lower(), found.lower()) if found else None
    if said is not None and said not in LENGTH_UNITS:
        raise RecordError(
            f"{path}: its lengths are in '{found}'; known units are {names}: export it in one of"
            " them (pixels are no lengths: a stereo result is needed)"
        )
    if given is not None and given not in LENGTH_UNITS:
        raise RecordError(f"--length-unit is '{given}'; must be one of {names}")
    if said is not None and given is not None and said != given:
        raise RecordError(
            f"{path}: its header says {said}, --length-unit says {given}; leave the option out"
        )
    if unit := said or given:
        return LENGTH_UNITS[unit], ()
    if usual is None:
        raise RecordError(
            f"{path}: does not tell its unit of length; say it with --length-unit ({names})"
        )
    note = f"It does not tell its unit of length; {usual} was taken (--length-unit)."
    return LENGTH_UNITS[usual], (note,)


def chosen_frame(path: Path, frame: int | None, count: int) -> tuple[int, tuple[str, ...]]:
    """Number of the state to read, from 0; the last one where none is asked for.

    Parameters
    ----------
    path : Path                     for messages
    frame : int or None             negative ones count from the end
    count : int                     states in the file

    Raises
    ------
    RecordError                     there is no such state
    """
    if frame is None:
        if count == 1:
            return 0, ()
        note = f"It holds {count} states; the last, frame {count - 1}, was read (--frame)."
        return count - 1, (note,)
    if not -count <= frame < count:
        raise RecordError(
            f"{path}: has no frame {frame}; it holds {count}"
            + (", so leave --frame out" if count == 1 else f", numbered 0 to {count - 1}")
        )
    return frame % count, ()

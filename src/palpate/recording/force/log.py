"""The log of a force gauge: readings in newtons in the object frame, with gaps and saturation."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from palpate.arrays import fixed_array
from palpate.errors import InputError, RecordError, quoted
from palpate.recording.force.bags import FORCES, read_log_table
from palpate.records import FORCE_UNITS, TIME_UNITS, Column, TextTable

_TIME_WORDS = ("time", "t", "timestamp", "seconds", "elapsed", "elapsed time")
_FORCE_WORDS = ("force", "load", "f", "fx", "fy", "fz", "fn")
_TIME_ADVICE = "columns are called time or t; name it as `time` in [force]"
_FORCE_ADVICE = (
    "columns are called force, fx, fy or fz, and there are {} axes; name one column for each axis"
    " as `columns` in [force]"
)
_UNIT = re.compile(r"^(?P<name>.*?)\s*[\[(]\s*(?P<unit>[^\])]+?)\s*[\])]$")
_CURE = (
    "a force log is a table with a line of headings, a column of times and one to three of forces"
)
# Plausible range of a probing's forces [N]; outside it the unit is wrong.
_LARGEST_FORCE, _SMALLEST_FORCE = 500.0, 1e-4
# Longest recording [s].
_LONGEST_RECORDING = 86400.0
# A gap is a step longer than this many median steps and than this time [s].
_GAP_STEPS, _GAP = 5.0, 0.05
# Saturation: at least so many equal extreme readings in a row, unless more than this fraction of
# all other readings repeat too, as with a coarse resolution.
_MIN_EQUAL_READINGS, _MAX_REPEATED = 10, 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Gauge:
    """How to read a force gauge's log.

    Parameters
    ----------
    file : Path
    time : str or None              heading of the times; None: a usual name such as "time"
    columns : tuple of str          headings of the forces; empty: usual names such as "fx"
    unit : str or None              key of `FORCE_UNITS`; None: as in the headings, else N
    time_unit : str or None         key of `TIME_UNITS`; None: as in the heading, else s
    axes : (k, 3) float             direction of a positive reading of each of 1 to 3 columns,
                                    object frame; perpendicular, normalised to unit length
    on_tool : bool                  readings are the force on the tool, not on the object
    limit : float or None [N]       range of the gauge, both signs; readings there are saturated
    topic : str or None             of a bag; None: the only one with forces

    Raises
    ------
    InputError                      an unknown unit, axes that are not perpendicular or not one per
                                    column, a limit that is not positive
    """

    file: Path
    time: str | None
    columns: tuple[str, ...]
    unit: str | None
    time_unit: str | None
    axes: Float[np.ndarray, "k 3"]
    on_tool: bool = False
    limit: float | None = None
    topic: str | None = None

    def __post_init__(self) -> None:
        for name, value, known in (
            ("unit", self.unit, FORCE_UNITS), ("time_unit", self.time_unit, TIME_UNITS)
        ):  # fmt: skip
            if value is not None and value not in known:
                raise InputError(f"{name} is {quoted(value)}; must be one of {', '.join(known)}")
        axes = fixed_array(self.axes, name="axes", shape=(None, 3))
        length = np.linalg.norm(axes, axis=1)
        if not 1 <= len(axes) <= 3 or not length.all():
            raise InputError(
                "axes must be one to three directions, one for each column of forces, e.g."
                " [[0, 0, 1]]"
            )
        unit = axes / length[:, None]
        if np.abs(unit @ unit.T - np.eye(len(unit))).max() > 1e-3:
            raise InputError(f"axes are {axes.tolist()}; a gauge's directions are perpendicular")
        if self.columns and len(self.columns) != len(axes):
            raise InputError(
                f"there are {len(self.columns)} columns of forces and {len(axes)} axes; give a"
                " direction for each column"
            )
        if self.limit is not None and not self.limit > 0.0:
            raise InputError(f"limit is {self.limit}; must be positive, in newtons")
        object.__setattr__(self, "axes", unit)


@dataclass(frozen=True, slots=True, eq=False)
class ForceLog:
    """Readings of a force gauge.

    Attributes
    ----------
    time : (n,) float [s]           not decreasing, the gauge's own clock
    force : (n, 3) float [N]        on the object, object frame; still with tool weight and zero
                                    drift; zero along directions that are not measured
    saturated : (n,) bool           at the end of the gauge's range: the true force may be larger
    axes : (k, 3) float             measured directions, unit vectors
    gaps : tuple of (float, float) [s]  begin and end of each span without readings
    missing : int                   number of rows without a number, which are left out
    source : str                    the file
    notes : tuple of str            what was assumed or left out, in sentences
    """

    time: Float[np.ndarray, " n"]
    force: Float[np.ndarray, "n 3"]
    saturated: Bool[np.ndarray, " n"]
    axes: Float[np.ndarray, "k 3"]
    gaps: tuple[tuple[float, float], ...]
    missing: int
    source: str
    notes: tuple[str, ...]

    @property
    def step(self) -> float:
        """Mean time between two readings [s]."""
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)


def read_force_log(gauge: Gauge) -> ForceLog:
    """Read the log of a force gauge.

    Parameters
    ----------
    gauge : Gauge

    Returns
    -------
    ForceLog

    Raises
    ------
    RecordError                     no such file or columns, contradictory units, times that
                                    decrease, implausible forces
    InputError                      the optional package for bags is missing
    """
    table = read_log_table(gauge.file, topic=gauge.topic, wanted=FORCES, cure=_CURE)
    (time,) = _columns(table, [gauge.time] if gauge.time else [], _TIME_WORDS, 1, _TIME_ADVICE)
    count = len(gauge.axes)
    columns = _columns(table, gauge.columns, _FORCE_WORDS, count, _FORCE_ADVICE.format(count))
    notes: list[str] = []
    seconds = _factor(table, [time], gauge.time_unit, TIME_UNITS, "time", notes)
    newtons = _factor(table, columns, gauge.unit, FORCE_UNITS, "force", notes)
    values = table.values([time, *columns])
    valid = np.isfinite(values).all(axis=1)
    if valid.sum() < 2:
        raise RecordError(f"{table.path}: has {int(valid.sum())} rows of numbers; {_CURE}")
    line_numbers = np.array(table.numbers)[valid]
    times, reading = seconds * values[valid, 0], newtons * values[valid, 1:]
    _check_times(table.path, times, line_numbers)
    _check_force_range(table.path, reading)
    gaps = _gaps(times)
    if missing := int((~valid).sum()):
        notes.append(f"{table.path.name}: {missing} rows without a number were left out.")
    if gaps:
        longest = max(end - begin for begin, end in gaps)
        notes.append(
            f"{table.path.name}: {len(gaps)} gaps, the longest of {longest:.2f} s; nothing is read"
            " there."
        )
    sign = -1.0 if gauge.on_tool else 1.0
    saturated = np.any([_saturated(column, gauge.limit) for column in reading.T], axis=0)
    force = sign * reading @ gauge.axes
    return ForceLog(
        times, force, saturated, gauge.axes, gaps, missing, str(table.path), tuple(notes)
    )


def _bare_heading(heading: str) -> str:
    """A heading without its unit, in lower case."""
    match = _UNIT.match(heading)
    return (match["name"] if match else heading).strip().lower()


def _columns(
    table: TextTable, wanted: Sequence[str], usual: Sequence[str], count: int, advice: str
) -> list[Column]:
    """The columns of the wanted headings, with or without their units; without such, those with
    usual names, which must be so many."""
    if not wanted:
        found = [column for column in table.columns if _bare_heading(column.heading) in usual]
        if len(found) != count:
            raise RecordError(f"{table.path}: {len(found)} {advice}; it has: {table.listed}")
        return found
    chosen = []
    for name in wanted:
        found = [
            column
            for column in table.columns
            if name.lower() in (column.heading.lower(), _bare_heading(column.heading))
        ]
        if len(found) != 1:
            raise RecordError(
                f"{table.path}: {len(found) or 'no'} columns are called {quoted(name)}; it has:"
                f" {table.listed}"
            )
        chosen += found
    return chosen


def _factor(
    table: TextTable,
    columns: list[Column],
    wanted: str | None,
    known: Mapping[str, float],
    what: str,
    notes: list[str],
) -> float:
    """Value of the given unit, or of that of the headings, refused if they contradict each other;
    without either that of the first known one."""
    stated = {match["unit"] for c in columns if (match := _UNIT.match(c.heading))}
    heading = columns[0].heading
    if len(stated) > 1 or stated - set(known):
        raise RecordError(
            f"{table.path}: the unit of the {what} is {quoted(', '.join(sorted(stated)))}; must be"
            f" one of {', '.join(known)}, the same for all its columns"
        )
    if stated and wanted is not None and wanted not in stated:
        raise RecordError(
            f"{table.path}: column {quoted(heading)} and the unit {quoted(wanted)} that was asked"
            " for contradict each other; correct one of them"
        )
    default = next(iter(known))
    if not stated and wanted is None:
        notes.append(f"{table.path.name}: no unit is given for the {what}; {default} is taken.")
    return known[wanted or next(iter(stated), default)]


def _check_times(path: Path, time: Float[np.ndarray, " n"], numbers: np.ndarray) -> None:
    decreasing = np.flatnonzero(np.diff(time) < 0.0)
    if len(decreasing):
        k = decreasing[0]
        raise RecordError(
            f"{path}: line {numbers[k + 1]}: the time {time[k + 1]:g} s is before that of the line"
            f" above, {time[k]:g} s ({len(decreasing)} such lines); were two recordings joined, or"
            " did the clock wrap round?"
        )
    if not 0.0 < time[-1] - time[0] <= _LONGEST_RECORDING:
        raise RecordError(
            f"{path}: its times run over {time[-1] - time[0]:g} s; a recording has some seconds to"
            " a day: are they in another unit? Say it as `time_unit` in [force]"
            f" ({', '.join(TIME_UNITS)})"
        )


def _check_force_range(path: Path, reading: Float[np.ndarray, "n k"]) -> None:
    """Refuse implausible changes of the force; a constant part is the tool's weight."""
    spread = float(np.abs(reading - np.median(reading, axis=0)).max())
    if not _SMALLEST_FORCE <= spread <= _LARGEST_FORCE:
        raise RecordError(
            f"{path}: the force changes by {spread:.3g} N at most; the forces of probings are from"
            f" {_SMALLEST_FORCE:g} to {_LARGEST_FORCE:g} N: is it in another unit? Say it as `unit`"
            f" in [force] ({', '.join(FORCE_UNITS)})"
        )


def _gaps(time: Float[np.ndarray, " n"]) -> tuple[tuple[float, float], ...]:
    steps = np.diff(time)
    longer = steps > max(_GAP_STEPS * float(np.median(steps)), _GAP)
    return tuple((float(time[k]), float(time[k + 1])) for k in np.flatnonzero(longer))


def _saturated(reading: Float[np.ndarray, " n"], limit: float | None) -> Bool[np.ndarray, " n"]:
    """Saturated readings: at the given limit, or recognised by repeated extreme values."""
    found = np.zeros(len(reading), dtype=bool)
    if limit is not None:
        found |= np.abs(reading) >= 0.999 * limit
    for end in (reading.max(), reading.min()):
        others = reading[1:] != end
        repeats = (np.diff(reading) == 0.0)[others]
        if len(repeats) and repeats.mean() < _MAX_REPEATED:
            for first, last in true_runs(reading == end):
                found[first:last] |= last - first >= _MIN_EQUAL_READINGS
    return found


def true_runs(flags: Bool[np.ndarray, " n"]) -> list[tuple[int, int]]:
    """Runs of consecutive true flags.

    Parameters
    ----------
    flags : (n,) bool

    Returns
    -------
    list of (int, int)              index of the first flag of each run, and one past its last
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))

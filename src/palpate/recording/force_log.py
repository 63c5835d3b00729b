"""The log of a force gauge: readings in newtons in the object frame, with gaps and saturation.

Logs are tables, or topics of a robot's ROS 1 and ROS 2 bags and MCAP files.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from palpate.arrays import fixed_array
from palpate.errors import InputError, RecordError, quoted
from palpate.files import checked_file, read_errors
from palpate.optional_imports import late_import
from palpate.records import FORCE_UNITS, TIME_UNITS, Column, TextTable, make_table, read_text_table

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
# Shortest and longest recording [s].
_SHORTEST_RECORDING, _LONGEST_RECORDING = 1.0, 86400.0
# A gap is a step longer than this many median steps and than this time [s].
_GAP_STEPS, _GAP = 5.0, 0.05
# Saturation: at least so many equal extreme readings in a row, unless more than this fraction of
# all other readings repeat too, as with a coarse resolution.
_MIN_EQUAL_READINGS, _MAX_REPEATED = 10, 0.2
BAG_SUFFIXES = (".bag", ".mcap", ".db3")
_BAG_CURE = "record it again, or export the topic as a table"
_AXES = ("x", "y", "z")
# Message stamps not above this were never set.
_UNSET_STAMP = 1e-9


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
    table = read_log_table(gauge.file, topic=gauge.topic, wanted=_FORCES, cure=_CURE)
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
    return make_force_log(
        times, reading, axes=gauge.axes, on_tool=gauge.on_tool, limit=gauge.limit,
        source=str(table.path), missing=int((~valid).sum()), notes=notes,
    )  # fmt: skip


def make_force_log(
    time: Float[np.ndarray, " n"],
    reading: Float[np.ndarray, "n k"],
    *,
    axes: Float[np.ndarray, "k 3"],
    source: str,
    on_tool: bool = False,
    limit: float | None = None,
    missing: int = 0,
    notes: Sequence[str] = (),
) -> ForceLog:
    """A log of readings, with the gaps and the saturation found in it.

    Parameters
    ----------
    time : (n,) float [s]           not decreasing
    reading : (n, k) float [N]
    axes : (k, 3) float             direction of a positive reading of each column, unit vectors
    source : str                    file or device, for messages
    on_tool : bool                  the readings are the force on the tool
    limit : float [N] or None       end of the gauge's range
    missing : int                   rows without a number, which were left out
    notes : sequence of str         what was assumed, in sentences

    Returns
    -------
    ForceLog
    """
    name, gaps, texts = Path(source).name, _gaps(time), list(notes)
    if missing:
        texts.append(f"{name}: {missing} rows without a number were left out.")
    if gaps:
        longest = max(end - begin for begin, end in gaps)
        texts.append(
            f"{name}: {len(gaps)} gaps, the longest of {longest:.2f} s; nothing is read there."
        )
    saturated = np.any([_saturated(column, limit) for column in reading.T], axis=0)
    force = (-1.0 if on_tool else 1.0) * reading @ axes
    return ForceLog(time, force, saturated, axes, gaps, missing, source, tuple(texts))


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
        matching = [column for column in table.columns if _bare_heading(column.heading) in usual]
        if len(matching) != count:
            raise RecordError(f"{table.path}: {len(matching)} {advice}; it has: {table.listed}")
        return matching
    chosen = []
    for name in wanted:
        matching = [
            column
            for column in table.columns
            if name.lower() in (column.heading.lower(), _bare_heading(column.heading))
        ]
        if len(matching) != 1:
            raise RecordError(
                f"{table.path}: {len(matching) or 'no'} columns are called {quoted(name)}; it has:"
                f" {table.listed}"
            )
        chosen += matching
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
    if not _SHORTEST_RECORDING <= time[-1] - time[0] <= _LONGEST_RECORDING:
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
    saturated = np.zeros(len(reading), dtype=bool)
    if limit is not None:
        saturated |= np.abs(reading) >= 0.999 * limit
    for end in (reading.max(), reading.min()):
        others = reading[1:] != end
        repeats = (np.diff(reading) == 0.0)[others]
        if len(repeats) and repeats.mean() < _MAX_REPEATED:
            for first, last in true_runs(reading == end):
                saturated[first:last] |= last - first >= _MIN_EQUAL_READINGS
    return saturated


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


@dataclass(frozen=True, slots=True)
class LoggedQuantity:
    """A quantity that is sought in a bag.

    Attributes
    ----------
    name : str                      "force" or "pose", for messages
    columns : tuple of str          headings of the x, y and z columns, after the time
    kinds : mapping of str to str   message type -> dotted path of the attribute that holds it
    """

    name: str
    columns: tuple[str, str, str]
    kinds: Mapping[str, str]


_FORCES = LoggedQuantity(
    "force",
    ("fx [N]", "fy [N]", "fz [N]"),
    {
        "geometry_msgs/msg/WrenchStamped": "wrench.force",
        "geometry_msgs/msg/Wrench": "force",
        "geometry_msgs/msg/Vector3Stamped": "vector",
        "geometry_msgs/msg/Vector3": "",
        "std_msgs/msg/Float64": "data",
        "std_msgs/msg/Float32": "data",
    },
)
POSITIONS = LoggedQuantity(
    "pose",
    ("x [m]", "y [m]", "z [m]"),
    {
        "geometry_msgs/msg/PoseStamped": "pose.position",
        "geometry_msgs/msg/Pose": "position",
        "geometry_msgs/msg/PointStamped": "point",
        "geometry_msgs/msg/TransformStamped": "transform.translation",
        "nav_msgs/msg/Odometry": "pose.pose.position",
    },
)


def read_log_table(
    path: Path, *, topic: str | None, wanted: LoggedQuantity, cure: str
) -> TextTable:
    """The table of a log: a text file, or one topic of a bag.

    Parameters
    ----------
    path : Path                     a text table, or a bag with a suffix of `BAG_SUFFIXES`
    topic : str or None             of a bag; None: the only one that holds the quantity
    wanted : LoggedQuantity
    cure : str                      description of a valid table, for messages

    Returns
    -------
    TextTable                       of a bag: time [s], from the stamps of the messages if set, else
                                    the time of recording; then the wanted columns, or a single one
                                    for messages that hold one number

    Raises
    ------
    RecordError                     missing, damaged; no such topic, or several candidates; a topic
                                    given for a text table
    InputError                      a bag, and the optional package that reads bags is missing
    """
    if path.suffix.lower() not in BAG_SUFFIXES:
        if topic is not None:
            raise RecordError(
                f"{path}: is taken for a table of text, which has no topic {quoted(topic)}; bags"
                f" end in {', '.join(BAG_SUFFIXES)}"
            )
        return read_text_table(path, cure=cure)
    checked_file(path)
    highlevel = late_import("rosbags.highlevel", extra="bags", purpose=f"reading {path.name}")
    with (
        read_errors(path, _BAG_CURE, what="cannot be read as a bag"),
        highlevel.AnyReader([path]) as reader,
    ):
        chosen = _connections(path, reader.connections, topic, wanted)
        rows = list(_rows(reader, chosen, wanted.kinds[chosen[0].msgtype]))
    names = wanted.columns if rows and rows[0].count(",") == len(_AXES) else (wanted.name,)
    head = ("time [s]", *names)
    return make_table(path, [",".join(head), *rows], head, first=1, delimiter=",", cure=cure)


def _connections(
    path: Path, connections: Any, topic: str | None, wanted: LoggedQuantity
) -> list[Any]:
    """Connections of the requested topic, or of the only suitable one."""
    listed = (
        ", ".join(f"{connection.topic} ({connection.msgtype})" for connection in connections)
        or "none"
    )
    suitable = [connection for connection in connections if connection.msgtype in wanted.kinds]
    if topic is not None:
        suitable = [connection for connection in suitable if connection.topic == topic]
    if len({connection.topic for connection in suitable}) == 1:
        return suitable
    what = "no topic" if not suitable else f"{len(suitable)} topics"
    named = f" called {quoted(topic)}" if topic is not None else ""
    raise RecordError(
        f"{path}: {what}{named} with a {wanted.name} ({', '.join(wanted.kinds)}); its topics are"
        f" {listed}; name one as `topic`"
    )


def _rows(reader: Any, connections: list[Any], attribute_path: str) -> Iterator[str]:
    """Lines of the table, one per message."""
    for connection, recorded, raw in reader.messages(connections=connections):
        message = reader.deserialize(raw, connection.msgtype)
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        time = 1e-9 * recorded
        if stamp is not None and stamp.sec + stamp.nanosec > _UNSET_STAMP:
            time = stamp.sec + 1e-9 * stamp.nanosec
        component = reduce(getattr, filter(None, attribute_path.split(".")), message)
        values = (
            [getattr(component, axis) for axis in _AXES] if hasattr(component, "x") else [component]
        )
        yield ",".join(f"{value:.9f}" for value in (time, *values))

"""Robot logs as tables: topics of ROS 1 and ROS 2 bags and of MCAP files."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

from palpate.errors import RecordError, quoted
from palpate.files import checked_file, read_errors
from palpate.optional_imports import late_import
from palpate.records import TextTable, make_table, read_text_table

BAG_SUFFIXES = (".bag", ".mcap", ".db3")
_CURE = "record it again, or export the topic as a table"
_AXES = ("x", "y", "z")
# Message stamps not above this were never set.
_UNSET_STAMP = 1e-9


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


FORCES = LoggedQuantity(
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
        read_errors(path, _CURE, what="cannot be read as a bag"),
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
        found = reduce(getattr, filter(None, attribute_path.split(".")), message)
        values = [getattr(found, axis) for axis in _AXES] if hasattr(found, "x") else [found]
        yield ",".join(f"{value:.9f}" for value in (time, *values))

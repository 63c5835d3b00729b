"""Topics of ROS bags and MCAP files: the same readings as from a table."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from palpate.errors import RecordError
from palpate.recording.force_log import Gauge, read_force_log
from palpate.recording.record import read_poses

_TIMES = 1.7e9 + 0.01 * np.arange(200)
_FORCE = np.stack([0.1 * np.sin(_TIMES), 0.2 * np.cos(_TIMES), np.linspace(0.0, -2.0, 200)], axis=1)
_PLACE = np.stack([0.1 + 0.0 * _TIMES, 0.2 + 0.0 * _TIMES, np.linspace(0.05, 0.04, 200)], axis=1)
# Messages come to the recorder late; the stamps are those of the readings.
_LATE = 0.004


def _wrench(types, time, force):
    """A stamped wrench; the header of ROS 1 has a number besides."""
    names = types.get_msgdef("std_msgs/msg/Header").fields
    stamp = types.types["builtin_interfaces/msg/Time"](int(time), round((time - int(time)) * 1e9))
    header = types.types["std_msgs/msg/Header"](*([0] if len(names) == 3 else []), stamp, "gauge")
    vector = types.types["geometry_msgs/msg/Vector3"]
    wrench = types.types["geometry_msgs/msg/Wrench"](vector(*force), vector(0.0, 0.0, 0.0))
    return types.types["geometry_msgs/msg/WrenchStamped"](header, wrench)


def _point(types, position):
    """A point without a stamp."""
    turn = types.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    return types.types["geometry_msgs/msg/Pose"](
        types.types["geometry_msgs/msg/Point"](*position), turn
    )


def written(folder: Path, kind: str, *, topics: tuple[str, ...] = ("/gauge",)) -> Path:
    """A bag with forces on each topic, and the poses of the tip."""
    types = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.ROS2_HUMBLE)
    if kind == "bag":
        file = folder / "run.bag"
        writer, pack = Writer1(file), types.serialize_ros1
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        file = folder / "run" / f"run.{kind}"
        writer, pack = (
            Writer2(folder / "run", version=9, storage_plugin=plugin),
            types.serialize_cdr,
        )
    with writer as bag:
        names = ("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/Pose")
        forces = [bag.add_connection(topic, names[0], typestore=types) for topic in topics]
        poses = bag.add_connection("/tip", names[1], typestore=types)
        for time, force, place_ in zip(_TIMES, _FORCE, _PLACE, strict=True):
            when = int((time + _LATE) * 1e9)
            for connection in forces:
                bag.write(connection, when, pack(_wrench(types, time, force), names[0]))
            bag.write(poses, when, pack(_point(types, place_), names[1]))
    return file


def gauge_of(file: Path, *, topic: str | None = None) -> Gauge:
    return Gauge(file, None, (), None, None, np.eye(3), topic=topic)


@pytest.mark.parametrize("kind", ["bag", "mcap", "db3"])
def test_a_bag_says_what_waswritten(tmp_path: Path, kind: str) -> None:
    file = written(tmp_path, kind)
    log = read_force_log(gauge_of(file))
    # Nine decimals in the table; a double has a quarter of a microsecond at such times.
    np.testing.assert_allclose(log.force, _FORCE, atol=1e-8)
    np.testing.assert_allclose(log.time, _TIMES, rtol=0.0, atol=1e-6)
    assert not log.notes
    # Lengths of a bag are metres, whatever the session's unit; there are no stamps but the bag's.
    poses = read_poses(file, metres_per_unit=1e-3)
    np.testing.assert_allclose(poses.position, _PLACE, atol=1e-8)
    np.testing.assert_allclose(poses.time, _TIMES + _LATE, rtol=0.0, atol=1e-6)


def test_one_of_several_topics_must_be_named(tmp_path: Path) -> None:
    file = written(tmp_path, "mcap", topics=("/left", "/right"))
    with pytest.raises(RecordError, match=r"2 topics with a force .* name one as `topic`"):
        read_force_log(gauge_of(file))
    assert len(read_force_log(gauge_of(file, topic="/right")).time) == len(_TIMES)
    with pytest.raises(RecordError, match="no topic called '/up' with a force"):
        read_force_log(gauge_of(file, topic="/up"))


@pytest.mark.parametrize("kind", ["bag", "mcap", "db3"])
def test_a_bag_that_was_cut_off_is_refused(tmp_path: Path, kind: str) -> None:
    file = written(tmp_path, kind)
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 3])
    with pytest.raises(RecordError, match="cannot be read as a bag"):
        read_force_log(gauge_of(file))


def test_a_table_has_no_topic(tmp_path: Path) -> None:
    file = tmp_path / "force.csv"
    file.write_text("time,fx,fy,fz\n0,0,0,0\n1,0,0,1\n")
    with pytest.raises(RecordError, match="a table of text, which has no topic '/gauge'"):
        read_force_log(gauge_of(file, topic="/gauge"))

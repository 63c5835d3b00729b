"""The laws of cameras, gauges and arms, over every implementation; and devices that fail."""

import itertools
import os
import sys
import time
from contextlib import contextmanager

import cv2
import numpy as np
import pytest
from bench.drawn_world import drawn_bench
from bench.live_devices import REPLIES, gauge_line, mjpeg_stream
from bench.stand_ins import HARVESTERS, REALSENSE, Robot
from scipy.spatial.transform import Rotation

from palpate.bench import Arm, Camera, DeviceError, ForceSource
from palpate.bench.arms import ArmLimits, GuardedArm, check_push
from palpate.bench.bench_file import CAMERA_DRIVERS
from palpate.bench.cameras import LiveCamera, live_pictures
from palpate.bench.gauges import GAUGES, SerialGauge, TableGauge, TypedForce
from palpate.bench.universal_robot import UniversalRobot
from palpate.errors import InputError
from palpate.records import TomlTable


def repeat(ask):
    """Until it fails, for three seconds at least."""
    for _ in range(600):
        ask()
        time.sleep(0.005)


DOWN = np.array([0.0, 0.0, -1.0])


@contextmanager
def film(tmp_path):
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (64, 48))
    for k in range(60):
        picture = np.full((48, 64, 3), 2 * k + 20, np.uint8)
        writer.write(picture)
    writer.release()
    yield LiveCamera("c0", live_pictures, str(path), None)


@contextmanager
def stream(_):
    with mjpeg_stream(1000) as address:
        yield LiveCamera("c0", live_pictures, address, None)


@contextmanager
def virtual_camera(_):
    yield drawn_bench().cameras[0]


def stand_in(driver, module, code, **keys):
    """A camera of a library that the child finds in a folder."""

    @contextmanager
    def made(tmp_path):
        file = tmp_path / f"{module.replace('.', '/')}.py"
        file.parent.mkdir(exist_ok=True)
        file.write_text(code)
        (tmp_path / "maker.cti").touch()
        values = {"name": "c0", "driver": driver, "source": "A7", **keys}
        with pytest.MonkeyPatch.context() as patch:
            path = os.pathsep.join([str(tmp_path), *sys.path])
            patch.setenv("PYTHONPATH", path)
            yield CAMERA_DRIVERS[driver](TomlTable(tmp_path / "bench.toml", "[camera]", values))

    return made


genicam = stand_in("genicam", "harvesters.core", HARVESTERS, producer="maker.cti")
realsense = stand_in("realsense", "pyrealsense2", REALSENSE, size=[64, 48])


@pytest.mark.parametrize("make", [film, stream, virtual_camera, genicam, realsense])
def test_laws_of_cameras(make, tmp_path):
    with make(tmp_path) as camera:
        assert isinstance(camera, Camera)
        # Twice: again after an interruption.
        for _ in range(2):
            camera.start()
            grabbed = [camera.grab() for _ in range(5)]
            times = [when for _, when in grabbed]
            assert all(a < b for a, b in itertools.pairwise(times))
            for picture, _ in grabbed:
                assert picture.shape == grabbed[0][0].shape
                assert picture.ndim == 2
            levels = [picture.astype(float).sum() for picture, _ in grabbed]
            assert len(set(levels)) == 5
            assert all(isinstance(text, str) for text in camera.settings.values())
            camera.close()
            camera.close()


@pytest.mark.parametrize(
    ("source", "words"),
    [(97, "it does not open"), ("http://127.0.0.1:9/", "it does not open")],
)
def test_a_camera_that_is_not_there(source, words):
    camera = LiveCamera("c0", live_pictures, source, None)
    with pytest.raises(DeviceError, match=f"camera 'c0' .*{words}.*plugged in"):
        camera.start()
    camera.close()


@pytest.mark.skipif(sys.platform != "linux", reason="other systems show no files of cameras")
@pytest.mark.parametrize(
    ("number", "allowed", "words"),
    [
        (97, True, "there is no .*video97, but .*video98"),
        (98, True, "video98 is there: another program has it"),
        (98, False, "you may not use .*video98; join its group"),
    ],
)
def test_why_a_camera_does_not_open(tmp_path, monkeypatch, number, allowed, words):
    (tmp_path / "video98").touch()
    monkeypatch.setattr("os.access", lambda *_: allowed)
    monkeypatch.setattr("palpate.bench.cameras._FILE", f"{tmp_path}/video{{}}")
    with pytest.raises(RuntimeError, match=f"it does not open.*{words}"):
        next(live_pictures(number, None))


@pytest.mark.parametrize(
    ("driver", "module", "code", "keys", "words"),
    [
        ("genicam", "harvesters.core", HARVESTERS, {"producer": "maker.cti"}, "is not found"),
        ("realsense", "pyrealsense2", REALSENSE, {}, "No device connected"),
    ],
)
def test_a_number_that_no_camera_has(tmp_path, driver, module, code, keys, words):
    with stand_in(driver, module, code, **keys | {"source": "B8"})(tmp_path) as camera:
        with pytest.raises(DeviceError, match=f"camera 'c0' .B8.: .*{words}"):
            camera.start()
        camera.close()


def test_a_camera_that_is_unplugged():
    """After 20 pictures; the ones before are good."""
    with mjpeg_stream(20) as address:
        camera = LiveCamera("c0", live_pictures, address, None)
        camera.start()
        with pytest.raises(DeviceError, match=r"camera 'c0' .* stopped sending"):
            repeat(camera.grab)
        camera.close()


@contextmanager
def table(tmp_path):
    path = tmp_path / "force.csv"
    path.write_text("time,force\n0.0,9.9\n")
    gauge = TableGauge(path, unit="N")
    read = gauge.read

    def fed():
        with path.open("a") as file:
            file.write("0.1,-1.5\n0.2,1.5")
            file.flush()
            readings = read()
            file.write("\n")
        return readings

    gauge.read = fed
    yield gauge


def serial(name):
    @contextmanager
    def make(_):
        with gauge_line(*REPLIES[name]) as port:
            yield SerialGauge(port, name)

    make.__name__ = name
    return make


@contextmanager
def sauter(_):
    with gauge_line(*REPLIES["sauter"]) as port:
        yield SerialGauge(port, "sauter", unit="N")


@contextmanager
def virtual_gauge(_):
    bench = drawn_bench()
    read = bench.force.read

    def waited():
        bench.cameras[0]._world.wait(0.1)
        return read()

    bench.force.read = waited
    yield bench.force


@pytest.mark.parametrize(
    "make", [serial("mark-10"), serial("imada"), serial("hx711"), sauter, table, virtual_gauge]
)
def test_laws_of_forces(make, tmp_path):
    with make(tmp_path) as gauge:
        assert isinstance(gauge, ForceSource)
        assert not gauge.typed
        for _ in range(2):
            gauge.start()
            times, forces = [], []
            end = time.monotonic() + 5.0
            while len(forces) < 10 and time.monotonic() < end:
                when, newtons = gauge.read()
                # A gauge that sends by itself sends several meanwhile.
                time.sleep(0.03)
                assert len(when) == len(newtons)
                times += when.tolist()
                forces += newtons.tolist()
            assert len(forces) >= 10
            # With one time for two the noise of a force could not be told.
            assert (np.diff(times) > 0.0).all()
            # 152.96 gf are 1.5 N within 1e-4; the virtual gauge shows its tool's weight, 0.2 N.
            expected = 0.2 if make is virtual_gauge else 1.5
            assert np.abs(np.median(np.abs(forces)) - expected) < 2e-3
            gauge.close()
            gauge.close()


def test_every_gauge_is_tried():
    assert set(REPLIES) == set(GAUGES)


@pytest.mark.parametrize(
    ("gauge", "unit", "reply", "words"),
    [
        ("mark-10", None, b"", "has sent no reading for 2 s: is it on"),
        ("mark-10", None, b"\x00\xff!\r\n" * 9, "is no reading of 'mark-10'.*another gauge"),
        ("mark-10", "N", b"1.2 lbF\r\n", "sends lbf, and .force. says N"),
        ("mark-10", None, b"1.2 ozF\r\n", "sends ozF; switch it to one of"),
        ("hx711", None, b"12.5\r\n", "without a unit; say it as `unit`"),
        ("imada", None, b"+50.00NTE\r", "is overloaded"),
    ],
)
def test_a_gauge_that_cannot_be_used(gauge, unit, reply, words):
    with gauge_line(REPLIES[gauge][0], reply) as port:
        line = SerialGauge(port, gauge, unit=unit)
        line.start()
        with pytest.raises(DeviceError, match=words):
            repeat(line.read)
        line.close()


def test_a_gauge_that_is_not_there():
    with pytest.raises(DeviceError, match="at /dev/no-such-port cannot be opened"):
        SerialGauge("/dev/no-such-port", "imada").start()


@pytest.mark.parametrize(
    ("text", "newtons"),
    [("320", 3.138128), ("320 g", 3.138128), ("0,5 kg", 4.903325), ("3 N", 3.0)],
)
def test_what_a_person_types(text, newtons):
    assert TypedForce(unit="gf").newtons(text) == pytest.approx(newtons, rel=1e-12)


@pytest.mark.parametrize("text", ["", "much", "-3 N", "3 mm", "0"])
def test_what_is_no_force(text):
    with pytest.raises(InputError, match="is no force; type what the scale shows"):
        TypedForce(unit="gf").newtons(text)


class Straight:
    """An arm that is at once where it is to be."""

    def __init__(self):
        self.position, self.stopped = np.array([0.0, 0.0, 0.1]), 0

    def start(self):
        pass

    def pose(self):
        return self.position

    def move(self, position, direction, speed):
        self.position = position

    def stop(self):
        self.stopped += 1

    def close(self):
        pass


BASE = np.array([[0.0, -1.0, 0.0, 0.3], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0, 0, 0, 1]])


@pytest.fixture
def robot(monkeypatch):
    robot = Robot()
    robot.install(monkeypatch)
    return robot


def universal(host="10.0.0.9"):
    return UniversalRobot(host, 3, BASE)


def test_laws_of_an_arm_by_its_stand_in(robot):
    test_laws_of_arms(universal)
    assert robot.calls.count(("moveL", 0.005)) == 2
    # In the frame of its base, upside down as it was; and again with the tool aslant.
    np.testing.assert_allclose(robot.pose, [0.0, 0.29, 0.08, np.pi, 0.0, 0.0], atol=1e-9)
    arm = universal()
    arm.start()
    aslant = np.array([0.6, 0.0, -0.8])
    arm.move(np.zeros(3), aslant, 0.005)
    tool = BASE[:3, :3] @ Rotation.from_rotvec(robot.pose[3:]).as_matrix()
    np.testing.assert_allclose(tool[:, 2], aslant, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "words", "stops"),
    [
        ({"held": False}, "the dead man's key, digital input 3, is not held", True),
        ({"connected": False}, "the connection broke: its controller stops it", False),
        ({"refuses": True}, "it refuses to move", False),
        ({"stuck": True}, "it has not arrived", True),
    ],
)
def test_an_arm_that_does_not_arrive(robot, monkeypatch, change, words, stops):
    monkeypatch.setattr("palpate.bench.universal_robot._SPARE", 0.0)
    arm = universal()
    arm.start()
    for name, value in change.items():
        setattr(robot, name, value)
    with pytest.raises(DeviceError, match=f"the arm at 10.0.0.9: {words}"):
        arm.move(np.array([0.3, 0.05, 0.1]), DOWN, 1.0)
    assert [call for call in robot.calls if call[0] == "stopL"] == [("stopL", 1.0)] * stops


def test_an_arm_that_is_not_there(robot):
    with pytest.raises(DeviceError, match=r"Could not connect.*is it on, and in remote control"):
        universal("10.0.0.8").start()


def limits():
    return ArmLimits(2.0, 5e-3, 0.01, np.full(3, -0.2), np.full(3, 0.2))


@pytest.mark.parametrize("make", [Straight, lambda: drawn_bench().arm])
def test_laws_of_arms(make):
    arm = make()
    assert isinstance(arm, Arm)
    arm.start()
    for position in ([0.0, 0.0, 0.09], [0.01, 0.0, 0.08]):
        arm.move(np.array(position), DOWN, 0.005)
        np.testing.assert_allclose(arm.pose(), position, atol=1e-12)
    arm.stop()
    arm.close()
    arm.close()


def test_a_virtual_tool_presses_only_where_it_is():
    """Beside the place that was pressed last, and farther down than it, it touches nothing."""
    bench = drawn_bench()
    world, gauge = bench.cameras[0]._world, bench.force
    bench.arm.move(np.array([0.0, 0.0, 0.06]), DOWN, 0.008)
    bench.arm.move(np.array([0.0, 0.0, 0.039]), DOWN, 0.008)
    # Two standard deviations of the place are 1 mm: it presses by now, by 0.1 N or more.
    assert gauge.read()[1][-1] > 0.3
    for position in ([0.0, -0.08, 0.04], [0.0, -0.06, 0.02]):
        bench.arm.move(np.array(position), np.array([0.0, 1.0, 0.0]), 0.008)
    world.wait(0.5)
    # The weight of the tool, with noise of 1 mN.
    assert gauge.read()[1][-40:].mean() == pytest.approx(0.2, abs=1e-3)
    assert world.depth < 0.0


def test_the_planner_keeps_the_limits():
    point = np.array([0.0, 0.0, 0.05])
    check_push(limits(), point, DOWN, clearance=0.005, force=1.0)
    with pytest.raises(InputError, match="a push of 3 N is asked for; the arm may press with 2 N"):
        check_push(limits(), point, DOWN, clearance=0.005, force=3.0)
    with pytest.raises(InputError, match="out of the box from"):
        check_push(limits(), np.array([0.0, 0.0, 0.198]), DOWN, clearance=0.005, force=1.0)


@pytest.mark.parametrize(
    ("depth", "speed", "force", "words"),
    [
        (6e-3, 0.01, 0.0, "6 mm is deeper than 5 mm"),
        (4e-3, 0.02, 0.0, "20 mm/s is faster than 10 mm/s"),
        (4e-3, 0.01, 2.5, "presses with 2.5 N of 2 at most"),
        (-0.2, 0.01, 0.0, "out of the box"),
    ],
)
def test_the_driver_keeps_the_limits(depth, speed, force, words):
    arm, point = Straight(), np.array([0.0, 0.0, 0.05])
    guard = GuardedArm(arm, limits())
    guard.press_at(point, DOWN)
    guard.felt(force)
    before = arm.position
    with pytest.raises(DeviceError, match=words):
        guard.move(point + depth * DOWN, DOWN, speed)
    assert arm.stopped == 1
    np.testing.assert_array_equal(arm.position, before)
    # Away from the object it may go whatever the gauge reads.
    guard.move(point - 0.06 * DOWN, DOWN, 0.01)

"""bench.toml: what is read, and what is wrong with it."""

import numpy as np
import pytest
from bench.test_devices import Straight
from surfaces import box

from palpate.app.cli import main
from palpate.bench import bench_file, read_bench
from palpate.calibration import Chessboard
from palpate.errors import RecordError
from palpate.geometry import write_mesh
from palpate.records import Camera, Rig, write_rig

CAMERAS = """
[[camera]]
name = "c0"
driver = "opencv"
source = 0
[[camera]]
name = "c1"
driver = "opencv"
source = "http://10.0.0.7:8080/"
"""
FORCE = """
[force]
driver = "serial"
port = "/dev/ttyUSB0"
gauge = "mark-10"
limit = "50 N"
"""
ARM = """
[arm]
driver = "straight"
[arm.limits]
force = "2 N"
depth = "5 mm"
speed = "10 mm/s"
low = ["-5 cm", "-5 cm", "0 cm"]
high = ["5 cm", "5 cm", "10 cm"]
[push]
force = "1 N"
"""
HEAD = 'format = "palpate-bench/1"\n[rig]\ncameras = "rig.toml"\n'


@pytest.fixture
def folder(tmp_path):
    matrix = np.array([[700.0, 0.0, 79.5], [0.0, 700.0, 59.5], [0.0, 0.0, 1.0]])
    cameras = []
    for name, x in (("c0", 0.0), ("c1", 0.1)):
        pose = np.diag([1.0, -1.0, -1.0, 1.0])
        pose[:3, 3] = [-x, 0.0, 0.4]
        cameras.append(Camera(name, (160, 120), matrix, np.zeros(5), pose))
    write_rig(tmp_path / "rig.toml", Rig(tuple(cameras), 0, "rig"))
    return tmp_path


def read(folder, text):
    (folder / "bench.toml").write_text(text)
    return read_bench(folder)


def test_a_bench(folder, monkeypatch):
    monkeypatch.setitem(bench_file.ARM_DRIVERS, "straight", lambda _table: Straight())
    bench = read(folder, HEAD + CAMERAS + FORCE + ARM)
    assert [camera.source for camera in bench.cameras] == [0, "http://10.0.0.7:8080/"]
    assert bench.force.limit == 50.0
    assert bench.push_force == 1.0
    assert bench.arm.limits.speed == pytest.approx(0.01)
    np.testing.assert_allclose(bench.arm.limits.high, [0.05, 0.05, 0.1])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "c1"', 'name = "c0"', "camera 'c0' is there twice"),
        ('"http://10.0.0.7:8080/"', "0", "source: is 0, as that of camera 'c0'"),
        ('"http://10.0.0.7:8080/"', '"film.avi"', "no such file"),
        ('driver = "opencv"', 'driver = "opencvv"', "did you mean 'opencv'"),
        ('gauge = "mark-10"', 'gauge = "mark10"', "did you mean 'mark-10'"),
        ('limit = "50 N"', "limit = 50", "must be a number with its unit"),
        ('limit = "50 N"', 'limit = "-50 N"', "limit: is -50 N; must be above zero"),
        ('force = "1 N"', 'force = "0 N"', "force: is 0 N; must be above zero"),
        ('driver = "straight"', 'driver = "ur"', "allowed: universal-robot, straight"),
        ('speed = "10 mm/s"\n', "", "the key 'speed' is missing"),
        ('depth = "5 mm"', 'depth = "-5 mm"', "depth is -0.005; must be positive"),
        ('high = ["5 cm"', 'high = ["-9 cm"', "every number of low must be below that of high"),
        ('[push]\nforce = "1 N"', "", "the key 'force' is missing"),
        ("[force]", "[gauge]", "unknown key 'gauge'"),
        ("source = 0", "source = [0]", "source: is .0.; must be a text"),
        ("source = 0", "source = -1", "source: is -1; must be a whole number"),
        ("[push]", "[push]\nhold = -1.5", "hold: is -1.5 s; must be above 0, and 30 at most"),
        ('limit = "50 N"', "direction = [0, 0, 0]", "direction: has no length"),
        ("[force]", '[board]\ntarget = "charuco"\n[force]', "the key 'square' is missing"),
        ("[force]", '[board]\ntarget = "round"\n[force]', "allowed: charuco"),
    ],
)
def test_what_is_wrong(folder, monkeypatch, old, new, words):
    monkeypatch.setitem(bench_file.ARM_DRIVERS, "straight", lambda _table: Straight())
    text = HEAD + CAMERAS + FORCE + ARM
    assert old in text
    with pytest.raises(RecordError, match=f"bench.toml.*({words})"):
        read(folder, text.replace(old, new))


def test_a_universal_robot(folder):
    """Its base, as a file, and the input of its dead man's key are required."""
    base = 'length_unit = "mm"\nR = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]\nt = [300, 0, 0]\n'
    (folder / "base.toml").write_text(base)
    keys = 'driver = "universal-robot"\nhost = "10.0.0.9"\nkey = 3\nbase = "base.toml"\n'
    arm = ARM.replace('driver = "straight"\n', keys)
    driver = read(folder, HEAD + CAMERAS + FORCE + arm).arm._arm
    np.testing.assert_allclose(driver.base[:3, 3], [0.3, 0.0, 0.0])
    assert (driver.host, driver.key) == ("10.0.0.9", 3)
    with pytest.raises(RecordError, match="the key 'key' is missing"):
        read(folder, HEAD + CAMERAS + FORCE + arm.replace("key = 3\n", ""))


BOARD = """
[board]
target = "chessboard"
columns = 9
rows = 6
square = "20 mm"
"""


def test_a_bench_without_a_rig_names_its_cameras(tmp_path):
    bench = read(tmp_path, HEAD.split("[rig]")[0] + CAMERAS + FORCE + BOARD)
    assert bench.rig is None
    assert [camera.name for camera in bench.cameras] == ["c0", "c1"]
    assert bench.board == Chessboard(9, 6, 0.02)


@pytest.mark.parametrize(
    ("cameras", "words"), [("", "missing"), (CAMERAS[: CAMERAS.rindex("[[")], "one camera")]
)
def test_fewer_than_two_cameras_are_refused(tmp_path, cameras, words):
    with pytest.raises(RecordError, match=f"is {words}; must be two or more, 20 to 40 degrees"):
        read(tmp_path, HEAD.split("[rig]")[0] + cameras + FORCE)


@pytest.mark.parametrize(
    ("plugged", "words"),
    [
        ((), "needs no device$"),
        (("video0", "video2"), r"found here: camera \S*video0, \S*video2 \(source = its number\)$"),
        (("video0", "ttyACM0"), r"video0 \(source = its number\); serial line \S*ttyACM0$"),
    ],
)
def test_a_bench_that_is_not_there(tmp_path, monkeypatch, plugged, words):
    """It says how to get one, and what is plugged in."""
    there = tmp_path / "dev"
    there.mkdir()
    for name in plugged:
        (there / name).touch()
    monkeypatch.setattr("palpate.bench.cameras._FILE", f"{there}/video{{}}")
    monkeypatch.setattr("palpate.bench.gauges._DEVICES", str(there))
    for source in (tmp_path, tmp_path / "bench.toml"):
        with pytest.raises(
            RecordError, match=f"`palpate init {tmp_path} --template webcams`.*{words}"
        ):
            read_bench(source)


def test_the_template_of_init_is_a_bench(tmp_path):
    write_mesh(tmp_path / "sponge.stl", box(size=(0.1, 0.06, 0.04), cells=2))
    assert main(["init", str(tmp_path), "--template", "webcams", "--tool-radius", "0.008"]) == 0
    bench = read_bench(tmp_path)
    assert [camera.source for camera in bench.cameras] == [0, 1]
    assert bench.rig is None
    assert bench.board is not None
    np.testing.assert_allclose(bench.direction, [0.0, 0.0, -1.0])
    assert bench.contact == {"tool": "sphere", "tool_radius": 0.008}

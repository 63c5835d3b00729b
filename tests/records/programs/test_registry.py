"""Which program wrote a file: units, states, and files of nobody."""

import re
import unicodedata

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from program_files import (
    vic3d_rows,
    write_table,
)
from scipy.spatial.transform import Rotation

from palpate.errors import CalibrationError, InputError, RecordError
from palpate.records import Camera, Rig, check_file_names, read_rig, write_rig
from palpate.records.probing import measured_rows
from palpate.records.program import Program, ProgramPoints, camera_matrix, make_pose
from palpate.records.programs import registry
from palpate.records.programs.registry import (
    import_kinds,
    kinds_text,
    read_measured,
)
from palpate.vision import project

VIC3D = '"x","y","u","v","sigma","X","Y","Z","U","V","W"'
MATCHID = (
    "Coordinates.Image X [Pixel];coor.X [mm];coor.Y [mm];coor.Z [mm];"
    "disp.Horizontal Displacement U [mm];disp.Vertical Displacement V [mm];"
    "disp.Out-Of-Plane: W [mm];stats.Sigma [mm]"
)
TOML = """\
length_unit = "mm"
reference = "right"

[[camera]]
name = "left"
size = [640, 480]
K = [[1400.0, 0.5, 319.5], [0.0, 1410.0, 239.5], [0.0, 0.0, 1.0]]
distortion = [0.1, -0.2, 0.001, 0.002, 0.3]
R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
t = [0, 0, 500]

[[camera]]
name = "right"
K = [[1400.0, 0.0, 319.5], [0.0, 1400.0, 239.5], [0.0, 0.0, 1.0]]
R = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
t = [-100, 5, 500]
"""


def test_kinds_of_the_command():
    kinds = [
        "dice",
        "vic3d",
        "matchid",
        "pyvale",
        "opencorr",
        "multidic",
        "duodic",
        "vtu",
        "planar",
    ]
    assert list(import_kinds()) == kinds
    assert kinds_text().startswith("dice (.txt, .e), vic3d (.csv), ")
    assert "multidic or duodic (.mat)" in kinds_text()


def test_a_new_program_is_one_line(tmp_path, monkeypatch):
    """A toy program with a calibration and displacements is registered, and both are read."""

    def read_points(path, frame):
        values = np.loadtxt(path, ndmin=2)
        return ProgramPoints(values[:, :3], values[:, 3:])

    def read_toy_rig(file):
        inner = [float(word) for word in file.content.split()[1:]]
        poses = [make_pose(np.eye(3), np.array([x, 0.0, 0.5])) for x in (0.0, 0.1)]
        cameras = [
            file.camera(name, matrix=camera_matrix(inner), distortion=(), pose=pose)
            for name, pose in zip("ab", poses, strict=True)
        ]
        return file.rig(cameras)

    toy = Program(
        kinds=("toy",),
        results=".toy",
        read_points=read_points,
        default_unit="um",
        calibrations="Toy (.cal)",
        holds_rig=lambda file: str(file.content).startswith("TOY"),
        read_rig=read_toy_rig,
    )
    monkeypatch.setattr(registry, "PROGRAMS", [*registry.PROGRAMS, toy])
    (tmp_path / "a.toy").write_text("1 2 3 0.1 0.2 0.3\n4 5 6 nan 0 0\n")
    measured = read_measured("toy", tmp_path / "a.toy")
    # 1 um in metres is exact to a rounding.
    np.testing.assert_allclose(measured.points[1], [4e-6, 5e-6, 6e-6], rtol=1e-15)
    assert measured_rows(measured.displacement).tolist() == [True, False]
    assert measured.notes[0].startswith("It does not say its unit of length; um was taken")
    (tmp_path / "a.cal").write_text("TOY 900 910 320 240")
    rig = read_rig(tmp_path / "a.cal")
    assert [camera.name for camera in rig.cameras] == ["a", "b"]
    assert rig.cameras[0].matrix[1, 1] == 910.0
    (tmp_path / "b.cal").write_text("nothing")
    with pytest.raises(RecordError, match=r"known are rig.toml, .*, Toy \(.cal\)$"):
        read_rig(tmp_path / "b.cal")


def test_unknown_kind():
    with pytest.raises(RecordError, match="kind is 'gom'; must be one of dice, vic3d"):
        read_measured("gom", "a.csv")


@pytest.mark.parametrize(
    ("unit", "metres"), [("um", 1e-6), ("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("in", 0.0254)]
)
def test_units(tmp_path, unit, metres):
    path = write_table(tmp_path / "a.csv", VIC3D, vic3d_rows())
    measured = read_measured("vic3d", path, length_unit=unit)
    assert measured.points[1, 1] == metres * 5.0
    assert measured.displacement[1, 2] == metres * -0.06
    assert measured.notes == ()


@pytest.mark.parametrize("word", ["\u00b5m", "\u03bcm", "micron"])
def test_units_as_they_are_spelled(tmp_path, word):
    header = ",".join(f"{name} [{word}]" for name in "XYZUVW") + ",sigma"
    path = write_table(tmp_path / "a.csv", header, np.ones((2, 7)))
    assert read_measured("vic3d", path).points[0, 0] == 1e-6


@pytest.mark.parametrize(
    ("kind", "unit", "message"),
    [
        ("matchid", "m", "its header says mm, --length-unit says m; leave the option out"),
        ("matchid", "furlong", "--length-unit is 'furlong'; must be one of um mm cm m in"),
    ],
)
def test_units_that_contradict_or_are_unknown(tmp_path, kind, unit, message):
    path = write_table(tmp_path / "a.csv", MATCHID, np.ones((2, 8)), delimiter=";")
    with pytest.raises(RecordError, match=re.escape(message)):
        read_measured(kind, path, length_unit=unit)


@pytest.mark.parametrize("kind", ["vic3d", "matchid", "opencorr", "pyvale", "vtu"])
def test_files_of_one_state_have_one_frame(tmp_path, kind):
    path = write_table(tmp_path / "a.csv", VIC3D, vic3d_rows())
    with pytest.raises(RecordError, match="has no frame 1; it holds 1, so leave --frame out"):
        read_measured(kind, path, frame=1)


def test_infinity_is_no_measurement(tmp_path):
    path = write_table(tmp_path / "a.csv", VIC3D, vic3d_rows())
    path.write_text(path.read_text().replace("0.05", "1.#INF"))
    assert list(measured_rows(read_measured("vic3d", path).displacement)) == [
        True,
        False,
        True,
        False,
    ]
    path.write_text(path.read_text().replace("1.#INF", "inf"))
    assert list(measured_rows(read_measured("vic3d", path).displacement)) == [
        True,
        False,
        True,
        False,
    ]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.xml", b"<ParameterList></ParameterList>", "is no camera calibration"),
        ("a.xml", b"<project><b></project>", "is not valid XML"),
        ("a.yml", b"%YAML:1.0\n---\na: [1", "is not valid YAML"),
        ("a.yml", b"a: 1\nb: " + b"[" * 51 + b"]" * 51, "line 2: more than 50 brackets are open"),
        ("a.yml", b"- 1\n- 2\n", "is no camera calibration; known are rig.toml, DICe"),
        (
            "a.yml",
            b"a: 1\nb: 2\n",
            r"is no camera calibration \(it holds: a, b\); known are rig.toml",
        ),
        ("a.txt", b"hello", "is no camera calibration; known are"),
        (
            "a.tif",
            b"II*\x00\xff\xfe",
            "is not a text file in UTF-8, and no calibration of a known",
        ),
    ],
)
def test_unknown_files_are_refused(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(RecordError, match=message):
        read_rig(path)


def test_any_calibration_becomes_a_rig_toml(shared_data, tmp_path):
    rig = read_rig(shared_data / "real" / "gt4_dspec" / "cal_pyaldic.xml")
    write_rig(tmp_path / "rig.toml", rig)
    again = read_rig(tmp_path / "rig.toml")
    points = np.array([[0.0, 0.0, 0.38], [0.03, -0.01, 0.4]])
    for first, second in zip(rig.cameras, again.cameras, strict=True):
        np.testing.assert_allclose(project(second, points), project(first, points), atol=1e-9)


@pytest.fixture
def toml_file(tmp_path):
    """Function that writes rig.toml with a piece replaced and gives its path."""

    def write(old="", new=""):
        assert old in TOML
        path = tmp_path / "rig.toml"
        path.write_text(TOML.replace(old, new, 1) if old else TOML)
        return path

    return write


def _assert_same(first, other):
    assert first.reference == other.reference
    for a, b in zip(first.cameras, other.cameras, strict=True):
        assert (a.name, a.size) == (b.name, b.size)
        np.testing.assert_array_equal(a.matrix, b.matrix)
        np.testing.assert_array_equal(a.distortion, b.distortion)
        # A rotation is made exact once more on reading: rounding.
        np.testing.assert_allclose(a.T_camera_object, b.T_camera_object, rtol=0.0, atol=1e-15)


LENGTHS = st.floats(-10.0, 10.0)


def _is_name(text):
    """Whether files may be named after it."""
    try:
        check_file_names([text], what="camera")
    except InputError:
        return False
    return True


# Few of these are refused: what most names of any characters have is left out.
_CHARACTERS = st.characters(exclude_categories=["C", "Z"], exclude_characters='/\\:*?"<>|{}%')
NAMES = st.text(_CHARACTERS, min_size=1, max_size=40).filter(_is_name)


@settings(max_examples=40, deadline=None)
@given(
    cameras=st.lists(
        st.tuples(
            NAMES,
            st.none() | st.tuples(*[st.integers(1, 4 * 10**4)] * 2),
            st.tuples(st.floats(5e3, 1e6), st.floats(0.5, 2.0), *[st.floats(-1e6, 1e6)] * 3),
            st.lists(st.floats(-100.0, 100.0), max_size=8),
            st.tuples(*[st.floats(-3.0, 3.0)] * 3),
            st.tuples(LENGTHS, LENGTHS, LENGTHS),
        ),
        min_size=2,
        max_size=3,
        unique_by=lambda camera: unicodedata.normalize("NFC", camera[0]).casefold(),
    ),
    data=st.data(),
)
def test_whatever_is_written_is_read_back(tmp_path_factory, cameras, data):
    path = tmp_path_factory.mktemp("law") / "rig.toml"
    made = []
    for k, (name, size, (fx, ratio, cx, cy, skew), lens, turn, shift) in enumerate(cameras):
        pose = np.eye(4)
        # No two of them at one place, which is refused.
        pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), shift
        pose[0, 3] += 100.0 * k
        if size is not None:  # of which no camera may be an impossible one
            cx, cy, lens = 0.5 * size[0], 0.5 * size[1], []
        matrix = np.array([[fx, skew, cx], [0.0, ratio * fx, cy], [0.0, 0.0, 1.0]])
        made.append(Camera(name, size, matrix, np.array(lens), pose))
    rig = Rig(tuple(made), data.draw(st.integers(0, len(made) - 1)), "rig.toml")
    write_rig(path, rig)
    _assert_same(read_rig(path), rig)


def test_values_are_the_files_in_metres(toml_file):
    rig = read_rig(toml_file())
    left, right = rig.cameras
    assert (left.name, left.size, right.size, rig.reference) == ("left", (640, 480), None, 1)
    np.testing.assert_array_equal(left.matrix[0], [1400.0, 0.5, 319.5])
    np.testing.assert_array_equal(left.distortion, [0.1, -0.2, 0.001, 0.002, 0.3, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(right.T_camera_object[:3, 3], [-0.1, 0.005, 0.5], rtol=1e-15)
    np.testing.assert_array_equal(right.T_camera_object[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert rig.source.endswith("rig.toml")


def test_unit_of_the_file_comes_before_the_callers(toml_file):
    assert read_rig(toml_file(), length_unit="m").cameras[0].T_camera_object[2, 3] == 0.5
    path = toml_file('length_unit = "mm"\n')
    assert read_rig(path, length_unit="cm").cameras[0].T_camera_object[2, 3] == 5.0
    with pytest.raises(RecordError, match="the key 'length_unit' is missing"):
        read_rig(path)
    with pytest.raises(InputError, match=r"length_unit is 'km'.*\(allowed: m, cm, mm, in\)"):
        read_rig(path, length_unit="km")


def test_first_camera_is_the_reference_where_none_is_named(toml_file):
    assert read_rig(toml_file('reference = "right"\n')).reference == 0


def test_folder_stands_for_its_rig(toml_file):
    path = toml_file()
    _assert_same(read_rig(path.parent), read_rig(path))


def test_written_rig_reads_the_same(tmp_path):
    rng = np.random.default_rng(0)
    cameras = []
    for name, size in (("odd 'name' # 1", (640, 480)), ("second", None)):
        pose = np.eye(4)
        pose[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        pose[:3, :3] *= np.linalg.det(pose[:3, :3])
        pose[:3, 3] = rng.normal(size=3)
        matrix = np.array([[1234.5678901234567, 0.1, 300.0], [0.0, 4e3 / 3.0, 200.0], [0, 0, 1.0]])
        cameras.append(Camera(name, size, matrix, rng.normal(size=8), pose))
    rig = Rig(tuple(cameras), 1, "here")
    write_rig(tmp_path / "rig.toml", rig)
    _assert_same(read_rig(tmp_path / "rig.toml"), rig)


def test_rounded_rotation_is_made_exact(toml_file):
    c, s = np.round(np.cos(0.3), 8), np.round(np.sin(0.3), 8)
    path = toml_file(
        "R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]", f"R = [{c}, {-s}, 0, {s}, {c}, 0, 0, 0, 1]"
    )
    turn = read_rig(path).cameras[0].T_camera_object[:3, :3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(turn[0, 0], np.cos(0.3), atol=1e-8)


def test_rendered_rig(shared_data):
    rig = read_rig(shared_data / "halfball_images")
    assert [camera.name for camera in rig.cameras] == ["c0", "c1", "c2"]
    # Its README: 0.45 m away, all aiming at the object.
    for camera in rig.cameras:
        pose = camera.T_camera_object
        assert np.linalg.norm(pose[:3, 3]) == pytest.approx(0.46, abs=0.02)
        assert abs(pose[0, 3]) < 1e-6


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[640, 480]", "[640, 480.5]", r"'left' size is \[640, 480.5\]; must be two whole numbers"),
        ("[640, 480]", "[640]", "must be two whole numbers"),
        ("[640, 480]", "[640, -480]", "must be two whole numbers"),
        ("[0, 0, 500]", "[0, 500]", "'left' t has 2 numbers; must have 3"),
        ("[0, 0, 500]", '["far", 0, 0]', "'left' t is .*; must be numbers"),
        ("[0, 0, 500]", "[nan, 0, 0]", "'left' t is .*; must be finite"),
        ("[1400.0, 0.5, 319.5]", "[-1400.0, 0.5, 319.5]", "rig.toml: camera 'left': focal lengths"),
        ("[[1, 0, 0], [0, 1, 0]", "[[1, 0.1, 0], [0, 1, 0]", "R is not a rotation"),
        ("[0.1, -0.2, 0.001, 0.002, 0.3]", "[0, 0, 0, 0, 0, 0, 0, 0, 1]", "9 distortion terms"),
        (
            'name = "right"\nK',
            'name = "left"\nK',
            "camera 'left': there are files named 'left' already",
        ),
    ],
)
def test_wrong_numbers_are_a_calibration_error(toml_file, old, new, message):
    path = toml_file(old, new)
    if "already" in message:
        path.write_text(path.read_text().replace('reference = "right"\n', ""))
    with pytest.raises(CalibrationError, match=message):
        read_rig(path)


def test_files_that_are_not_there_or_not_written(tmp_path, toml_file):
    toml_file()
    with pytest.raises(RecordError, match=r"rg.toml: no such file; did you mean 'rig.toml'"):
        read_rig(tmp_path / "rg.toml")
    with pytest.raises(RecordError, match="no such file"):
        read_rig(tmp_path / "nowhere" / "rig.toml")
    with pytest.raises(RecordError, match="cannot be written"):
        write_rig(tmp_path / "nowhere" / "rig.toml", read_rig(tmp_path))
    (tmp_path / "other.toml").write_text("length_unit = ")
    with pytest.raises(RecordError, match="is not valid TOML"):
        read_rig(tmp_path / "other.toml")

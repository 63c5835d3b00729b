"""Which program wrote a file: units, states, and files of nobody."""

import re

import numpy as np
import pytest
from program_files import (
    vic3d_rows,
    write_table,
)

from palpate.errors import RecordError
from palpate.records import read_rig, write_rig
from palpate.records.probing import measured_rows
from palpate.records.program import Program, ProgramPoints, camera_matrix, make_pose
from palpate.records.programs import registry
from palpate.records.programs.registry import import_kinds, kinds_text, read_measured
from palpate.vision import project

VIC3D = '"x","y","u","v","sigma","X","Y","Z","U","V","W"'


MATCHID = (
    "Coordinates.Image X [Pixel];coor.X [mm];coor.Y [mm];coor.Z [mm];"
    "disp.Horizontal Displacement U [mm];disp.Vertical Displacement V [mm];"
    "disp.Out-Of-Plane: W [mm];stats.Sigma [mm]"
)


def test_kinds_of_the_command():
    kinds = ["dice", "vic3d", "matchid", "pyvale", "opencorr", "multidic", "duodic", "vtu"]
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


def test_nothing_measured(tmp_path):
    rows = vic3d_rows()
    rows[:, 4] = -1.0
    path = write_table(tmp_path / "a.csv", VIC3D, rows)
    with pytest.raises(RecordError, match="not one of its 4 points was measured"):
        read_measured("vic3d", path)


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


def test_unreadable_files_are_refused(tmp_path):
    with pytest.raises(RecordError, match="is no camera calibration, and it holds none; known are"):
        read_rig(tmp_path)
    folder = tmp_path / "x"
    (folder / "a.yml").mkdir(parents=True)
    with pytest.raises(RecordError, match=r"a\.yml: cannot be read"):
        read_rig(folder)


def test_any_calibration_becomes_a_rig_toml(shared_data, tmp_path):
    rig = read_rig(shared_data / "real" / "gt4_dspec" / "cal_pyaldic.xml")
    write_rig(tmp_path / "rig.toml", rig)
    again = read_rig(tmp_path / "rig.toml")
    points = np.array([[0.0, 0.0, 0.38], [0.03, -0.01, 0.4]])
    for one, two in zip(rig.cameras, again.cameras, strict=True):
        np.testing.assert_allclose(project(two, points), project(one, points), atol=1e-9)

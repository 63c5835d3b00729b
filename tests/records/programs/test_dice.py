"""DICe: text and Exodus results, and its camera system files."""

import numpy as np
import pytest
from program_files import (
    DICE_NAMES,
    GOOD,
    MOVE,
    PLACE,
    check_four_points,
    dice_gold,
    dice_states,
    dice_values,
    gold_columns,
    write_exodus,
    write_table,
)

from palpate.errors import CalibrationError, RecordError
from palpate.records import read_rig
from palpate.records.probing import measured_rows
from palpate.records.program import rotation_from_angles
from palpate.records.programs.registry import read_measured
from palpate.vision import triangulate


@pytest.mark.parametrize("delimiter", [",", " "])
def test_dice_text(tmp_path, delimiter):
    header = "***\n*** Incremental correlation: false\n***\n" + delimiter.join(DICE_NAMES)
    path = write_table(tmp_path / "a.txt", header, dice_values(), delimiter=delimiter)
    check_four_points(read_measured("dice", path))


@pytest.mark.parametrize("column", ["SIGMA", "MATCH"])
def test_dice_tells_failure_by_either_column(tmp_path, column):
    keep = [i for i, name in enumerate(DICE_NAMES) if name != column]
    header = ",".join(DICE_NAMES[i] for i in keep)
    check_four_points(
        read_measured("dice", write_table(tmp_path / "a.txt", header, dice_values()[:, keep]))
    )


def test_dice_without_signs_of_failure_says_so(tmp_path):
    path = write_table(tmp_path / "a.txt", ",".join(DICE_NAMES[:7]), dice_values()[:, :7])
    measured = read_measured("dice", path, length_unit="cm")
    assert measured_rows(measured.displacement).all()
    assert measured.points[0, 0] == 0.01
    assert measured.notes == (
        "It has no MATCH and no SIGMA, so failed points cannot be recognised.",
    )


def test_dice_incremental(tmp_path):
    header = "*** Incremental correlation: true\n" + ",".join(DICE_NAMES)
    path = write_table(tmp_path / "a.txt", header, dice_values())
    with pytest.raises(RecordError, match="from picture to picture"):
        read_measured("dice", path)


@pytest.mark.parametrize("form", ["large", "small", "hdf5"])
def test_dice_exodus(tmp_path, form):
    path = write_exodus(tmp_path / "a.e", dice_states(), form=form)
    measured = read_measured("dice", path)
    # hdf5 is written in single precision, as DICe does.
    np.testing.assert_allclose(measured.displacement[GOOD], 1e-3 * MOVE[GOOD], rtol=1e-7)
    np.testing.assert_allclose(measured.points, 1e-3 * PLACE, rtol=1e-7)
    assert list(measured_rows(measured.displacement)) == list(GOOD)
    assert measured.notes[0] == "It holds 3 states; the last, frame 2, was read (--frame)."
    half = read_measured("dice", path, frame=1)
    np.testing.assert_allclose(half.displacement, 0.5 * measured.displacement, rtol=1e-7)


def test_dice_exodus_refusals(tmp_path):
    path = write_exodus(tmp_path / "a.e", dice_states(), form="large")
    with pytest.raises(RecordError, match=r"every displacement is exactly zero.*--frame"):
        read_measured("dice", path, frame=0)
    with pytest.raises(RecordError, match="has no frame 3; it holds 3, numbered 0 to 2"):
        read_measured("dice", path, frame=3)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordError, match="is damaged or cut off"):
        read_measured("dice", path)
    path.write_bytes(b"CDF\x05" + whole[4:])
    with pytest.raises(RecordError, match="is not an Exodus file in NetCDF's classic"):
        read_measured("dice", path)
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(64))
    with pytest.raises(RecordError, match="is damaged or cut off"):
        read_measured("dice", path)
    path.unlink()
    with pytest.raises(RecordError, match="cannot be read"):
        read_measured("dice", path)


def test_dice_exodus_without_states_or_depth(tmp_path):
    path = write_exodus(tmp_path / "a.e", dice_states()[:0], form="hdf5")
    with pytest.raises(RecordError, match="holds no state"):
        read_measured("dice", path)
    path = write_exodus(tmp_path / "b.e", dice_states(), form="large")
    path.write_bytes(path.read_bytes().replace(b"MODEL_DISPLACEMENT_Z", b"SOMETHING_ELSE_OF_IT"))
    with pytest.raises(RecordError, match="has no MODEL_DISPLACEMENT_Z; it is a 2-D result"):
        read_measured("dice", path)


def test_dice_real_results(shared_data):
    """The known noise of the static series, and the four subsets that failed in the other."""
    static = shared_data / "real" / "dice_stereo_static" / "gold" / "DICe_solution_auto.e"
    measured = read_measured("dice", static)
    assert measured_rows(measured.displacement).sum() == 189
    # ../shared/data/real/dice_stereo_static/README.md: 0.7 / 0.4 / 3.2 um, rounded.
    spread = 1e6 * measured.displacement.std(axis=0)
    np.testing.assert_allclose(spread, [0.7, 0.4, 3.2], atol=0.05)
    gold = shared_data / "real" / "gt4_dspec" / "dice_gold"
    tension = read_measured("dice", gold / "DICe_solution.e", frame=-1)
    assert (~measured_rows(tension.displacement)).sum() == 4
    # Its README: motion is at most 18 um; the points scatter by some um about it.
    assert 15.0 < 1e6 * np.nanmedian(np.linalg.norm(tension.displacement, axis=1)) < 21.0
    with pytest.raises(RecordError, match="has no MODEL_COORDINATES_X; it is a 2-D result"):
        read_measured("dice", gold / "DICe_solution_2.txt")


DICE = """
<ParameterList>
<!-- DICe formatted camera system file -->
<Parameter name="xml_file_format" type="string" value="DICe_xml_camera_system_file" />
<Parameter name="system_type_3D" type="string" value="OPENCV" />
<Parameter name="extrinsics_relative_camera_to_camera" type="bool" value="true" />
<ParameterList name="CAMERA 0">
<Parameter name="CAMERA_ID" type="string" value="one" />
<Parameter name="CX" type="double" value="319.5" />
<Parameter name="CY" type="double" value="239.5" />
<Parameter name="FX" type="double" value="1400" />
<Parameter name="FY" type="double" value="1.41e+003" />
<Parameter name="K1" type="double" value="0.1" />
<Parameter name="P2" type="double" value="0.002" />
<Parameter name="K3" type="double" value="0.3" />
<Parameter name="LENS_DISTORTION_MODEL" type="string" value="OPENCV_LENS_DISTORTION" />
<Parameter name="ALPHA" type="double" value="10" />
<Parameter name="TZ" type="double" value="7" />
<Parameter name="IMAGE_HEIGHT_WIDTH" type="string" value="{ 480, 640 }" />
</ParameterList>
<ParameterList name="CAMERA 1">
<Parameter name="CAMERA_ID" type="string" value="" />
<Parameter name="CX" type="double" value="310.5" />
<Parameter name="CY" type="double" value="229.5" />
<Parameter name="FX" type="double" value="1300" />
<Parameter name="FY" type="double" value="1310" />
<Parameter name="TX" type="double" value="100" />
<ParameterList name="rotation_3x3_matrix">
<Parameter name="ROW 0" type="string" value="{ 0.0, -1.0, 0.0 }" />
<Parameter name="ROW 1" type="string" value="{ 1.0, 0.0, 0.0 }" />
<Parameter name="ROW 2" type="string" value="{ 0.0, 0.0, 1.0 }" />
</ParameterList>
</ParameterList>
</ParameterList>
"""


def _dice(tmp_path, old="", new=""):
    assert old in DICE
    path = tmp_path / "cal.xml"
    path.write_text(DICE.replace(old, new, 1))
    return path


def test_dice_order_and_chain(tmp_path):
    left, right = read_rig(_dice(tmp_path)).cameras
    assert (left.name, left.size, right.name, right.size) == (
        "one",
        (640, 480),
        "1",
        None,
    )
    np.testing.assert_array_equal(left.matrix, [[1400, 0, 319.5], [0, 1410, 239.5], [0, 0, 1]])
    np.testing.assert_array_equal(left.distortion, [0.1, 0, 0, 0.002, 0.3, 0, 0, 0])
    first = np.eye(4)
    first[:3, :3], first[2, 3] = rotation_from_angles([10.0, 0.0, 0.0]), 0.007
    np.testing.assert_allclose(left.T_camera_object, first, atol=1e-15)
    step = np.array([[0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    np.testing.assert_allclose(right.T_camera_object, step @ first, atol=1e-15)
    plain = read_rig(_dice(tmp_path, 'value="true"', 'value="false"')).cameras[1]
    np.testing.assert_allclose(plain.T_camera_object, step, atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name="FX"', 'name="FFX"', "camera 'one' has no 'FX'"),
        ("OPENCV_LENS_DISTORTION", "K1R1_K2R2_K3R3", "lens model K1R1_K2R2_K3R3; known are"),
        ("OPENCV_LENS_DISTORTION", "NO_LENS_DISTORTION", "has lens terms but"),
        ('name="TX"', 'name="FS"', "has FS 100, which DICe passes over"),
        ('name="P2"', 'name="S1"', "14 distortion terms"),
        ('name="ROW 2"', 'name="ROW 3"', "CAMERA 1: rotation_3x3_matrix has no 'ROW 2'"),
        ("{ 480, 640 }", "{ 480 }", "has 1 numbers; must have 2"),
        ('name="system_type_3D"', 'name="user_6_param_transform"', "would move the object frame"),
        ("CAMERA 1", "CAMRA 1", "has 1 camera; depth needs"),
    ],
)
def test_dice_contradictions(tmp_path, old, new, message):
    with pytest.raises(CalibrationError, match=message):
        read_rig(_dice(tmp_path, old, new))


def test_two_calibrations_of_one_rig_agree_on_dices_matches(shared_data):
    folder = shared_data / "real" / "gt4_dspec"
    gold = dice_gold(folder / "dice_gold" / "DICe_solution.e")
    fine = gold["SIGMA"] >= 0.0
    matches = np.stack(
        [
            gold_columns(gold, "COORDINATE_X", "COORDINATE_Y")[fine],
            gold_columns(gold, "STEREO_COORDINATES_X", "STEREO_COORDINATES_Y")[fine],
        ]
    )
    assert fine.sum() > 100
    depths, shapes = [], []
    for name in ("cal_vic3d.xml", "cal_pyaldic.xml"):
        rig = read_rig(folder / name)
        points = triangulate(rig, matches, 0.05)
        # Both programs report calibrations of some 0.05 px.
        assert np.sqrt(np.mean(points.residual**2)) < 0.06
        pose = rig.cameras[0].T_camera_object
        depths.append(points.point @ pose[2, :3] + pose[2, 3])
        shapes.append(points.point)
    # Two independent calibrations with a target: a fraction of a per cent.
    assert np.median(depths[0] / depths[1]) == pytest.approx(1.0, abs=0.003)
    assert np.median(depths[0]) == pytest.approx(0.383, abs=0.005)
    # DICe's points, in a frame of their own, have the shape of ours over 94 mm.
    model = 1e-3 * gold_columns(gold, *(f"MODEL_COORDINATES_{axis}" for axis in "XYZ"))[fine]
    a, b = shapes[0] - shapes[0].mean(axis=0), model - model.mean(axis=0)
    u, s, v = np.linalg.svd(a.T @ b)
    assert s.sum() / np.sum(a**2) == pytest.approx(1.0, abs=1e-4)
    # DICe triangulates linearly: 2 um here.
    assert (b - a @ u @ v).std(axis=0).max() < 3e-6

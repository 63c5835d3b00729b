"""MultiDIC and DuoDIC: reconstructions, and direct linear transformations."""

import shutil

import h5py
import numpy as np
import pytest
import scipy.io
from program_files import (
    GOOD,
    MOVE,
    PLACE,
    multidic_states,
    write_mat,
)

from palpate.errors import CalibrationError, RecordError
from palpate.records import read_rig
from palpate.records.probing import measured_rows
from palpate.records.program import rotation_from_angles
from palpate.records.programs.multidic import read_control_points
from palpate.records.programs.registry import read_measured
from palpate.vision import project


@pytest.mark.parametrize(("kind", "name"), [("duodic", "DIC3D"), ("multidic", "DIC3Dcombined")])
@pytest.mark.parametrize("version", ["5", "7.3"])
def test_multidic(tmp_path, kind, name, version):
    path = write_mat(tmp_path / "a.mat", name, multidic_states(), version=version)
    measured = read_measured(kind, path)
    assert list(measured_rows(measured.displacement)) == list(GOOD)
    # The difference of two places of 300 mm, each rounded to 6e-14 mm.
    np.testing.assert_allclose(measured.displacement[GOOD], 1e-3 * MOVE[GOOD], atol=1e-16)
    np.testing.assert_allclose(measured.points[GOOD], 1e-3 * PLACE[GOOD], atol=1e-16)
    assert np.isnan(measured.points[~GOOD]).all()
    half = read_measured(kind, path, frame=1)
    np.testing.assert_allclose(half.displacement[GOOD], 0.5e-3 * MOVE[GOOD], atol=1e-16)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_multidic_poor_matches(tmp_path, version):
    """1 - corrComb / 2 is the correlation; that of the first picture with itself is NaN."""
    criteria = [np.full((4, 1), np.nan), np.full((4, 1), 0.02), np.array([[0.1, 0.6, 0.2, 0.1]]).T]
    states = multidic_states()
    path = write_mat(tmp_path / "a.mat", "DIC3D", states, version=version, criteria=criteria)
    measured = read_measured("duodic", path)
    assert list(measured_rows(measured.displacement)) == [True, False, True, False]
    assert measured.poorly_correlated == 1
    assert read_measured("duodic", path, min_score=0.7).poorly_correlated == 0
    assert read_measured("duodic", path, frame=1).poorly_correlated == 0
    path = write_mat(
        tmp_path / "a.mat", "DIC3D", states, version=version, criteria=[c[:3] for c in criteria]
    )
    with pytest.raises(
        RecordError, match=r"3 arrays of correlation \(3 values\) do not belong to 3 of 4 points"
    ):
        read_measured("duodic", path)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_multidic_refusals(tmp_path, version):
    states = multidic_states()
    path = tmp_path / "a.mat"
    for content, message in (
        (states[:1], "Points3D holds 1 state"),
        ([state[:, :2] for state in states], "are n x 2; must be n x 3"),
        ([states[0], states[1][:3], states[2]], "differ in size"),
    ):
        with pytest.raises(RecordError, match=message):
            read_measured("multidic", write_mat(path, "DIC3D", content, version=version))
    write_mat(path, "DIC3D", states, version=version)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordError, match="is damaged or cut off"):
        read_measured("multidic", path)
    write_mat(path, "a", states, version=version)
    if version == "7.3":
        with h5py.File(path, "r+") as file:
            file["b/Points3D"] = file["a/Points3D"]
        with pytest.raises(RecordError, match=r"several structs with Points3D \(a, b\)"):
            read_measured("multidic", path)


def test_multidic_real_files_of_earlier_steps(shared_data):
    folder = shared_data / "real" / "multidic_pair"
    file = folder / "speckledObjectImages" / "DIC2DpairResults_C_201_C_202.mat"
    with pytest.raises(RecordError, match=r"it is the 2-D result of step 2: name .* --rig"):
        read_measured("multidic", file)
    file = folder / "calibrationObjectImages" / "DLTstruct_cam_201.mat"
    with pytest.raises(RecordError, match=r"give the file of the 3-D result .*DLTstructCam$"):
        read_measured("multidic", file)


def _dlt(camera):
    """Eleven numbers of a camera without a lens, for millimetres and pixels counted from 1."""
    matrix = camera.matrix.copy()
    matrix[:2, 2] += 1.0
    pose = camera.T_camera_object[:3].copy()
    pose[:, 3] *= 1e3
    projection = matrix @ pose
    return (projection / projection[2, 3]).ravel()[:11]


def _multidic(folder, rig, *, mirrored=False, **changes):
    """Files as MultiDIC writes them, of a calibration object of 4 x 3 points."""
    table = (
        1e-3
        * np.stack(np.meshgrid(np.arange(3.0), np.arange(4.0), [1.0], indexing="xy"), axis=-1)[
            :, :, 0
        ]
        * [10, 10, 5]
    )
    table[:, :, 2] += 1e-3 * np.arange(3.0) ** 2
    for number, camera in zip((201, 202), rig.cameras, strict=True):
        columns = np.array([1, 3])
        points = table[:, columns - 1].transpose(1, 0, 2).reshape(-1, 3)
        content = {
            "indCam": number,
            "columns": columns,
            "imageCentroids": project(camera, points) + 1.0,
            "DLTparams": _dlt(camera)[:, None],
            "C3Dtrue": 1e3 * table * ([1.0, 1.0, -1.0] if mirrored else 1.0),
        }
        content.update(changes)
        scipy.io.savemat(folder / f"DLTstruct_cam_{number}.mat", {"DLTstructCam": content})


@pytest.fixture
def plain_rig(tmp_path):
    path = tmp_path / "rig" / "rig.toml"
    path.parent.mkdir()
    text = 'length_unit = "m"\n'
    for name, x in (("201", 0.1), ("202", -0.1)):
        text += (
            f'[[camera]]\nname = "{name}"\nK = [1400.0, -3.0, 319.5, 0, 1410.0, 239.5, 0, 0, 1]\n'
            f"R = {np.round(rotation_from_angles([170.0, 100.0 * x, 5.0]), 12).ravel().tolist()}\n"
            f"t = [{x}, 0.02, 0.5]\n"
        )
    path.write_text(text)
    return read_rig(path)


def test_multidic_transformation_is_the_camera(tmp_path, plain_rig):
    _multidic(tmp_path, plain_rig)
    for path in (tmp_path, tmp_path / "DLTstruct_cam_202.mat"):
        rig = read_rig(path)
        assert [camera.name for camera in rig.cameras] == ["201", "202"]
        for read_camera, wanted in zip(rig.cameras, plain_rig.cameras, strict=True):
            # Rounding of the decomposition, relative to 1400 px.
            np.testing.assert_allclose(read_camera.matrix, wanted.matrix, atol=1e-8)
            np.testing.assert_allclose(
                read_camera.T_camera_object, wanted.T_camera_object, atol=1e-11
            )
            assert read_camera.size is None
            assert not read_camera.distortion.any()
    for known, camera in zip(read_control_points(tmp_path), plain_rig.cameras, strict=True):
        points, pixels = known
        assert points.shape == (8, 3)
        # Each camera's own pixels; rounding of a projection to some hundred pixels.
        np.testing.assert_allclose(project(camera, points), pixels, atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mirrored": True}, None),
        ({"DLTparams": np.ones(11)}, "are of no camera"),
        ({"DLTparams": np.ones(10)}, "DLTparams has 10 numbers; must have 11"),
        ({"imageCentroids": np.ones((3, 2))}, r"imageCentroids \(3, 2\) do not belong"),
        ({"columns": np.array([1, 9])}, "do not belong to the 2 columns"),
    ],
)
def test_multidic_contradictions(tmp_path, plain_rig, changes, message):
    _multidic(tmp_path, plain_rig, **changes)
    if message is None:
        # Left-handed coordinates of the object, for which the transformation was computed.
        for number in (201, 202):
            path = tmp_path / f"DLTstruct_cam_{number}.mat"
            content = scipy.io.loadmat(path, simplify_cells=True)["DLTstructCam"]
            content["DLTparams"][[2, 6, 10]] *= -1.0
            scipy.io.savemat(path, {"DLTstructCam": content})
        message = "behind the camera: its coordinates are left-handed"
    with pytest.raises(CalibrationError, match=message):
        read_rig(tmp_path)


def test_multidic_files_of_another_kind(tmp_path, plain_rig):
    _multidic(tmp_path, plain_rig)
    shutil.copy(tmp_path / "DLTstruct_cam_201.mat", tmp_path / "DLTstructPairs.mat")
    with pytest.raises(RecordError, match="give the folder with its files DLTstruct_cam"):
        read_rig(tmp_path / "DLTstructPairs.mat")
    scipy.io.savemat(tmp_path / "DLTstruct_cam_203.mat", {"x": 1.0})
    with pytest.raises(RecordError, match=r"cam_203\.mat: holds no transformation .* but x"):
        read_rig(tmp_path)
    (tmp_path / "DLTstruct_cam_203.mat").write_bytes(b"MATLAB 7.3 MAT-file" + bytes(200))
    with pytest.raises(RecordError, match=r"is no MATLAB file of version 5 to 7\.2"):
        read_rig(tmp_path)
    content = {"indCam": 203, "DLTparams": np.ones(11)}
    scipy.io.savemat(tmp_path / "DLTstruct_cam_203.mat", {"DLTstructCam": content})
    with pytest.raises(CalibrationError, match="has no 'C3Dtrue'"):
        read_control_points(tmp_path)
    (tmp_path / "DLTstruct_cam_203.mat").unlink()
    (tmp_path / "DLTstruct_cam_203.mat").mkdir()
    with pytest.raises(RecordError, match="cannot be read"):
        read_rig(tmp_path)


def test_multidic_files_as_published(shared_data):
    folder = shared_data / "real" / "multidic_pair" / "calibrationObjectImages"
    rig = read_rig(folder)
    for camera, known in zip(rig.cameras, read_control_points(folder), strict=True):
        error = project(camera, known[0]) - known[1]
        # What the lens makes of a transformation without one; there is no offset left by pixels
        # counted from another number, nor by a wrong column of points.
        assert np.sqrt(np.mean(error**2)) < 2.5
        np.testing.assert_allclose(error.mean(axis=0), 0.0, atol=0.05)

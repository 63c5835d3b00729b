"""An object with a mesh before a rig: from pictures whose truth is known, near and from nowhere."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palpate.calibration import ObjectView, find_instants, view_object, write_object_view
from palpate.errors import CalibrationError, RecordError
from palpate.geometry import TriangleMesh, read_mesh
from palpate.records import Rig, read_rig
from palpate.vision import moved_rig

_TERMS = ("rx", "ry", "rz", "tx", "ty", "tz")


@pytest.fixture(scope="module")
def scene(shared_data: Path) -> tuple[Rig, TriangleMesh, str]:
    """The true rig in the object's frame, the mesh, and pictures of one instant."""
    folder = shared_data / "rigid_rotation_z"
    mesh = read_mesh(folder / "mesh.ply", metres_per_unit=1.0)
    return read_rig(folder), mesh, str(folder / "images" / "s0_{camera}.png")


def _off(view: ObjectView, truth: Rig) -> tuple[float, float]:
    """How far the object is turned [deg] and its middle shifted [mm] before the first camera."""
    first, true = view.rig.cameras[0].T_camera_object, truth.cameras[0].T_camera_object
    away = np.linalg.inv(first) @ true
    turn = np.degrees(Rotation.from_matrix(away[:3, :3]).magnitude())
    return float(turn), 1e3 * float(np.linalg.norm(away[:3, 3]))


def test_a_rig_that_moved_is_mended_by_what_it_sees(
    scene: tuple[Rig, TriangleMesh, str], tmp_path: Path
) -> None:
    truth, mesh, pictures = scene
    names = ("c0.fx", *(f"{camera}.{term}" for camera in ("c1", "c2") for term in _TERMS))
    step = np.deg2rad([0.0, *([0.1, -0.08, 0.05, 0.0, 0.0, 0.0] * 2)])
    step[4:7] = step[10:13] = [3e-4, -2e-4, 2e-4]
    moved = moved_rig(truth, names, step)
    instants = find_instants(moved, pictures.replace("s0_", "s*_"))[:4]
    view = view_object(moved, mesh, instants, refine=True)
    made = view.refined
    assert made is not None
    assert made.better
    # Two pixels and more at first; windows match to a few hundredths.
    assert made.after < 0.03 < 1.0 < made.before
    # The mesh's own edges of 2 mm leave 0.05 degrees and 0.02 mm with the true rig.
    turn, _ = _off(view, truth)
    assert turn < 0.12
    assert view.registration.residual < 0.1e-3
    write_object_view(tmp_path, view, None)
    assert {path.name for path in tmp_path.iterdir()} == {
        "rig.toml", "rig_covariance.npz", "object_pose.json"
    }  # fmt: skip


@pytest.mark.slow
def test_an_object_is_found_from_nowhere(scene: tuple[Rig, TriangleMesh, str]) -> None:
    """The frame is that of the first camera: it says nothing of where the object is."""
    truth, mesh, pictures = scene
    back = np.linalg.inv(truth.cameras[0].T_camera_object)
    cameras = tuple(replace(c, T_camera_object=c.T_camera_object @ back) for c in truth.cameras)
    view = view_object(replace(truth, cameras=cameras), mesh, (pictures,))
    turn, shift = _off(view, truth)
    assert turn < 0.12
    assert shift < 0.1


@pytest.mark.slow
def test_a_mesh_in_another_unit_is_refused(scene: tuple[Rig, TriangleMesh, str]) -> None:
    rig, mesh, pictures = scene
    small = TriangleMesh(1e-3 * mesh.vertices, mesh.triangles)
    with pytest.raises(CalibrationError, match="is the unit of the mesh right"):
        view_object(rig, small, [pictures])


def test_a_star_stands_for_the_instants(scene: tuple[Rig, TriangleMesh, str]) -> None:
    truth, _, pictures = scene
    instants = find_instants(truth, pictures.replace("s0_", "s*_"))
    assert instants[0] == pictures
    assert len(instants) > 1
    with pytest.raises(RecordError, match="there is no file"):
        find_instants(truth, pictures.replace("s0_", "t*_"))

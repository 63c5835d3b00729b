"""Pose of the object relative to the cameras: as given, or registered from the first pictures."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from palpate.arrays import lengths
from palpate.errors import CalibrationError
from palpate.geometry import (
    Registration,
    TriangleMesh,
    check_registration,
    closest_points,
    free_motions_text,
)
from palpate.records import Camera, Rig, camera_centre
from palpate.shapes import Vector3
from palpate.vision import (
    StereoPoints,
    check_rig,
    near_object,
    object_frame,
    prepare_pictures,
    project,
    register_object,
    smooth_surface,
    stereo_points,
)

PoseChoice = Literal["auto", "given", "register"]

# A registration that does not converge does not contradict a given pose in which the points lie as
# close to the mesh: half of them within its RMS residual (for a normal distribution 68 % are).
_MAX_MEDIAN_RESIDUAL = 1.0
# A registration that moves the points by less than three of its standard deviations, or by less
# than 0.2 % of the diagonal, confirms the given pose.
_MIN_SIGNIFICANCE = 3.0
_MIN_MOVE = 0.002


def posed_rig(
    rig: Rig,
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    mesh: TriangleMesh,
    choice: PoseChoice,
) -> tuple[Rig, tuple[str, ...]]:
    """The rig with the object's pose as given or registered.

    Parameters
    ----------
    rig : Rig                       with the given pose
    pictures : sequence of c (rows, columns) float [grey levels]    first instant
    mesh : TriangleMesh
    choice : "auto", "given" or "register"      "auto" registers only where the stereo points of the
                                    pictures contradict the given pose

    Returns
    -------
    rig : Rig
    notes : tuple of str

    Raises
    ------
    CalibrationError                the rig does not fit the pictures, the object is not in view,
                                    or the pose is far off
    """
    _check_view(rig, pictures, mesh)
    prepared = prepare_pictures(rig, pictures)
    checked = check_rig(prepared)
    if choice == "given":
        return rig, checked.notes
    stereo = stereo_points(prepared)
    registration = register_object(rig, stereo, smooth_surface(mesh))
    if registration is None:
        count = int(near_object(stereo.point, mesh).sum())
        if choice == "auto":
            return rig, (*checked.notes, _unchecked(count))
        raise CalibrationError(
            f"{rig.source}: only {count} stereo points lie near the object, too few to register it;"
            " is the object in view of two cameras, and the guess of its pose within 5 degrees and"
            " 20 mm?"
        )
    free = free_motions_text(registration)
    free_notes = (_free_note(free),) if free else ()
    if choice == "auto" and _agrees(registration, _distance(stereo, mesh)):
        return rig, (*checked.notes, *free_notes)
    posed, note = _registered(rig, registration)
    return posed, (*checked.notes, note, *free_notes)


def _free_note(free: str) -> str:
    """A note on the motions that the object's shape does not determine."""
    if "sliding" in free:
        return f"the shape does not fix {free}, which is kept as given"
    axes = free.replace("turning about ", "")
    return f"the shape is symmetric about {axes}, so rotation is kept as given"


def _agrees(registration: Registration, distance: float) -> bool:
    """Whether the given pose explains the stereo points as well as the registered one.

    `distance` [m] is the median distance of the points from the mesh in the given pose.
    """
    if not registration.converged:
        return distance < _MAX_MEDIAN_RESIDUAL * registration.residual
    centre = registration.T_mesh_points @ np.append(registration.centre, 1.0)
    shift = float(np.linalg.norm(centre[:3] - registration.centre))
    moved = np.hypot(shift, _rotation_angle(registration.T_mesh_points) * registration.size)
    return bool(
        moved < max(_MIN_SIGNIFICANCE * registration.weakest_std, _MIN_MOVE * registration.diagonal)
    )


def _rotation_angle(pose: Float[np.ndarray, "4 4"]) -> float:
    """Angle of a rigid motion [rad]."""
    return float(np.arccos(np.clip((np.trace(pose[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)))


def _registered(rig: Rig, registration: Registration) -> tuple[Rig, str]:
    """The rig with the registered pose of the object, and a note on it."""
    try:
        check_registration(registration)
    except CalibrationError as error:
        raise CalibrationError(
            f"{rig.source}: {error} (`--pose given` takes the rig's pose as it is)"
        ) from error
    back = np.linalg.inv(registration.T_mesh_points)
    shift = registration.centre - (back @ np.append(registration.centre, 1.0))[:3]
    note = (
        "the object was registered: turned by"
        f" {np.degrees(_rotation_angle(back)):.2f} degrees and shifted by"
        f" {1e3 * np.linalg.norm(shift):.2f} mm from where the rig has it; stereo points lie"
        f" {1e3 * registration.residual:.2g} mm rms off the mesh, the pose is known to"
        f" {1e3 * registration.weakest_std:.2g} mm in its weakest direction"
    )
    return object_frame(rig, registration), note


def _distance(stereo: StereoPoints, mesh: TriangleMesh) -> float:
    """Median distance of stereo points near the object from the mesh [m]."""
    near = stereo.point[near_object(stereo.point, mesh)]
    return float(np.median(closest_points(mesh, near).distance))


def _check_view(rig: Rig, pictures: Sequence[Float[np.ndarray, "_ _"]], mesh: TriangleMesh) -> None:
    """Refuse a pose in which a camera sees nothing of the object, or stands inside it."""
    for camera, picture in zip(rig.cameras, pictures, strict=True):
        centre = camera_centre(camera)
        if _encloses(mesh, centre):
            place = ", ".join(f"{x:.3g}" for x in centre)
            raise CalibrationError(
                f"{rig.source}: camera '{camera.name}' stands inside the object, at ({place}) m;"
                " check its t and the rig's length_unit: x_camera = R x_object + t"
            )
        rows, columns = picture.shape
        if not _sees(camera, mesh, picture.shape):
            pixel = project(camera, mesh.vertices)
            middle = np.nanmedian(pixel, axis=0) if np.isfinite(pixel).any() else [np.nan, np.nan]
            raise CalibrationError(
                f"{rig.source}: camera '{camera.name}' does not see the object: none of its"
                f" {len(pixel)} vertices is in the picture of {columns} x {rows} pixels (their"
                f" middle is at {middle[0]:.0f}, {middle[1]:.0f});"
                f" {_pose_cure(camera, mesh, picture.shape)}"
            )


def _encloses(mesh: TriangleMesh, point: Vector3) -> bool:
    """Whether a closed mesh, whose triangles fill all directions from within, holds a point.

    Source
    ------
    Van Oosterom and Strackee, IEEE Transactions on Biomedical Engineering 30 (1983)
    """
    a, b, c = (mesh.vertices[mesh.triangles] - point).transpose(1, 0, 2)
    x, y, z = lengths(a), lengths(b), lengths(c)
    products = (a * b).sum(axis=1) * z + (b * c).sum(axis=1) * x + (c * a).sum(axis=1) * y
    half = np.arctan2((a * np.cross(b, c)).sum(axis=1), x * y * z + products)
    return abs(float(half.sum())) > np.pi


def _sees(camera: Camera, mesh: TriangleMesh, shape: tuple[int, ...]) -> bool:
    """Whether a vertex of the mesh is in a camera's picture of that shape."""
    pixel = project(camera, mesh.vertices)
    with np.errstate(invalid="ignore"):
        inside = (pixel >= 0.0) & (pixel <= [shape[1] - 1, shape[0] - 1])
    return bool(inside.all(axis=1).any())


def _pose_cure(camera: Camera, mesh: TriangleMesh, shape: tuple[int, ...]) -> str:
    """What to correct in the pose of a camera that does not see the object."""
    transposed, shrunk = camera.T_camera_object.copy(), camera.T_camera_object.copy()
    transposed[:3, :3] = transposed[:3, :3].T
    shrunk[:3, 3] *= 1e-3
    for pose, cure in (
        (transposed, "with its R transposed it would: x_camera = R x_object + t"),
        (shrunk, "with its t a thousandth it would: is t in mm? See length_unit"),
    ):
        if _sees(replace(camera, T_camera_object=pose), mesh, shape):
            return cure
    return "check R, t and the length units"


def _unchecked(count: int) -> str:
    return (
        f"only {count} stereo points of the first pictures lie near the object; the given pose was"
        " believed without a check"
    )

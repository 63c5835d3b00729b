"""Pictures that a session names, and the rig that took them in the object's frame.

Sequences of pictures, with digests of what their motions depend on; the pose of the object relative
to the cameras, as given, or registered from the first pictures.
"""

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from palpate.arrays import lengths
from palpate.checkpoints import content_digest
from palpate.errors import CalibrationError, InputError, RecordError
from palpate.geometry import (
    Registration,
    TriangleMesh,
    check_registration,
    closest_points,
    free_motions_text,
)
from palpate.records import Camera, Images, Rig, Session, camera_centre, file_sums, read_rig
from palpate.shapes import Vector3
from palpate.vision import (
    FlowMethod,
    StereoPoints,
    check_rig,
    near_object,
    object_frame,
    picture_path,
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


@dataclass(frozen=True, slots=True)
class Instant:
    """An instant with pictures.

    Attributes
    ----------
    name : str                      of the motion to it
    whose : str                     step or probing, for messages
    pattern : str                   of its picture files
    last : bool                     whether at full force
    """

    name: str
    whose: str
    pattern: str
    last: bool


@dataclass(frozen=True, slots=True)
class PictureSequence:
    """Instants whose motions are measured one after the other, all from the first one.

    Attributes
    ----------
    probing : str or None           the probing that they are of; None: a session's steps
    first : Instant
    later : tuple of Instant        in temporal order
    """

    probing: str | None
    first: Instant
    later: tuple[Instant, ...]


def picture_sequences(session: Session) -> Sequence[PictureSequence]:
    """The sequences of a session.

    Parameters
    ----------
    session : Session               with steps, or with probings of which some have images

    Returns
    -------
    sequence of PictureSequence     one of all steps, or one for each probing with images

    Raises
    ------
    InputError                      no images
    """
    if session.steps:
        first, *later = (
            Instant(step.name, f"step '{step.name}'", step.images, True) for step in session.steps
        )
        return [PictureSequence(None, first, tuple(later))]
    sequences = [
        _probing_sequence(probing.name, probing.images)
        for probing in session.probings
        if probing.images is not None
    ]
    if not sequences:
        raise InputError(
            f"{session.path}: none of its probings has images; give `images` and a [rig], or"
            " estimate from its displacement files with `palpate fit`"
        )
    return sequences


def motion_names(session: Session) -> list[str]:
    """Names of the motions of a session, in the order in which they are measured.

    Parameters
    ----------
    session : Session               with steps, or with probings of which some have images

    Returns
    -------
    list of str                     of every step but the first, or of every loaded image

    Raises
    ------
    InputError                      no images
    """
    return [instant.name for sequence in picture_sequences(session) for instant in sequence.later]


def motion_keys(session: Session, method: FlowMethod, pose: PoseChoice) -> dict[str | None, str]:
    """Digests of everything that the motions of each sequence depend on: method, pose, mesh,
    cameras, its pictures and what the session says of them; forces, contacts, supports and other
    probings may change.

    Parameters
    ----------
    session : Session               with steps, or with probings of which some have images
    method : FlowMethod             with its settings
    pose : PoseChoice

    Returns
    -------
    dict of str or None to str      probing, or None for the steps -> 64 hexadecimal digits; a
                                    picture that cannot be read has a part in them as such

    Raises
    ------
    InputError                      no images, no rig
    RecordError, CalibrationError   the rig cannot be read
    """
    sequences, folder, rig = picture_sequences(session), session.path.parent, session_rig(session)
    # Notes name the rig's file; a session that was moved as a whole is the same.
    rig = replace(rig, source=os.path.relpath(rig.source, folder))
    common = content_digest((rig, session.mesh, method, pose))
    patterns = {
        instant.pattern for sequence in sequences for instant in (sequence.first, *sequence.later)
    }
    # Once for each pattern: the pictures at rest may be those of all probings.
    sums = {pattern: _picture_sums(rig, pattern, folder) for pattern in patterns}
    return {
        sequence.probing: content_digest(
            (
                common,
                sequence,
                [sums[instant.pattern] for instant in (sequence.first, *sequence.later)],
            )
        )
        for sequence in sequences
    }


def picture_files(session: Session) -> dict[str | None, tuple[Path, ...]]:
    """Picture files of each sequence.

    Parameters
    ----------
    session : Session               with steps, or with probings of which some have images

    Returns
    -------
    dict of str or None to tuple of Path    probing, or None for the steps -> files, whether they
                                    exist or not

    Raises
    ------
    InputError                      no images, no rig
    RecordError, CalibrationError   the rig cannot be read
    """
    rig, folder = session_rig(session), session.path.parent
    return {
        sequence.probing: tuple(
            picture_path(camera, instant.pattern, folder)
            for instant in (sequence.first, *sequence.later)
            for camera in rig.cameras
        )
        for sequence in picture_sequences(session)
    }


def session_rig(session: Session) -> Rig:
    """The cameras of a session with images.

    Parameters
    ----------
    session : Session

    Returns
    -------
    Rig

    Raises
    ------
    InputError                      no rig
    RecordError, CalibrationError   the rig cannot be read
    """
    if session.rig is None:
        raise InputError(f"{session.path}: has images and no [rig] table; name the camera file")
    return read_rig(session.rig)


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
    *_, notes = check_rig(prepared)
    if choice == "given":
        return rig, notes
    stereo = stereo_points(prepared)
    registration = register_object(rig, stereo, smooth_surface(mesh))
    if registration is None:
        count = int(near_object(stereo.point, mesh).sum())
        if choice == "auto":
            return rig, (*notes, _unchecked(count))
        raise CalibrationError(
            f"{rig.source}: only {count} stereo points lie near the object, too few to register it;"
            " is the object in view of two cameras, and the guess of its pose within 5 degrees and"
            " 20 mm?"
        )
    free = free_motions_text(registration)
    free_notes = (_free_note(free),) if free else ()
    if choice == "auto" and _agrees(registration, _distance(stereo, mesh)):
        return rig, (*notes, *free_notes)
    posed, note = _registered(rig, registration)
    return posed, (*notes, note, *free_notes)


def _probing_sequence(name: str, images: Images) -> PictureSequence:
    """A probing at rest, and its later instants, the last of them at full force."""
    whose, count = f"probing '{name}'", len(images.loaded)
    later = tuple(
        Instant(name if k == count else f"{name}_{k}", whose, pattern, k == count)
        for k, pattern in enumerate(images.loaded, start=1)
    )
    return PictureSequence(name, Instant("rest", whose, images.rest, False), later)


def _picture_sums(rig: Rig, pattern: str, folder: Path) -> list[dict[str, str]]:
    """Checksum of each camera's picture; empty where it cannot be read."""
    sums = []
    for camera in rig.cameras:
        sum_of: dict[str, str] = {}
        with suppress(RecordError):
            sum_of = file_sums([picture_path(camera, pattern, folder)], start=folder)
        sums.append(sum_of)
    return sums


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
            position = ", ".join(f"{x:.3g}" for x in centre)
            raise CalibrationError(
                f"{rig.source}: camera '{camera.name}' stands inside the object, at ({position}) m;"
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

"""Pose of an object of known shape relative to a rig, from pictures of the object.

Stereo points of the surface are registered to the mesh: starting from the rig's own frame if the
points lie near the mesh there, otherwise from many orientations of the mesh.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from palpate.calibration.refinement import KnownSurface, Refined, Ties, refined_rig, tie_points
from palpate.errors import CalibrationError, RecordError
from palpate.geometry import (
    Registration,
    TriangleMesh,
    bounding_diagonal,
    check_registration,
    closest_points,
    free_motions_text,
    initial_pose,
    triangle_areas,
)
from palpate.progress import Progress, silent
from palpate.records import (
    Rig,
    RigCovariance,
    camera_centre,
    json_text,
    write_rig,
    write_rig_covariance,
    write_text,
)
from palpate.shapes import Points, Vector3
from palpate.vision import (
    MIN_POSE_POINTS,
    StereoMatches,
    StereoSettings,
    check_rig,
    object_frame,
    prepare_pictures,
    read_pictures,
    register_object,
    smooth_surface,
    stereo_matches,
    triangulated_matches,
)

POSE_FORMAT = "palpate-object-pose/1"
_SETTINGS = StereoSettings()
# Grid steps between windows that do not overlap, so that their noise is independent.
_INDEPENDENT_STEP = -(-_SETTINGS.subset // _SETTINGS.step)
# If the rig's frame is not the object's, the rotations of a cube are tried, each with a search over
# this angle: no rotation is farther than 63 degrees from one of them, few are farther than this.
_ANGLE = np.deg2rad(45.0)
_SEARCH_POINTS, _TRIAL_POINTS = 48, 300
# Number of best rotations refined with all points: an object may look nearly alike from two sides.
_KEPT = 4
# Median distance from the mesh above which the frame is not the object's [diagonals].
_FAR = 0.1
# Largest ratio of a refined rig's registration residual to that of the given one.
_MAX_RESIDUAL_RATIO = 1.02


@dataclass(frozen=True, slots=True, eq=False)
class ObjectView:
    """A rig in the frame of an object.

    Attributes
    ----------
    rig : Rig                       object frame; refined if requested and an improvement
    registration : Registration     of the points to the mesh, from the rig's original frame
    covariance : (6, 6) float       of the object's pose: rotation [rad] about the centroid of the
                                    points and shift [m], object frame
    points : int                    number of surface points
    refined : Refined or None       None: not requested
    grey : tuple of c (rows, columns) float [grey levels]   the first instant
    notes : tuple of str
    """

    rig: Rig
    registration: Registration
    covariance: Float[np.ndarray, "6 6"]
    points: int
    refined: Refined | None
    grey: tuple[Float[np.ndarray, "_ _"], ...]
    notes: tuple[str, ...]


def find_instants(rig: Rig, pattern: str) -> tuple[str, ...]:
    """Expand a pattern of picture files into one pattern per instant.

    Parameters
    ----------
    rig : Rig
    pattern : str                   with `{camera}` in place of the camera's name; one `*` in the
                                    file name stands for the instants

    Returns
    -------
    tuple of str                    in the order of names; the pattern itself if it has no `*`

    Raises
    ------
    RecordError                     there are no such pictures; more than one `*`, or one in the
                                    folder's name
    """
    if "*" not in pattern:
        return (pattern,)
    reference = rig.cameras[rig.reference].name
    mine = Path(pattern.replace("{camera}", reference))
    if pattern.count("*") > 1 or "*" in str(mine.parent):
        raise RecordError(f"{pattern}: one * in the name of the files stands for the instants")
    before, _, after = mine.name.partition("*")
    form = re.compile(f"{re.escape(before)}(.*){re.escape(after)}")
    names = sorted(path.name for path in mine.parent.glob(mine.name))
    stars = [match.group(1) for name in names if (match := form.fullmatch(name))]
    if not stars:
        raise RecordError(
            f"{pattern}: there is no file {mine}; give the pictures of the object at rest, with"
            " {camera} in place of the camera's name"
        )
    return tuple(pattern.replace("*", star) for star in stars)


def view_object(
    rig: Rig,
    mesh: TriangleMesh,
    instants: Sequence[str],
    *,
    known: RigCovariance | None = None,
    refine: bool = False,
    progress: Progress = silent,
) -> ObjectView:
    """Find the pose of the object relative to the rig and, if requested, refine the rig.

    Parameters
    ----------
    rig : Rig                       in any frame; the object is first searched for near its frame,
                                    so that within 5 degrees and 20 mm no global search is needed
    mesh : TriangleMesh             of the object
    instants : sequence of str      patterns of pictures; the pose is that in the first, the others
                                    are used only for refinement
    known : RigCovariance or None   of the rig
    refine : bool                   refine the rig
    progress : callable

    Returns
    -------
    ObjectView

    Raises
    ------
    RecordError, CalibrationError   pictures cannot be read or do not show the object; the points
                                    cannot be registered to the mesh, or are too few for refinement
    """
    matches, grey = [], []
    notes: list[str] = []
    for k, pattern in enumerate(instants if refine else instants[:1]):
        progress(pattern, 0.8 * k / len(instants))
        read = read_pictures(rig, pattern, folder=Path(), what=f"pictures '{pattern}'")
        grey.append(read.grey)
        prepared = prepare_pictures(rig, read.grey)
        # With `refine`, a moved camera is to be corrected, not rejected.
        notes += [] if refine else check_rig(prepared)[2]
        matches.append(stereo_matches(prepared, settings=_SETTINGS))
    progress("registration", 0.8)
    registration, points = _registered(rig, mesh, matches[0])
    refined = None
    if refine:
        progress("refinement", 0.9)
        surface = _surface(rig, mesh, registration, _ties(rig, matches[:1], step=1))
        refined = refined_rig(rig, known, _ties(rig, matches, step=_INDEPENDENT_STEP), surface)
        if refined.better:
            trial, trial_points = _registered(refined.rig, mesh, matches[0])
            if trial.residual < _MAX_RESIDUAL_RATIO * registration.residual:
                rig, registration, points = refined.rig, trial, trial_points
            else:
                refined = replace(refined, rig=rig, better=False)
    free = free_motions_text(registration)
    if free:
        notes.append(f"the surface does not fix {free}: left as it was found first")
    return ObjectView(
        object_frame(rig, registration), registration, registration.covariance,
        points, refined, grey[0], tuple(notes),
    )  # fmt: skip


def _ties(rig: Rig, matches: Sequence[StereoMatches], *, step: int) -> Ties:
    """Tie points from matches, `step` grid steps apart, with a covariance for each camera."""
    pixels, covariance = [], []
    for instant in matches:
        cell = np.rint((instant.pixel - instant.pixel.min(axis=0, initial=np.inf)) / _SETTINGS.step)
        chosen = (cell % step == 0).all(axis=1)
        pixels.append(instant.pixels[:, chosen])
        covariance.append(instant.covariance[:, chosen])
    every, noise = np.concatenate(pixels, axis=1), np.concatenate(covariance, axis=1)
    # Every match is with the reference picture, which contributes half of its noise.
    seen = np.isfinite(every).all(axis=2)
    seen[rig.reference] = False
    half = np.where(seen[..., None, None], 0.5 * noise, 0.0)
    half[rig.reference] = half.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)[:, None, None]
    visible = seen.any(axis=0)
    return Ties(every[:, visible], half[:, visible])


def _registered(rig: Rig, mesh: TriangleMesh, matches: StereoMatches) -> tuple[Registration, int]:
    """Register the points of an instant to the mesh, from the rig's frame or from many rotations;
    also returns their number."""
    stereo = triangulated_matches(rig, matches, settings=_SETTINGS)
    points = stereo.point
    if len(points) < MIN_POSE_POINTS:
        raise CalibrationError(
            f"{len(points)} points of the object are seen by two cameras; {MIN_POSE_POINTS} are"
            " needed: is the object textured, and do the cameras see it together?"
        )
    smooth = smooth_surface(mesh)
    eye = camera_centre(rig.cameras[rig.reference])
    starts = (None, *_searched(mesh, points, eye)) if _far(mesh, points) else (None,)
    tried = [register_object(rig, stereo, smooth, start=start) for start in starts]
    made = [registration for registration in tried if registration is not None]
    if not made:
        raise CalibrationError(
            f"of {len(points)} points that two cameras see, fewer than {MIN_POSE_POINTS} lie"
            " together as the object's would; is it in the pictures, and is the unit of the mesh"
            " right?"
        )
    best = min(made, key=lambda registration: registration.residual / registration.inliers)
    try:
        check_registration(best)
    except CalibrationError as error:
        raise CalibrationError(
            f"{error} A textured table or wall in the pictures may be in the way: cover it, or give"
            " a rig whose frame is near the object's"
        ) from error
    return best, len(points)


def _surface(rig: Rig, mesh: TriangleMesh, registration: Registration, ties: Ties) -> KnownSurface:
    """The mesh with the tie points that lie near it."""
    smooth, pose = smooth_surface(mesh), registration.T_mesh_points
    point = tie_points(rig, ties) @ pose[:3, :3].T + pose[:3, 3]
    known = np.isfinite(point).all(axis=1)
    gap = closest_points(smooth, np.where(known[:, None], point, 0.0)).distance
    return KnownSurface(smooth, pose, ties.chosen(known & (gap < _FAR * bounding_diagonal(smooth))))


def _far(mesh: TriangleMesh, points: Points) -> bool:
    """Whether the points are far from the mesh in the rig's own frame."""
    gap = closest_points(mesh, points[:: max(len(points) // _TRIAL_POINTS, 1)]).distance
    return bool(np.median(gap) > _FAR * bounding_diagonal(mesh))


def _searched(mesh: TriangleMesh, points: Points, eye: Vector3) -> list[Float[np.ndarray, "4 4"]]:
    """The best poses from a search over rotations of the mesh, best first."""
    few = points[:: max(len(points) // _TRIAL_POINTS, 1)]
    middle = np.median(points, axis=0)
    away = 0.2 * bounding_diagonal(mesh)
    tries = []
    for turn in Rotation.create_group("O").as_matrix():
        start = np.eye(4)
        start[:3, :3] = turn
        start[:3, 3] = _front(mesh, turn @ (eye - middle)) - turn @ middle
        pose = initial_pose(
            points,
            mesh,
            start=start,
            viewpoint=eye,
            angle=_ANGLE,
            distance=away,
            count=_SEARCH_POINTS,
        )
        gap = closest_points(mesh, few @ pose[:3, :3].T + pose[:3, 3]).distance
        tries.append((float(np.median(gap)), pose))
    return [pose for _, pose in sorted(tries, key=lambda attempt: attempt[0])[:_KEPT]]


def _front(mesh: TriangleMesh, toward: Vector3) -> Vector3:
    """Centroid of the triangles that face a direction."""
    corner = mesh.vertices[mesh.triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    weight = triangle_areas(mesh) * (normal @ toward > 0.0)
    return np.asarray(np.average(corner.mean(axis=1), axis=0, weights=weight))


def write_object_view(folder: Path, view: ObjectView, known: RigCovariance | None) -> None:
    """Write rig.toml in the object's frame, its covariance if known, and object_pose.json.

    Parameters
    ----------
    folder : Path                   exists
    view : ObjectView
    known : RigCovariance or None   of the rig as given; replaced by that of a refined rig

    Raises
    ------
    RecordError                     a file cannot be written
    """
    write_rig(folder / "rig.toml", view.rig)
    if view.refined is not None and view.refined.better:
        known = view.refined.known
    if known is not None:
        write_rig_covariance(folder, known)
    registration = view.registration
    content = {
        "format": POSE_FORMAT,
        "T_object_rig": registration.T_mesh_points,
        "centre": registration.centre,
        "covariance": view.covariance,
        "points": view.points,
        "residual": registration.residual,
        "refined": None if view.refined is None else view.refined.better,
    }
    write_text(folder / "object_pose.json", json_text(content))

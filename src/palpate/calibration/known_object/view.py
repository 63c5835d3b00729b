"""A rig before an object whose surface is known: where the object stands, from its pictures.

Points of the surface from all cameras are brought onto the mesh: near the pose that the rig says,
if it says one; else from many turns of the mesh before the cameras.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from palpate.calibration.known_object.body import KnownSurface
from palpate.calibration.known_object.refine import Refined, refined_rig
from palpate.calibration.known_object.ties import Ties, places
from palpate.errors import CalibrationError, RecordError
from palpate.geometry import (
    Registration,
    TriangleMesh,
    bounding_diagonal,
    check_registration,
    closest_points,
    free_motions_text,
    rough_pose,
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
    LEAST_POINTS,
    StereoMatches,
    StereoSettings,
    check_rig,
    joined_matches,
    object_frame,
    prepare_pictures,
    read_pictures,
    register_object,
    smooth_surface,
    stereo_matches,
)

POSE_FORMAT = "palpate-object-pose/1"
_SETTINGS = StereoSettings()
# Every so many points of the grid have windows that do not overlap: their noise is their own.
_APART = -(-_SETTINGS.subset // _SETTINGS.step)
# Where the rig says nothing of the object, the turns of a cube are tried, and from each so far on:
# no turn is farther than 63 degrees from one of them, and few are farther than this.
_ANGLE = np.deg2rad(45.0)
_SEARCH_POINTS, _TRIAL_POINTS = 48, 300
# Of these turns, the best that all points try; an object may look nearly alike from two sides.
_KEPT = 4
# Half of the points are farther from the mesh where the frame is not the object's [diagonals].
_FAR = 0.1
# A refined rig must bring the surface as near to the mesh as the given one did, chance aside.
_NO_WORSE = 1.02


@dataclass(frozen=True, slots=True, eq=False)
class ObjectView:
    """A rig in the frame of an object.

    Attributes
    ----------
    rig : Rig                       object frame, refined where that was asked for and better
    registration : Registration     of the points onto the mesh, in the rig's old frame
    covariance : (6, 6) float       of the object's pose: a turn [rad] about the middle of the seen
                                    points and a shift [m], object frame
    points : int                    of the surface
    refined : Refined or None       None: not asked for
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
    """Patterns of the pictures of single instants.

    Parameters
    ----------
    rig : Rig
    pattern : str                   of picture files, `{camera}` in place of the camera's name; a
                                    `*` stands for the instants

    Returns
    -------
    tuple of str                    the pattern itself where it has no star; in the order of names

    Raises
    ------
    RecordError                     no such pictures, or more than one star
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
    stars = [found.group(1) for name in names if (found := form.fullmatch(name))]
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
    """Find the object before the rig; and correct the rig by its texture.

    Parameters
    ----------
    rig : Rig                       in any frame; where it is the object's, within 5 degrees and 20
                                    mm, the object is sought there first
    mesh : TriangleMesh             of the object
    instants : sequence of str      patterns of pictures; the object stands as in the first of them,
                                    the others only help to refine
    known : RigCovariance or None   what is known of the rig
    refine : bool                   correct the rig
    progress : callable

    Returns
    -------
    ObjectView

    Raises
    ------
    RecordError, CalibrationError   pictures that cannot be read or do not show the object; points
                                    that cannot be brought onto the mesh; too few to refine the rig
    """
    found, grey = [], []
    notes: list[str] = []
    for k, pattern in enumerate(instants if refine else instants[:1]):
        progress(pattern, 0.8 * k / len(instants))
        read = read_pictures(rig, pattern, folder=Path(), what=f"pictures '{pattern}'")
        grey.append(read.grey)
        prepared = prepare_pictures(rig, read.grey)
        # What a camera that has moved misses by is to be mended, not refused.
        notes += [] if refine else check_rig(prepared).notes
        found.append(stereo_matches(prepared, settings=_SETTINGS))
    progress("registration", 0.8)
    registration, points = _registered(rig, mesh, found[0])
    refined = None
    if refine:
        progress("refinement", 0.9)
        surface = _surface(rig, mesh, registration, _ties(rig, found[:1], apart=1))
        refined = refined_rig(rig, known, _ties(rig, found, apart=_APART), surface)
        if refined.better:
            trial, trial_points = _registered(refined.rig, mesh, found[0])
            if trial.residual < _NO_WORSE * registration.residual:
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


def _ties(rig: Rig, found: Sequence[StereoMatches], *, apart: int) -> Ties:
    """Matches of instants, so many steps of the grid apart; each camera's noise its own."""
    pixels, covariance = [], []
    for one in found:
        cell = np.rint((one.pixel - one.pixel.min(axis=0, initial=np.inf)) / _SETTINGS.step)
        chosen = (cell % apart == 0).all(axis=1)
        pixels.append(one.pixels[:, chosen])
        covariance.append(one.covariance[:, chosen])
    every, noise = np.concatenate(pixels, axis=1), np.concatenate(covariance, axis=1)
    # Every match is against the reference picture: half of its noise is of that.
    seen = np.isfinite(every).all(axis=2)
    seen[rig.reference] = False
    half = np.where(seen[..., None, None], 0.5 * noise, 0.0)
    half[rig.reference] = half.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)[:, None, None]
    some = seen.any(axis=0)
    return Ties(every[:, some], half[:, some])


def _registered(rig: Rig, mesh: TriangleMesh, found: StereoMatches) -> tuple[Registration, int]:
    """The points of an instant on the mesh, near the frame's own pose, or from many turns; and how
    many there are."""
    stereo = joined_matches(rig, found, settings=_SETTINGS)
    points = stereo.point
    if len(points) < LEAST_POINTS:
        raise CalibrationError(
            f"{len(points)} points of the object are seen by two cameras; {LEAST_POINTS} are"
            " needed: is the object textured, and do the cameras see it together?"
        )
    smooth = smooth_surface(mesh)
    eye = camera_centre(rig.cameras[rig.reference])
    starts = (None, *_searched(mesh, points, eye)) if _far(mesh, points) else (None,)
    tried = [register_object(rig, stereo, smooth, start=start) for start in starts]
    made = [one for one in tried if one is not None]
    if not made:
        raise CalibrationError(
            f"of {len(points)} points that two cameras see, fewer than {LEAST_POINTS} lie together"
            " as the object's would; is it in the pictures, and is the unit of the mesh right?"
        )
    best = min(made, key=lambda one: one.residual / one.inliers)
    try:
        check_registration(best)
    except CalibrationError as error:
        raise CalibrationError(
            f"{error} A textured table or wall in the pictures may be in the way: cover it, or give"
            " a rig whose frame is near the object's"
        ) from error
    return best, len(points)


def _surface(rig: Rig, mesh: TriangleMesh, registration: Registration, ties: Ties) -> KnownSurface:
    """The mesh with the seen points that lie near it."""
    smooth, pose = smooth_surface(mesh), registration.T_mesh_points
    point = places(rig, ties) @ pose[:3, :3].T + pose[:3, 3]
    known = np.isfinite(point).all(axis=1)
    gap = closest_points(smooth, np.where(known[:, None], point, 0.0)).distance
    return KnownSurface(smooth, pose, ties.chosen(known & (gap < _FAR * bounding_diagonal(smooth))))


def _far(mesh: TriangleMesh, points: Points) -> bool:
    """Whether the points do not lie on the mesh as the frame has it, nor nearly."""
    gap = closest_points(mesh, points[:: max(len(points) // _TRIAL_POINTS, 1)]).distance
    return bool(np.median(gap) > _FAR * bounding_diagonal(mesh))


def _searched(mesh: TriangleMesh, points: Points, eye: Vector3) -> list[Float[np.ndarray, "4 4"]]:
    """The best poses from many turns of the mesh before the cameras."""
    few = points[:: max(len(points) // _TRIAL_POINTS, 1)]
    middle = np.median(points, axis=0)
    away = 0.2 * bounding_diagonal(mesh)
    tries = []
    for turn in Rotation.create_group("O").as_matrix():
        start = np.eye(4)
        start[:3, :3] = turn
        start[:3, 3] = _front(mesh, turn @ (eye - middle)) - turn @ middle
        pose = rough_pose(
            points, mesh, start=start, eye=eye, angle=_ANGLE, distance=away, count=_SEARCH_POINTS
        )
        gap = closest_points(mesh, few @ pose[:3, :3].T + pose[:3, 3]).distance
        tries.append((float(np.median(gap)), pose))
    return [pose for _, pose in sorted(tries, key=lambda one: one[0])[:_KEPT]]


def _front(mesh: TriangleMesh, toward: Vector3) -> Vector3:
    """Middle of the triangles that turn to a direction."""
    corner = mesh.vertices[mesh.triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    weight = triangle_areas(mesh) * (normal @ toward > 0.0)
    return np.asarray(np.average(corner.mean(axis=1), axis=0, weights=weight))


def write_object_view(folder: Path, view: ObjectView, known: RigCovariance | None) -> None:
    """Write rig.toml in the object's frame, what is known of it, and object_pose.json.

    Parameters
    ----------
    folder : Path                   exists
    view : ObjectView
    known : RigCovariance or None   of the rig as it was given

    Raises
    ------
    RecordError                     a file cannot be written
    """
    write_rig(folder / "rig.toml", view.rig)
    if view.refined is not None and view.refined.better:
        known = view.refined.known
    if known is not None:
        write_rig_covariance(folder, known)
    found = view.registration
    content = {
        "format": POSE_FORMAT,
        "T_object_rig": found.T_mesh_points,
        "centre": found.centre,
        "covariance": view.covariance,
        "points": view.points,
        "residual": found.residual,
        "refined": None if view.refined is None else view.refined.better,
    }
    write_text(folder / "object_pose.json", json_text(content))

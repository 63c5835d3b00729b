"""Whether a rig fits the pictures that it is given with, told by features that two cameras share.

A feature of one picture lies on a line of the other that follows from the rig, and in front of both
cameras. Where that is not so another order of the pictures is tried. Where the object's surface is
given, the features that lie on it say whether it is where the rig's pose says.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import cv2
import numpy as np
from jaxtyping import Float

from palpate.errors import CalibrationError, InputError
from palpate.geometry import (
    RegistrationSettings,
    TriangleMesh,
    bounding_diagonal,
    closest_points,
    register,
)
from palpate.records import Camera, Rig
from palpate.shapes import Points, PointScalars, Triangles, Vertices
from palpate.vision.cameras import SurfaceMap, normalised, project, rays, surface_map, triangulate
from palpate.vision.images import Matches, find_features, make_even_picture, matched

# Half a speckle: cameras that are farther off their epipolar lines see different speckles in the
# windows around one point [px].
_LIMIT = 2.0
# A rig is blamed only for what is several times the error of the features themselves.
_TIMES_NOISE = 4.0
# From here on a remark is due [px]: ten times the error of a match of a window.
_WORTH_A_NOTE = 0.5
# Fewer features in common may be chance.
_FEWEST = 12
# More cameras than this have too many orders to try.
_MOST_TO_SWAP = 4
# The object covers fewer pixels than two windows: it is not in view.
_IN_VIEW = 1000
# The pose is far off where features lie this share of the diagonal off the surface, and several
# standard deviations of their own, half a pixel in each picture.
_FAR, _SIGMAS, _FEATURE_ERROR = 0.03, 5.0, 0.5

_Pairs = dict[tuple[int, int], Matches]


@dataclass(frozen=True, slots=True)
class RigCheck:
    """How well the cameras' pictures agree with the rig.

    Attributes
    ----------
    residual : tuple of float [px]      median distance of features from their epipolar lines, for
                                        each camera but the reference; NaN where too few are shared
    matches : tuple of int              features that these rest on
    offset : float [m]                  median distance of features from the surface; NaN where it
                                        was not given or too few lie on it
    notes : tuple of str                what could not be checked, or fits badly
    """

    residual: tuple[float, ...]
    matches: tuple[int, ...]
    offset: float
    notes: tuple[str, ...]


def check_rig(
    rig: Rig,
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    *,
    surface: tuple[Vertices, Triangles] | None = None,
) -> RigCheck:
    """Compare the pictures of one instant with the rig, and with the object's surface.

    Parameters
    ----------
    rig : Rig                       c cameras
    pictures : sequence of c (rows, columns) float [grey levels]    in the rig's order
    surface : ((v, 3) float [m], (m, 3) int) or None    of the object, in its frame

    Returns
    -------
    RigCheck

    Raises
    ------
    CalibrationError                features lie more than two pixels off their epipolar lines, or
                                    behind the cameras: the text says whether swapped pictures
                                    explain it; the surface is not in view, or far from the features
    InputError                      another number of pictures; a picture without any texture
    """
    pairs = _all_matches(rig, pictures)
    others = [c for c in range(len(rig.cameras)) if c != rig.reference]
    order = tuple(range(len(rig.cameras)))
    residual, count, notes = [], [], []
    worst = 0.0
    for c in others:
        found = pairs[min(c, rig.reference), max(c, rig.reference)]
        first, second = rig.cameras[rig.reference], rig.cameras[c]
        count.append(len(found.first))
        if len(found.first) < _FEWEST:
            residual.append(float("nan"))
            notes.append(_too_few(first, second, len(found.first)))
            continue
        value = _misfit(rig, order, pairs, (rig.reference, c))
        residual.append(value)
        if value > max(_LIMIT, _TIMES_NOISE * _own_error(rig, pairs, (rig.reference, c))):
            worst = max(worst, value)
        elif value > _WORTH_A_NOTE:
            notes.append(
                f"the rig fits the pictures of cameras '{first.name}' and '{second.name}' to"
                f" {value:.1f} px only: depths are off by a part of that"
            )
    if worst > 0.0:
        raise CalibrationError(_explanation(rig, pairs, worst))
    offset = float("nan")
    if surface is not None:
        offset, more = _surface_offset(rig, pictures, surface, pairs)
        notes += more
    return RigCheck(tuple(residual), tuple(count), offset, tuple(notes))


def _all_matches(rig: Rig, pictures: Sequence[Float[np.ndarray, "_ _"]]) -> _Pairs:
    """Features that every two pictures share."""
    if len(pictures) != len(rig.cameras):
        raise InputError(f"{len(pictures)} pictures for {len(rig.cameras)} cameras; give one each")
    features = []
    for camera, picture in zip(rig.cameras, pictures, strict=True):
        found = find_features(make_even_picture(picture))
        if len(found.point) == 0:
            raise InputError(
                f"the picture of camera '{camera.name}' shows no texture (grey levels"
                f" {picture.min():.0f} to {picture.max():.0f}); nothing can be followed in it."
                " Speckles need three times the contrast of the noise: paint, light, focus"
            )
        features.append(found)
    return {
        (i, j): _consistent(rig.cameras[i], rig.cameras[j], matched(features[i], features[j]))
        for i, j in combinations(range(len(features)), 2)
    }


def _consistent(first: Camera, second: Camera, found: Matches) -> Matches:
    """The matches that agree on one epipolar geometry, whichever; none where most do not.

    Matches by chance agree on none: any seven lie on one, few more do.
    """
    flat = [_straight(first, found.first), _straight(second, found.second)]
    known = np.flatnonzero(np.isfinite(np.hstack(flat)).all(axis=1))
    nothing = found.chosen(known[:0])
    if len(known) < _FEWEST:
        return nothing
    _, inlier = cv2.findFundamentalMat(flat[0][known], flat[1][known], cv2.FM_RANSAC, _LIMIT, 0.999)
    if inlier is None or inlier.sum() - 7 < 0.5 * (len(known) - 7):
        return nothing
    return found.chosen(known[inlier.ravel() > 0])


def _straight(camera: Camera, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Pixels as without a lens, about the optical axis [px]."""
    return normalised(camera, pixels) * camera.matrix[0, 0]


def _too_few(first: Camera, second: Camera, count: int) -> str:
    return (
        f"the pictures of cameras '{first.name}' and '{second.name}' have only {count} features in"
        " common; the rig could not be checked with them"
    )


def _between(pairs: _Pairs, i: int, j: int) -> Matches:
    """Features shared by pictures i and j, those of i first."""
    if i < j:
        return pairs[i, j]
    return Matches(pairs[j, i].second, pairs[j, i].first)


def _misfit(rig: Rig, order: tuple[int, ...], pairs: _Pairs, which: tuple[int, int]) -> float:
    """Median distance of features from their epipolar lines; infinite where most lie behind.

    `order` says which camera each picture is taken for.
    """
    found = _between(pairs, *which)
    first, second = (rig.cameras[order[k]] for k in which)
    distance = _epipolar_distance(first, second, found)
    known = np.isfinite(distance)
    if known.sum() < _FEWEST:
        return float("inf")
    pixels = np.stack([found.first[known], found.second[known]])
    in_front = np.isfinite(triangulate(Rig((first, second), 0, rig.source), pixels, 1.0).residual)
    return float(np.median(distance[known])) if in_front.mean() > 0.5 else float("inf")


def _epipolar_distance(first: Camera, second: Camera, found: Matches) -> PointScalars:
    """Distance of features from each other's epipolar lines, mean of both pictures [px]."""
    a, b = (
        np.column_stack([flat, np.ones(len(flat))])
        for flat in (normalised(first, found.first), normalised(second, found.second))
    )
    between = second.T_camera_object @ np.linalg.inv(first.T_camera_object)
    x, y, z = between[:3, 3]
    essential = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ between[:3, :3]
    line_b, line_a = a @ essential.T, b @ essential
    miss = np.abs(np.einsum("na,na->n", b, line_b))
    with np.errstate(divide="ignore", invalid="ignore"):
        in_b = miss / np.hypot(line_b[:, 0], line_b[:, 1]) * second.matrix[0, 0]
        in_a = miss / np.hypot(line_a[:, 0], line_a[:, 1]) * first.matrix[0, 0]
    return 0.5 * (in_a + in_b)


def _own_error(rig: Rig, pairs: _Pairs, which: tuple[int, int]) -> float:
    """Median distance from the epipolar lines that the features themselves agree on best [px]."""
    found = _between(pairs, *which)
    a, b = (
        _straight(rig.cameras[k], pixels)
        for k, pixels in zip(which, (found.first, found.second), strict=True)
    )
    matrix, _ = cv2.findFundamentalMat(a, b, cv2.FM_LMEDS)
    if matrix is None or matrix.shape != (3, 3):
        return 0.0
    line = np.column_stack([a, np.ones(len(a))]) @ matrix.T
    miss = np.abs(np.einsum("na,na->n", np.column_stack([b, np.ones(len(b))]), line))
    return float(np.median(miss / np.maximum(np.hypot(line[:, 0], line[:, 1]), 1e-12)))


def _explanation(rig: Rig, pairs: _Pairs, worst: float) -> str:
    """Why the rig does not fit, as far as another order of the pictures tells."""
    what = (
        f"features lie {worst:.1f} px off their epipolar lines"
        if np.isfinite(worst)
        else "features that two pictures share lie behind the cameras"
    )
    order = _better_order(rig, pairs)
    if order is None:
        return (
            f"{rig.source}: {what}, and no other order of the pictures makes it better; is this the"
            " calibration of these pictures, was a camera moved since, are the pictures cropped,"
            " scaled or turned?"
        )
    names = [camera.name for camera in rig.cameras]
    moved = [k for k in range(len(names)) if order[k] != k]
    if len(moved) == 2:
        swap = f"the pictures of '{names[moved[0]]}' and '{names[moved[1]]}' look swapped"
    else:
        swap = "the pictures look permuted: " + ", ".join(
            f"that of '{names[k]}' shows what '{names[order[k]]}' sees" for k in moved
        )
    return f"{rig.source}: {what}; {swap}. Rename the files, or the cameras in the rig"


def _better_order(rig: Rig, pairs: _Pairs) -> tuple[int, ...] | None:
    """Camera that each picture belongs to, where another order than the given one fits."""
    count = len(rig.cameras)
    known = [pair for pair, found in pairs.items() if len(found.first) >= _FEWEST]
    if count > _MOST_TO_SWAP:
        return None
    best: tuple[float, tuple[int, ...]] = (_LIMIT, ())
    for order in permutations(range(count)):
        if order == tuple(range(count)):
            continue
        worst = max(_misfit(rig, order, pairs, pair) for pair in known)
        best = min(best, (worst, order))
    return best[1] or None


def _surface_offset(
    rig: Rig,
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    surface: tuple[Vertices, Triangles],
    pairs: _Pairs,
) -> tuple[float, list[str]]:
    """Median distance of the features on the object from its surface [m], and remarks."""
    mesh = TriangleMesh(*surface)
    seen, notes = _in_view(rig, pictures, mesh)
    points, sigma = _surface_features(rig, seen, pairs)
    if len(points) < _FEWEST:
        notes.append(
            f"only {len(points)} features lie where the object is to be seen; whether its pose is"
            " right could not be checked"
        )
        return float("nan"), notes
    offset = float(np.median(closest_points(mesh, points).distance))
    diagonal = bounding_diagonal(mesh)
    if offset > max(_FAR * diagonal, _SIGMAS * float(np.median(sigma))):
        raise CalibrationError(
            f"{rig.source}: the features on the object lie {1e3 * offset:.1f} mm off its mesh"
            f" (median of {len(points)}; {100.0 * offset / diagonal:.0f} % of its diagonal): the"
            f" pose of the object, or the unit of the mesh, is wrong{_cure(rig, mesh, points)}."
            " Register the object to the pictures, or give the cameras in its frame"
        )
    return offset, notes


def _in_view(
    rig: Rig, pictures: Sequence[Float[np.ndarray, "_ _"]], mesh: TriangleMesh
) -> tuple[SurfaceMap, list[str]]:
    """What the reference camera sees of the mesh; remarks about cameras that see none of it."""
    maps = [
        surface_map(camera, picture.shape, mesh.vertices, mesh.triangles)
        for camera, picture in zip(rig.cameras, pictures, strict=True)
    ]
    blind = [k for k, one in enumerate(maps) if (one.triangle >= 0).sum() < _IN_VIEW]
    texts = [_blind_text(rig.cameras[k], pictures[k].shape, mesh) for k in blind]
    if rig.reference in blind or len(blind) > len(maps) - 2:
        raise CalibrationError(
            f"{rig.source}: {'; '.join(texts)}. Is the mesh in the frame and the unit of the"
            " cameras' R and t?"
        )
    return maps[rig.reference], texts


def _blind_text(camera: Camera, shape: tuple[int, int], mesh: TriangleMesh) -> str:
    column, row = project(camera, mesh.vertices.mean(axis=0)[None])[0]
    return (
        f"camera '{camera.name}' sees nothing of the object: its middle is at column"
        f" {column:.0f}, row {row:.0f} of a picture of {shape[1]} x {shape[0]}"
    )


def _surface_features(rig: Rig, seen: SurfaceMap, pairs: _Pairs) -> tuple[Points, PointScalars]:
    """Features before which the mesh lies, as points, and their standard deviations [m]."""
    points, sigma = [np.zeros((0, 3))], [np.zeros(0)]
    for c, camera in enumerate(rig.cameras):
        if c == rig.reference:
            continue
        found = _between(pairs, rig.reference, c)
        pair = Rig((rig.cameras[rig.reference], camera), 0, rig.source)
        joint = triangulate(pair, np.stack([found.first, found.second]), _FEATURE_ERROR)
        column, row = np.rint(found.first).astype(np.int64).T
        good = (joint.residual < _LIMIT) & (seen.triangle[row, column] >= 0)
        points.append(joint.point[good])
        sigma.append(np.sqrt(np.linalg.eigvalsh(joint.covariance[good])[:, -1]))
    return np.concatenate(points), np.concatenate(sigma)


def _cure(rig: Rig, mesh: TriangleMesh, points: Points) -> str:
    """How far registration would move the object, where it finds its way."""
    eye, _ = rays(rig.cameras[rig.reference], np.zeros((1, 2)))
    try:
        found = register(
            points, None, mesh, eye=eye, settings=RegistrationSettings(most_points=500)
        )
    except InputError:
        return ""
    if not found.converged or found.residual > _FAR * found.diagonal:
        return ""
    shift = found.T_mesh_points[:3, :3] @ points.mean(axis=0) + found.T_mesh_points[:3, 3]
    distance = float(np.linalg.norm(shift - points.mean(axis=0)))
    cosine = 0.5 * (np.trace(found.T_mesh_points[:3, :3]) - 1.0)
    turn = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    return f"; it seems to be {1e3 * distance:.1f} mm and {turn:.1f} degrees off"

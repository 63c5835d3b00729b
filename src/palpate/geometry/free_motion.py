"""Motions of an object that points on its surface do not determine: detection and description.

The linearised information of the points about a motion follows from its component along the
surface's normals. The normals of facets, or of a mesh made from measured points, overstate it: the
facets of a ball may be rotated, and a rough plate may slide, without a worse fit on average. Every
motion is therefore applied at finite size, in both directions, and the actual increase of the
squared distances is compared with the predicted one.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from palpate.geometry.closest_point import SurfaceSearch
from palpate.geometry.surface_fit import (
    Linearised,
    MeasuredPoints,
    Pose,
    linearised,
    motion_pose,
    placed,
)
from palpate.geometry.triangle_mesh import (
    CREASE_ANGLE,
    TriangleMesh,
    bounding_diagonal,
    half_edges,
    place_text,
    unit_normals,
)
from palpate.shapes import Flags, Points, PointScalars, Vector3

# Size of a trial motion in predicted standard deviations: if the prediction is right, the squared
# distances grow by a hundred times their variation by chance.
_TRIED_STDS = 10.0
# Components below this fraction of the points' motion are not mentioned.
_MIN_NAMED = 0.1
# Which sides and corners of the triangles are edges of the object (`surface_edges`).
SurfaceEdges = tuple[Bool[np.ndarray, "m 3"], Bool[np.ndarray, "m 3"]]


def surface_edges(mesh: TriangleMesh) -> SurfaceEdges:
    """Edges of a mesh, open or closed: its boundaries, and its creases.

    Parameters
    ----------
    mesh : TriangleMesh

    Returns
    -------
    side : (m, 3) bool              whether the side from corner k to k + 1 of a triangle is an edge
    corner : (m, 3) bool            whether corner k lies on an edge
    """
    # Coinciding vertices are merged: those of a refined surface come separately.
    grain = 1e-9 * bounding_diagonal(mesh)
    _, vertex = np.unique(np.round(mesh.vertices / grain), axis=0, return_inverse=True)
    halves = half_edges(vertex.ravel()[mesh.triangles])
    pairs = halves.pairs()
    a, b = unit_normals(mesh)[pairs.T // 3]
    inner = np.zeros(len(halves.tail), dtype=bool)
    inner[pairs[np.einsum("ea,ea->e", a, b) > np.cos(CREASE_ANGLE)]] = True
    at_edge = np.zeros(len(mesh.vertices), dtype=bool)
    at_edge[halves.ends[halves.edge[~inner]]] = True
    return ~inner.reshape(-1, 3), at_edge[halves.tail].reshape(-1, 3)


def near_edges(
    mesh: TriangleMesh, linearisation: Linearised, edges: SurfaceEdges, reach: PointScalars
) -> Flags:
    """True for points whose nearest point is within reach of an edge of the object.

    They may belong to the face beyond the edge, and then do not determine their position along it.

    Parameters
    ----------
    mesh : TriangleMesh
    linearisation : Linearised      n points
    edges : pair of (m, 3) bool     `surface_edges` of the mesh
    reach : (n,) float [m]          by how much noise may have displaced each

    Returns
    -------
    (n,) bool
    """
    corner = mesh.vertices[mesh.triangles[linearisation.triangle]]
    side = np.roll(corner, -1, axis=1) - corner
    length = np.linalg.norm(side, axis=2)
    double_area = np.linalg.norm(np.cross(side[:, 0], side[:, 1]), axis=1)
    # The height above the side from k to k + 1 follows from the weight of corner k + 2.
    height = np.roll(linearisation.barycentric, -2, axis=1) * double_area[:, None] / length
    position = np.einsum("nk,nka->na", linearisation.barycentric, corner)
    away = np.linalg.norm(corner - position[:, None], axis=2)
    close = (height <= reach[:, None]) & edges[0][linearisation.triangle]
    close |= (away <= reach[:, None]) & edges[1][linearisation.triangle]
    return close.any(axis=1)


def confirmed_information(
    search: SurfaceSearch,
    edges: SurfaceEdges,
    points: MeasuredPoints,
    linearisation: Linearised,
    reach: PointScalars,
    *,
    pose: Pose,
    motion: Float[np.ndarray, "6"],
    std: float,
) -> float:
    """Increase of the squared distances under a finite motion over that predicted by the normals.

    The motion is applied in both directions. Where the predicted information is an artefact of
    errors of the mesh, the squared distances do not increase on average.

    Parameters
    ----------
    search : SurfaceSearch          of the surface
    edges : pair of (m, 3) bool     `surface_edges`
    points : MeasuredPoints         k points
    linearisation : Linearised      at their fitted pose
    reach : (k,) float [m]          by how much noise may have displaced each
    pose : (4, 4) float             their fitted pose
    motion : (6,) float             rotation (rad) and translation (m), which move the points by 1 m
                                    rms
    std : float [m]                 standard deviation along it as predicted by the normals

    Returns
    -------
    float                           0 to 1: 1 where the prediction is right, about 0 where the
                                    points do not determine the motion
    """
    step = _TRIED_STDS * std
    squares, weight = -2.0 * linearisation.residual**2, linearisation.sigma**-2
    for signed_step in (step, -step):
        moved = motion_pose(signed_step * motion, linearisation.centre) @ pose
        trial = linearised(search, points, moved)
        squares = squares + trial.residual**2
        at_edge = near_edges(search.mesh, trial, edges, reach)
        weight = np.where(at_edge, 0.0, weight)
    displacement = np.cross(motion[:3], linearisation.offset) + motion[3:]
    normal_component = np.einsum("na,na->n", displacement, linearisation.normal)
    predicted = 2.0 * step**2 * float(weight @ normal_component**2)
    return float(np.clip(weight @ squares / predicted, 0.0, 1.0)) if predicted > 0.0 else 0.0


def motion_constraints(free: Float[np.ndarray, "k 6"], size: float) -> Float[np.ndarray, "k 6"]:
    """Constraints by which a motion contains none of the free motions.

    Rotation takes precedence over translation: the translation of a ball must not be attributed to
    a rotation about its centre.

    Parameters
    ----------
    free : (k, 6) float             rotation (rad) and translation (m) of each
    size : float [m]                rms distance of the points from the centre of rotation

    Returns
    -------
    (k, 6) float                    its product with a motion must be zero
    """
    # A translation has a thousandth of the weight: it decides only where no rotation does.
    return free * np.concatenate([np.full(3, size), np.full(3, 1e-3 / size)])


def nearest_pose(
    pose: Pose, start: Pose, points: Points, free: Float[np.ndarray, "k 6"], centre: Vector3
) -> Pose:
    """The pose nearest to the start that differs from a given one by free motions only
    (`motion_constraints`).

    Parameters
    ----------
    pose, start : (4, 4) float
    points : (n, 3) float [m]       in their own frame
    free : (k, 6) float             motions about `centre`
    centre : (3,) float [m]         centroid of the points in the pose

    Returns
    -------
    (4, 4) float
    """
    if not len(free):
        return pose
    size = float(np.sqrt(((placed(pose, points) - centre) ** 2).sum(axis=1).mean()))
    constraints = motion_constraints(free, size)
    middle = points.mean(axis=0)
    wanted = placed(start, middle[None])[0]
    for _ in range(20):
        rotation = Rotation.from_matrix(pose[:3, :3] @ start[:3, :3].T).as_rotvec()
        gap = np.concatenate([rotation, placed(pose, middle[None])[0] - wanted])
        step = -np.linalg.solve(constraints @ free.T, constraints @ gap)
        pose = motion_pose(free.T @ step, centre) @ pose
        if np.linalg.norm(step) < 1e-12 * size:
            break
    return pose


def motion_texts(free: Float[np.ndarray, "k 6"], centre: Vector3, size: float) -> tuple[str, ...]:
    """Free motions in words.

    Parameters
    ----------
    free : (k, 6) float             rotation (rad) and translation (m) of each
    centre : (3,) float [m]         centre of rotation
    size : float [m]                rms distance of the points from it

    Returns
    -------
    tuple of str                    at most k
    """
    basis = np.linalg.qr((free * np.repeat([size, 1.0], 3)).T)[0].T / np.repeat([size, 1.0], 3)
    translations, rotations = _separated(basis, size)
    texts = [f"sliding along {_vector(shift)}" for shift in translations]
    if len(translations) == 3:
        texts = ["sliding in any direction"]
    elif len(translations) == 2:
        texts = [f"sliding across {_vector(np.cross(*translations))}"]
    if len(rotations) == 3:
        pivot, gap = _pivot(rotations, centre)
        if gap < _MIN_NAMED * size:
            return (*texts, f"turning about any axis through {place_text(pivot, decimals=1)}")
    return (*texts, *(_turn_text(turn, centre, size) for turn in rotations))


def _separated(
    basis: Float[np.ndarray, "k 6"], size: float
) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, "t 6"]]:
    """Pure translations among the motions, as unit vectors, and the rotations without them."""
    left_vectors, strength, _ = np.linalg.svd(basis[:, :3] * size, full_matrices=True)
    strength = np.concatenate([strength, np.zeros(len(basis) - len(strength))])
    rotated = left_vectors.T @ basis
    rotates = strength > _MIN_NAMED
    translations = rotated[~rotates, 3:]
    translations = translations / np.linalg.norm(translations, axis=1)[:, None]
    rotations = rotated[rotates]
    if len(translations):
        along = np.linalg.qr(translations.T)[0]
        rotations[:, 3:] -= rotations[:, 3:] @ along @ along.T
    return translations, rotations


def _pivot(rotations: Float[np.ndarray, "3 6"], centre: Vector3) -> tuple[Vector3, float]:
    """The point that all rotations leave in place, and by how much they miss it [m]."""
    # Velocity at centre + x: translation + rotation x x.
    cross = np.stack([np.cross(turn[:3], np.eye(3)).T for turn in rotations])
    x, *_ = np.linalg.lstsq(cross.reshape(-1, 3), -rotations[:, 3:].ravel(), rcond=None)
    left = cross @ x + rotations[:, 3:]
    return centre + x, float(np.sqrt((left**2).sum() / (rotations[:, :3] ** 2).sum()))


def _turn_text(turn: Float[np.ndarray, "6"], centre: Vector3, size: float) -> str:
    axis = turn[:3] / np.linalg.norm(turn[:3])
    axis_point = centre + np.cross(turn[:3], turn[3:]) / (turn[:3] @ turn[:3])
    pitch = float(axis @ turn[3:] / np.linalg.norm(turn[:3]))
    # The point of the axis nearest to the origin of the frame, in which the mesh is known.
    axis_point = axis_point - axis * (axis @ axis_point)
    how = "turning" if abs(pitch) < _MIN_NAMED * size else "turning and sliding along"
    about = "about the axis" if how == "turning" else "the axis"
    return f"{how} {about} {_vector(axis)} through {place_text(axis_point, decimals=1)}"


def _vector(direction: Vector3) -> str:
    unit = direction / np.linalg.norm(direction)
    unit = unit * (1.0 if unit[np.abs(unit).argmax()] > 0.0 else -1.0)
    return "(" + ", ".join(f"{value + 0.0:.2f}" for value in np.round(unit, 2) + 0.0) + ")"

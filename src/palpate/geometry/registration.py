"""Pose of an object from points measured on its surface.

Robust iterative closest points: the distance from the surface is minimised in a robust norm, from
an inaccurate initial pose. Motions that the shape does not determine (of a ball about its centre,
of a plate within its plane) are detected by finite trial motions; along them the pose stays as the
initial one has it. They are called free.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.arrays import fixed_array
from palpate.errors import CalibrationError, InputError
from palpate.geometry.closest_point import SurfaceSearch, surface_search
from palpate.geometry.free_motion import (
    SurfaceEdges,
    confirmed_information,
    motion_constraints,
    motion_texts,
    near_edges,
    nearest_pose,
    surface_edges,
)
from palpate.geometry.surface_fit import (
    Linearised,
    MeasuredPoints,
    RobustResiduals,
    coarse_pose,
    compact_groups,
    even_sample,
    facing_surface,
    fit_pose,
    linearised,
    null_space_basis,
    placed,
    robust_residuals,
)
from palpate.geometry.triangle_mesh import TriangleMesh, bounding_diagonal
from palpate.shapes import Flags, Points, PointScalars, Vector3

# A pose has six unknowns; with fewer than four points for each, a robust norm cannot tell outliers.
_MIN_POINTS = 24
# Largest number of points in the coarse search, and in the first fit and the trial motions.
_SEARCH_POINTS, _NEAR_POINTS = 256, 1024
# Largest number of compact groups within which residuals may be correlated: enough to estimate a
# variance to 20 %, and few enough for a group to be wider than a window of stereo matching.
_MAX_GROUPS = 64
_MAX_STEPS = 60
# Where there are more points, an even sample of so many is used.
_MAX_POINTS = 6000
# A motion counts as free where its standard deviation, as an rms displacement of the points,
# exceeds this fraction of the mesh's diagonal: weaker information comes from errors of mesh and
# cameras.
_MAX_RELATIVE_STD = 0.002
# A free motion may show only once others are held: of six, each round finds at least one.
_MAX_ROUNDS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Pose of points on a mesh, with its covariance.

    Attributes
    ----------
    T_mesh_points : (4, 4) float [m]    x_mesh = T_mesh_points x_points
    centre : (3,) float [m]             centroid of the points, mesh frame
    covariance : (6, 6) float           of a rotation about `centre` [rad] and a translation [m],
                                        both in the mesh frame; with the free motions held
    free : (k, 6) float                 rotation and translation of each motion that the shape does
                                        not determine; the pose has the start's value along it. Each
                                        moves the points by 1 m rms
    weakest_std : float [m]             standard deviation of the points along the determined motion
                                        that is known worst; infinite where none is determined
    residual : float [m]                rms distance of the inliers from the surface
    inliers : float [-]                 fraction of inliers among the points
    variance_inflation : float [-]      by correlated residuals, >= 1; contained
                                        in `covariance`
    size : float [m]                    rms distance of the points from `centre`
    diagonal : float [m]                bounding diagonal of the mesh
    iterations : int
    converged : bool
    """

    T_mesh_points: Float[np.ndarray, "4 4"]
    centre: Vector3
    covariance: Float[np.ndarray, "6 6"]
    free: Float[np.ndarray, "k 6"]
    weakest_std: float
    residual: float
    inliers: float
    variance_inflation: float
    size: float
    diagonal: float
    iterations: int = 0
    converged: bool = False


def register(
    points: Points,
    std: PointScalars | Float[np.ndarray, "n 3 3"] | None,
    mesh: TriangleMesh,
    *,
    start: Float[np.ndarray, "4 4"] | None = None,
    viewpoint: Vector3 | None = None,
    angle: float = float(np.radians(5.0)),
    distance: float = 0.02,
) -> Registration:
    """Find the pose in which measured points lie on the surface of a mesh.

    Flat facets lie inside a convex object and bias the pose by their distance from it, which the
    covariance does not show: give the smooth surface, `TriangleMesh(*refined_surface(mesh))`.

    Parameters
    ----------
    points : (n, 3) float [m]       of the surface, in any frame; outliers are allowed
    std : (n,) float [m], (n, 3, 3) float [m^2] or None     standard deviation, > 0, or covariance
                                    of each point; None: equal for all, and unknown
    mesh : TriangleMesh             open or closed
    start : (4, 4) float or None    initial pose; None: the identity
    viewpoint : (3,) float [m] or None    from which the points were seen, in their frame:
                                    triangles that face away from it are left out
    angle : float [rad]             largest error of the initial pose's rotation, > 0
    distance : float [m]            largest error of its translation, > 0

    Returns
    -------
    Registration                    along free motions the pose is that of the start. Correlated
                                    residuals widen the covariance by one factor: the variance of
                                    the sums over compact groups of points, over that of as many
                                    independent points

    Raises
    ------
    InputError                      fewer than 24 points, all collinear, shapes that do not match,
                                    a standard deviation or covariance that is not positive

    Source
    ------
    Chen and Medioni (1992) for the method; Liang and Zeger, Longitudinal data analysis using
    generalized linear models, Biometrika 73 (1986), for the sums over groups; Zhang, Kaess and
    Singh, On degeneracy of optimization-based state estimation problems (2016), for holding the
    free motions.
    """
    measured = _measured(points, std)
    guess = np.eye(4) if start is None else fixed_array(start, name="start", shape=(4, 4))
    chosen = measured.chosen(even_sample(measured.point, _MAX_POINTS))
    surface = mesh
    if viewpoint is not None:
        surface = facing_surface(mesh, placed(guess, viewpoint[None])[0], angle=angle)
    search = surface_search(surface)
    sample = chosen.chosen(even_sample(chosen.point, _SEARCH_POINTS))
    pose = coarse_pose(search, sample.point, guess, angle=angle, distance=distance)
    near = chosen.chosen(even_sample(chosen.point, _NEAR_POINTS))
    edges, iterations = surface_edges(surface), 0
    known, constraints = _observability(search, near, pose, edges)
    for cloud in (near, *[chosen] * _MAX_ROUNDS):
        free = len(known.free)
        pose = nearest_pose(pose, guess, cloud.point, known.free, known.centre)
        pose, steps, converged = fit_pose(
            search, cloud, pose, constraints=constraints, iterations=_MAX_STEPS
        )
        iterations += steps
        known, constraints = _observability(search, chosen, pose, edges)
        if cloud is chosen and len(known.free) == free:
            break
    return replace(
        known, diagonal=bounding_diagonal(mesh), iterations=iterations,
        converged=converged and len(known.free) == free,
    )  # fmt: skip


def check_registration(registration: Registration) -> None:
    """Refuse a registration that has failed.

    Parameters
    ----------
    registration : Registration

    Raises
    ------
    CalibrationError                no convergence, residuals above 3 % of the mesh's diagonal, or
                                    fewer than half of the points inliers
    """
    ratio = registration.residual / registration.diagonal
    rest = (
        f"{1e3 * registration.residual:.2g} mm rms are left ({100 * ratio:.1f} % of its diagonal),"
        f" {100 * registration.inliers:.0f} % of them agree"
    )
    if ratio > 0.03 or registration.inliers < 0.5:
        raise CalibrationError(
            f"the points cannot be brought onto the mesh: {rest}; is it the mesh of this object, in"
            " the right unit, and the guess of the pose within 5 degrees and 20 mm?"
        )
    if not registration.converged:
        raise CalibrationError(
            f"the points do not come to rest on the mesh after {registration.iterations} steps:"
            f" {rest}; its shape hardly tells where they belong: give a better guess of the pose"
        )


def free_motions_text(registration: Registration) -> str:
    """The motions that the shape does not determine, in words; empty where it determines all.

    Parameters
    ----------
    registration : Registration

    Returns
    -------
    str                             as "sliding across (0.00, 0.00, 1.00) and turning about ..."
    """
    if not len(registration.free):
        return ""
    texts = motion_texts(registration.free, registration.centre, registration.size)
    return " and ".join(texts)


def _measured(
    points: Points, std: PointScalars | Float[np.ndarray, "n 3 3"] | None
) -> MeasuredPoints:
    """Checked points with a covariance each."""
    points = fixed_array(points, name="points", shape=(None, 3))
    n = len(points)
    if n < _MIN_POINTS:
        raise InputError(f"there are {n} points; a pose needs {_MIN_POINTS} or more")
    singular_values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if not singular_values[1] > 1e-6 * singular_values[0]:
        raise InputError("the points lie on one line; a pose needs points spread over a surface")
    if std is None:
        return MeasuredPoints(points, np.zeros((n, 3, 3)))
    if np.ndim(std) == 1:
        std = fixed_array(std, name="std", shape=(n,))
        if not std.min() > 0.0:
            raise InputError(f"std goes down to {std.min():g}; must be positive")
        return MeasuredPoints(points, std[:, None, None] ** 2 * np.eye(3))
    covariance = fixed_array(std, name="covariance", shape=(n, 3, 3))
    least = float(np.linalg.eigvalsh(covariance).min())
    if not least > 0.0:
        raise InputError(f"a covariance has the eigenvalue {least:g}; must be positive definite")
    return MeasuredPoints(points, covariance)


def _observability(
    search: SurfaceSearch,
    points: MeasuredPoints,
    pose: np.ndarray,
    edges: SurfaceEdges,
) -> tuple[Registration, Float[np.ndarray, "k 6"]]:
    """Separate the motions that the points determine from the free ones; gives the registration at
    a pose, and the constraints by which a motion contains none of the free ones."""
    linearisation = linearised(search, points, pose)
    robust = robust_residuals(linearisation)
    inlier = robust.weight() > 0.0
    reach = robust.width * linearisation.sigma
    used = inlier & ~near_edges(search.mesh, linearisation, edges, reach)
    information, variance_inflation = _information(linearisation, robust, used)
    values, vectors = np.linalg.eigh(information)
    motions = (linearisation.scale @ vectors).T
    rows = even_sample(points.point, _NEAR_POINTS)
    rows = rows[used[rows]]
    tried = search, edges, points.chosen(rows), linearisation.chosen(rows), reach[rows]
    least = (_MAX_RELATIVE_STD * search.diagonal) ** -2
    std = 1.0 / np.sqrt(np.maximum(values, least))
    confirmed = [
        confirmed_information(*tried, pose=pose, motion=motion, std=sigma)
        for motion, sigma in zip(motions, std, strict=True)
    ]
    # The unconfirmed share is subtracted twice: chance hides part of it at the minimum of the fit.
    values = values * (2.0 * np.array(confirmed) - 1.0)
    fixed = values >= least
    # Root mean square distance of the points from their centroid.
    size = float(np.sqrt((linearisation.offset**2).sum(axis=1).mean()))
    constraints = motion_constraints(motions[~fixed], size)
    basis = null_space_basis(constraints @ linearisation.scale)
    inner = basis @ np.linalg.pinv(basis.T @ information @ basis, hermitian=True) @ basis.T
    registration = Registration(
        T_mesh_points=pose,
        centre=linearisation.centre,
        covariance=linearisation.scale @ inner @ linearisation.scale.T,
        free=motions[~fixed],
        weakest_std=float(values[fixed].min() ** -0.5) if fixed.any() else float("inf"),
        residual=float(np.sqrt((linearisation.residual[inlier] ** 2).mean())),
        inliers=float(inlier.mean()),
        variance_inflation=variance_inflation,
        size=size,
        diagonal=search.diagonal,
    )
    return registration, constraints


def _information(
    linearisation: Linearised, robust: RobustResiduals, used: Flags
) -> tuple[Float[np.ndarray, "6 6"], float]:
    """Inverse covariance of the scaled motions, and the factor for correlated residuals."""
    row = linearisation.row[used] / linearisation.sigma[used, None]
    if robust.width <= 0.0:
        return row.T @ row, 1.0
    if len(row) <= 6:
        return np.zeros((6, 6)), 1.0
    # Tukey's function and its derivative.
    square = robust.unit[used] ** 2
    pull = robust.unit[used] * (1.0 - square) ** 2
    slope = (1.0 - square) * (1.0 - 5.0 * square)
    count = len(row)
    variance = (pull @ pull) / max(count - 6, 1) / (slope.sum() / count) ** 2
    variance *= robust.width**2
    score = row * pull[:, None]
    alone = score.T @ score
    label = compact_groups(linearisation.offset[used], _MAX_GROUPS)
    sums = np.stack([np.bincount(label, score[:, i]) for i in range(6)], axis=1)
    groups = len(sums)
    together = sums.T @ sums * groups / max(groups - 1, 1)
    variance_inflation = float(np.trace(np.linalg.pinv(alone, rcond=1e-10) @ together)) / 6.0
    variance_inflation = max(variance_inflation, 1.0)
    return row.T @ row / (variance * variance_inflation), variance_inflation

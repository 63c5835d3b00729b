"""Refinement of a rig from pictures of a textured object, by points seen in several cameras.

The rays of all cameras to a tie point must intersect, and the points must lie on the object's
surface, whose pose is unknown. The residuals of both conditions correct the camera parameters, with
the covariance of the calibration as the prior. Rays alone do not determine the scale, and hardly
separate the angle between the cameras from the depth of the object; the known surface does.

Source: Triggs et al., Bundle adjustment: a modern synthesis (2000), with the points eliminated;
noise and correlation between neighbouring points as in `geometry/registration`.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from palpate.arrays import STD_OVER_MEDIAN
from palpate.errors import CalibrationError
from palpate.geometry import TriangleMesh, closest_points, compact_groups, unit_normals
from palpate.records import Rig, RigCovariance
from palpate.shapes import PointScalars, Vector3
from palpate.vision import calibration_numbers, moved_rig, project, project_jacobian, triangulate

_MAX_STEPS = 30
# Convergence in prior standard deviations; and the step below which derivatives are not renewed.
_SMALL_STEP, _NEAR_STEP = 1e-3, 0.05
# A point is a gross error if noise leaves as large a residual with this probability.
_GROSS = 1e-6
# Held-out points must improve by this many standard errors of the difference.
_SIGNIFICANT = 2.0
# Fewer points add nothing to a calibration with boards.
_MIN_POINTS = 60
# Prior standard deviations without a covariance: rotation [rad], shift as a fraction of the
# camera's distance from the first.
_TURN, _SHIFT = np.deg2rad(0.5), 0.01
# Prior standard deviation of the mesh's relative size; and the distance from the mesh, in robust
# standard deviations, beyond which points belong to something else.
_SIZE_SIGMA, _MAX_DEVIATIONS = 0.003, 4.0
# Number of compact groups of points; points that share matching errors lie in the same group.
_GROUPS = 64
# Central differences over this many standard deviations on each side.
_DIFFERENCE = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A refined rig, or the given one if the refinement did not improve it.

    Attributes
    ----------
    rig : Rig
    known : RigCovariance           of its parameters
    better : bool                   False: `rig` is the given one
    points, rejected : int          points used, and points rejected: gross errors and those seen by
                                    fewer than two cameras
    before, after : float [px]      rms residual per coordinate of held-out points: with the given
                                    rig, and with one refined without them
    largest_change : str            the parameter that changed most, e.g. "c1.ry by -2.1 of its
                                    standard deviations"; empty if `better` is False
    """

    rig: Rig
    known: RigCovariance
    better: bool
    points: int
    rejected: int
    before: float
    after: float
    largest_change: str


@dataclass(frozen=True, slots=True, eq=False)
class Ties:
    """Tie points: pixels of the same object points in several cameras.

    Attributes
    ----------
    pixels : (c, n, 2) float [px]           NaN where a camera does not see the point
    covariance : (c, n, 2, 2) float [px^2]  of each pixel, including the reference camera's
    """

    pixels: Float[np.ndarray, "c n 2"]
    covariance: Float[np.ndarray, "c n 2 2"]

    def chosen(self, rows: Bool[np.ndarray, " n"]) -> "Ties":
        """Select some of the points.

        Parameters
        ----------
        rows : (n,) bool

        Returns
        -------
        Ties
        """
        return Ties(self.pixels[:, rows], self.covariance[:, rows])


@dataclass(frozen=True, slots=True, eq=False)
class KnownSurface:
    """Surface of the object, and points on it matched between the cameras at one instant.

    Attributes
    ----------
    mesh : TriangleMesh
    pose : (4, 4) float [m]         approximate pose: x_mesh = pose x, x in the rig's frame
    ties : Ties
    relative_size : float [-]       of the object to its mesh, minus one
    """

    mesh: TriangleMesh
    pose: Float[np.ndarray, "4 4"]
    ties: Ties
    relative_size: float = 0.0

    def equations(
        self, rig: Rig, prior: RigCovariance, scale: Float[np.ndarray, "p k"]
    ) -> tuple[Float[np.ndarray, "u u"], Float[np.ndarray, " u"]]:
        """Normal equations of the points' distances from the mesh, with the prior of the size.

        The unknowns are k steps of the rig, then rotation, shift and relative size of the object.

        Parameters
        ----------
        rig : Rig
        prior : RigCovariance       its p parameters and their standard deviations
        scale : (p, k) float        independent steps, see `refine`

        Returns
        -------
        (k + 7, k + 7) float, (k + 7,) float    normal matrix and right-hand side

        Raises
        ------
        CalibrationError            the covariance is of other cameras
        """
        ties, mesh = self.ties, self.mesh
        offset, centre = self._offsets(rig)
        position = centre + offset / (1.0 + self.relative_size)
        closest = closest_points(mesh, position)
        normal = unit_normals(TriangleMesh(mesh.vertices, mesh.triangles[closest.triangle]))
        gap = np.einsum("na,na->n", normal, position - closest.position)
        inside = (closest.barycentric > 0.0).all(axis=1)
        noise = STD_OVER_MEDIAN * float(np.median(np.abs(gap[inside])))
        _, shift = _jacobians(rig, prior, scale, ties)
        rows = np.concatenate(
            [
                np.einsum("na,ab,nbk->nk", normal, self.pose[:3, :3], shift),
                np.cross(offset, normal), normal,
                -np.einsum("na,na->n", normal, offset)[:, None],
            ],
            axis=1,
        )  # fmt: skip
        weight = (inside & (np.abs(gap) < _MAX_DEVIATIONS * noise)) / noise**2
        score = (weight * gap)[:, None] * rows
        # Neighbouring points share errors, from overlapping windows and from the mesh.
        weight /= max(_variance_inflation(score[:, -7:], compact_groups(offset, _GROUPS)), 1.0)
        matrix = rows.T @ (weight[:, None] * rows)
        right = -rows.T @ (weight * gap)
        matrix[-1, -1] += _SIZE_SIGMA**-2
        right[-1] -= self.relative_size / _SIZE_SIGMA**2
        return matrix, right

    def moved(self, rig: Rig, change: Float[np.ndarray, "7"]) -> "KnownSurface":
        """Apply a rotation about the centroid of the points, a shift, and a change of size.

        Parameters
        ----------
        rig : Rig
        change : (7,) float         rotation [rad], shift [m], relative size

        Returns
        -------
        KnownSurface
        """
        _, centre = self._offsets(rig)
        step = np.eye(4)
        step[:3, :3] = Rotation.from_rotvec(change[:3]).as_matrix()
        step[:3, 3] = centre - step[:3, :3] @ centre + change[3:6]
        size = self.relative_size + float(change[6])
        return replace(self, pose=step @ self.pose, relative_size=size)

    def _offsets(self, rig: Rig) -> tuple[Float[np.ndarray, "n 3"], Vector3]:
        """Points relative to their centroid, and the centroid, in the frame of the mesh [m]."""
        position = tie_points(rig, self.ties) @ self.pose[:3, :3].T + self.pose[:3, 3]
        centre = position.mean(axis=0)
        return position - centre, centre


def refined_rig(
    rig: Rig, known: RigCovariance | None, ties: Ties, surface: KnownSurface | None = None
) -> Refined:
    """Refine a rig from points matched between its cameras, if that improves it.

    The refinement is accepted if a rig refined from half of the points (every second group of
    neighbours) significantly reduces the residuals of the other half.

    Parameters
    ----------
    rig : Rig
    known : RigCovariance or None   None: prior standard deviations of half a degree and 1 % of the
                                    distance for the poses relative to the first camera; exact
                                    lenses
    ties : Ties                     of all instants
    surface : KnownSurface or None  None: only the rays are used

    Returns
    -------
    Refined

    Raises
    ------
    CalibrationError                fewer than 60 points; a covariance of another rig
    """
    prior = _default_prior(rig) if known is None else known
    scale = _square_root(prior.covariance)
    usable = np.isfinite(_residuals(rig, ties)).all(axis=1)
    ties, count = ties.chosen(usable), len(usable)
    if usable.sum() < _MIN_POINTS:
        raise CalibrationError(
            f"{int(usable.sum())} points of the object are seen by two cameras; {_MIN_POINTS} are"
            " needed to refine a rig: give pictures of more instants, with a *, and see whether the"
            " object is textured and large in the pictures of two cameras"
        )
    label = compact_groups(tie_points(rig, ties), _GROUPS)
    half = label % 2 == 0
    trial, *_ = _fit(rig, prior, scale, ties.chosen(half), label[half], surface)
    before, after, gain = _improvement(rig, trial, ties.chosen(~half), label[~half])
    if gain < _SIGNIFICANT:
        used = int(usable.sum())
        return Refined(rig, prior, False, used, count - used, before, after, "")
    refined, good, step, covariance = _fit(rig, prior, scale, ties, label, surface)
    value = calibration_numbers(refined.cameras, prior.names)
    covariance = 0.5 * (covariance + covariance.T)
    return Refined(
        refined, RigCovariance(prior.names, value, covariance, "refinement"), True,
        int(good.sum()), count - int(good.sum()), before, after, _largest_change(step, prior),
    )  # fmt: skip


def _fit(
    rig: Rig,
    prior: RigCovariance,
    scale: Float[np.ndarray, "p k"],
    ties: Ties,
    label: np.ndarray,
    surface: KnownSurface | None,
) -> tuple[Rig, Bool[np.ndarray, " n"], Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
    """Gauss-Newton iteration from a rig, in units of the prior's standard deviations.

    Gives the refined rig, flags of the points used, the step of the parameters, and their
    covariance.
    """
    count = scale.shape[1]
    # Unknowns: steps of the rig; rotation, shift and relative size of the object.
    total, inflation, step = np.zeros(count), 1.0, np.full(count, np.inf)
    for _ in range(_MAX_STEPS):
        here = moved_rig(rig, prior.names, scale @ total)
        residual = _residuals(here, ties)
        good, noise = _good(residual, _freedom(ties))
        if np.abs(step).max() > _NEAR_STEP:
            jacobian, _ = _jacobians(here, prior, scale, ties)
        weight = good / (inflation * noise**2)
        score = np.einsum("n,nr,nrk->nk", weight, residual, jacobian)
        # Without a surface the last seven unknowns stay zero.
        matrix, right = np.eye(count + 7), np.zeros(count + 7)
        matrix[:count, :count] += np.einsum("n,nrk,nrl->kl", weight, jacobian, jacobian)
        right[:count] = -score.sum(axis=0) - total
        if surface is not None:
            more_matrix, more_right = surface.equations(here, prior, scale)
            matrix[count:, count:] = 0.0
            matrix, right = matrix + more_matrix, right + more_right
        change = np.linalg.solve(matrix, right)
        step = change[:count]
        total = total + step
        surface = None if surface is None else surface.moved(here, change[count:])
        inflation = max(_variance_inflation(score * np.sqrt(inflation), label), 1.0)
        if np.abs(step).max() < _SMALL_STEP:
            break
    covariance = scale @ np.linalg.inv(matrix)[:count, :count] @ scale.T
    return moved_rig(rig, prior.names, scale @ total), good, scale @ total, covariance


def _freedom(ties: Ties) -> PointScalars:
    """Degrees of freedom of each point: observed coordinates minus three."""
    return 2.0 * np.isfinite(ties.pixels).all(axis=2).sum(axis=0) - 3.0


def _good(
    residual: Float[np.ndarray, "n r"], freedom: PointScalars
) -> tuple[Bool[np.ndarray, " n"], float]:
    """Points that are not gross errors, and the ratio of actual to claimed noise, from medians."""
    # Quantiles of chi-squared; importing scipy.stats for them would take most of a second.
    square = (residual**2).sum(axis=1)
    noise = float(np.sqrt(np.median(square / chdtri(freedom, 0.5))))
    noise = max(noise, 1e-9)
    return square < noise**2 * chdtri(freedom, _GROSS), noise


def _improvement(rig: Rig, other: Rig, ties: Ties, label: np.ndarray) -> tuple[float, float, float]:
    """Rms residuals of points with two rigs [px], and the improvement in standard errors.

    Gross errors with the second rig are left out of both. The standard error is from sums over
    groups, as neighbouring points are correlated.
    """
    freedom, seen = _freedom(ties), np.isfinite(ties.pixels).all(axis=2)
    both = [_residuals(candidate, ties) for candidate in (rig, other)]
    good, _ = _good(both[1], freedom)
    squares = [(residual[good] ** 2).sum(axis=1) for residual in both]
    sums = np.bincount(label[good], squares[0] - squares[1])[np.unique(label[good])]
    error = float(sums.std()) * np.sqrt(len(sums))
    gain = float(sums.sum()) / error if error > 0.0 else 0.0
    typical = float(np.sqrt(np.median(ties.covariance[seen][:, 0, 0])))
    before, after = (
        typical * float(np.sqrt(square.sum() / freedom[good].sum())) for square in squares
    )
    return before, after, gain


def _square_root(covariance: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p k"]:
    """Square root of a covariance: independent steps of one standard deviation each, as columns.

    Parameters without variance get zero rows; directions without variance are dropped.
    """
    size = np.sqrt(np.diag(covariance))
    free = size > 0.0
    unit = covariance[np.ix_(free, free)] / np.outer(size[free], size[free])
    value, vector = np.linalg.eigh(unit)
    keep = value > 1e-12 * value[-1]
    root = np.zeros((len(size), int(keep.sum())))
    root[free] = size[free, None] * vector[:, keep] * np.sqrt(value[keep])
    return root


def _default_prior(rig: Rig) -> RigCovariance:
    """Prior of a rig without a covariance: exact lenses, and poses that may have shifted."""
    terms = ("rx", "ry", "rz", "tx", "ty", "tz")
    first = rig.cameras[rig.reference]
    names = [f"{first.name}.fx"]
    sigma = [0.0]
    back = np.linalg.inv(first.T_camera_object)
    for camera in rig.cameras:
        if camera is first:
            continue
        distance = float(np.linalg.norm((camera.T_camera_object @ back)[:3, 3]))
        names += [f"{camera.name}.{term}" for term in terms]
        sigma += [_TURN] * 3 + [_SHIFT * distance] * 3
    value = calibration_numbers(rig.cameras, names)
    return RigCovariance(tuple(names), value, np.diag(np.square(sigma)), rig.source)


def _largest_change(step: Float[np.ndarray, " p"], prior: RigCovariance) -> str:
    """The parameter with the largest change in prior standard deviations, in words."""
    sigma = np.sqrt(np.diag(prior.covariance))
    unit = np.divide(step, sigma, out=np.zeros_like(step), where=sigma > 0.0)
    worst = int(np.abs(unit).argmax())
    return f"{prior.names[worst]} by {unit[worst]:+.1f} of its standard deviations"


def _jacobians(
    rig: Rig, prior: RigCovariance, scale: Float[np.ndarray, "p k"], ties: Ties
) -> tuple[Float[np.ndarray, "n r k"], Float[np.ndarray, "n 3 k"]]:
    """Derivatives of the residuals and of the triangulated points with respect to steps of the rig.

    Parameters
    ----------
    rig : Rig
    prior : RigCovariance           its p parameters and their standard deviations
    scale : (p, k) float            independent steps, as columns
    ties : Ties

    Returns
    -------
    (n, r, k) float [-]             of `_residuals`
    (n, 3, k) float [m]             of `tie_points`

    Raises
    ------
    CalibrationError                the covariance is of other cameras
    """
    point = tie_points(rig, ties)
    by_point = _white(
        np.stack([project_jacobian(camera, point)[1] for camera in rig.cameras]), ties
    )
    by_number = np.zeros((len(rig.cameras), *ties.pixels.shape[1:], len(prior.names)))
    sizes = _DIFFERENCE * np.sqrt(np.diag(prior.covariance))
    index = {camera.name: c for c, camera in enumerate(rig.cameras)}
    for k in np.flatnonzero(sizes).tolist():
        c = index[prior.names[k].rpartition(".")[0]]
        step = sizes * np.eye(len(sizes))[k]
        ends = [
            project(moved_rig(rig, prior.names, side * step).cameras[c], point)
            for side in (1.0, -1.0)
        ]
        by_number[c, :, :, k] = (ends[1] - ends[0]) / (2.0 * sizes[k])
    jacobian = _white(by_number, ties) @ scale
    base, upper = np.linalg.qr(by_point)
    along = base.transpose(0, 2, 1) @ jacobian
    return jacobian - base @ along, np.linalg.solve(upper, along)


def _white(values: Float[np.ndarray, "c n 2 k"], ties: Ties) -> Float[np.ndarray, "n r k"]:
    """Whiten pixel quantities by the covariance of the match, all cameras in one row per point; 0
    where a camera does not see the point."""
    seen = np.isfinite(ties.pixels).all(axis=2)[..., None, None]
    root = np.linalg.cholesky(np.where(seen, ties.covariance, np.eye(2)))
    white = np.linalg.solve(root, np.where(seen, values, 0.0))
    return white.transpose(1, 0, 2, 3).reshape(white.shape[1], -1, white.shape[3])


def tie_points(rig: Rig, ties: Ties) -> Float[np.ndarray, "n 3"]:
    """Triangulate the points from all cameras.

    Parameters
    ----------
    rig : Rig
    ties : Ties

    Returns
    -------
    (n, 3) float [m]                NaN where fewer than two cameras see the point
    """
    return triangulate(rig, ties.pixels, ties.covariance).point


def _residuals(rig: Rig, ties: Ties) -> Float[np.ndarray, "n r"]:
    """Whitened reprojection errors of each point, in standard deviations of the match.

    Parameters
    ----------
    rig : Rig
    ties : Ties

    Returns
    -------
    (n, 2 c) float [-]              0 where a camera does not see the point; NaN if fewer than two
                                    do
    """
    point = tie_points(rig, ties)
    error = ties.pixels - np.stack([project(camera, point) for camera in rig.cameras])
    return _white(error[..., None], ties)[..., 0]


def _variance_inflation(score: Float[np.ndarray, "n k"], label: Int[np.ndarray, " n"]) -> float:
    """Variance inflation by errors that neighbouring points share.

    It is the variance of sums of the score over groups, relative to that of independent points.

    Parameters
    ----------
    score : (n, k) float            contribution of each point to the gradient
    label : (n,) int                group of each point

    Returns
    -------
    float [-]                       about 1 if the errors of neighbours are independent

    Source
    ------
    Liang and Zeger, Longitudinal data analysis using generalized linear models, Biometrika 73
    (1986) 13: the covariance of scores that are summed over groups; here its mean ratio to that of
    independent points.
    """
    independent = score.T @ score
    sums = np.stack([np.bincount(label, column) for column in score.T], axis=1)
    inverse = np.linalg.pinv(independent, rcond=1e-8, hermitian=True)
    rank = max(
        np.linalg.matrix_rank(independent, tol=1e-8 * np.trace(independent), hermitian=True), 1
    )
    return float(np.trace(inverse @ (sums.T @ sums))) / rank

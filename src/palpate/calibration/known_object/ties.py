"""Tie points of an object matched between cameras: their residuals, and derivatives of these."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.records import Rig, RigCovariance
from palpate.vision import moved_rig, project, project_jacobian, triangulate

# Central differences over this many standard deviations on each side.
_DIFFERENCE = 0.25


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


def jacobians(
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
    (n, r, k) float [-]             of `residuals`
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


def residuals(rig: Rig, ties: Ties) -> Float[np.ndarray, "n r"]:
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


def variance_inflation(score: Float[np.ndarray, "n k"], label: Int[np.ndarray, " n"]) -> float:
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
    kept = np.linalg.pinv(independent, rcond=1e-8, hermitian=True)
    rank = max(
        np.linalg.matrix_rank(independent, tol=1e-8 * np.trace(independent), hermitian=True), 1
    )
    return float(np.trace(kept @ (sums.T @ sums))) / rank

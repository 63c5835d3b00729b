"""What a boundary element model says that each probing should have seen, as a function of Poisson's
ratio.

The rows of a probing are those of `observations.ResponseModel`: its observed points, then its
contact point. Two models give them: `ReducedResponse` from one factorisation for all Poisson's
ratios, `FullResponse` from a new factorisation at each, the plain way and the reference.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from palpate.bem import BoundarySystem, RightHand, dilation_factor, factorise, solve
from palpate.estimation.responses.reduced_model import ReducedModel

SLOPE_STEP = 1e-4
Value = Callable[[float], Float[np.ndarray, "n_rows 4"]]


@dataclass(frozen=True, slots=True, eq=False)
class PointRows:
    """How the displacement of a contact point follows from the unknowns (`bem.PointEquations`),
    with its loads.

    Attributes
    ----------
    matrix : (2, 3, k) float          constant and slope
    own : (2, 3, 3) float             constant and slope
    right : (3, 3, c) float           constant, slope and curvature
    particular : (3,) float [m Pa]    particular displacement under a body force, over its factor
    """

    matrix: Float[np.ndarray, "2 3 k"]
    own: Float[np.ndarray, "2 3 3"]
    right: Float[np.ndarray, "3 3 c"]
    particular: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True, eq=False)
class ProbeRows:
    """Which displacements a probing sees.

    Attributes
    ----------
    columns : (c,) int                right-hand sides: the force along x, y, z, then the two of a
                                      body force, if any
    surface : (3 n, k) sparse         observed displacements from the unknowns of the system
    particular : (3 n,) float [m Pa]  particular displacement there under a body force, over its
                                      factor
    tip : PointRows or None           where the contact point's displacement was measured
    """

    columns: Int[np.ndarray, " c"]
    surface: csr_array
    particular: Float[np.ndarray, " r"]
    tip: PointRows | None


@dataclass(frozen=True, slots=True, eq=False)
class ReducedResponse:
    """Response of one probing on the reduced model.

    Attributes
    ----------
    model : ReducedModel
    rows : ProbeRows
    surface : (c, 3 n, j) float       observed displacements along the model's directions
    tip : (c, 6, j) float             the contact point's equations along them, constant then slope
    """

    model: ReducedModel
    rows: ProbeRows
    surface: Float[np.ndarray, "c rows terms"]
    tip: Float[np.ndarray, "c six terms"]

    def value(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows 4"]:
        """Displacement times shear modulus per unit force, and under the body force
        (`ResponseModel`)."""
        weights, _ = self.model.coefficients(poisson_ratio, self.rows.columns)
        observed = (self.surface @ weights.T[:, :, None])[:, :, 0].T
        equations = (self.tip @ weights.T[:, :, None])[:, :, 0].T
        return _response(self.rows, observed, equations, poisson_ratio)

    def slope(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows 4"]:
        """Derivative of `value` with respect to Poisson's ratio, by a central difference (error
        1e-8)."""
        return _slope(self.value, poisson_ratio)


@dataclass(frozen=True, slots=True, eq=False)
class FullModel:
    """The system with its right-hand sides, solved anew at each Poisson's ratio.

    Attributes
    ----------
    system : BoundarySystem
    right : RightHand
    solved : dict                     the latest solution by its Poisson's ratio: all probings ask
                                      for the same one
    """

    system: BoundarySystem
    right: RightHand
    solved: dict[float, Float[np.ndarray, "k c"]] = field(default_factory=dict)

    def solution(self, poisson_ratio: float) -> Float[np.ndarray, "k c"]:
        """Unknowns for every right-hand side.

        Parameters
        ----------
        poisson_ratio : float

        Returns
        -------
        (k, c) float
        """
        if poisson_ratio not in self.solved:
            self.solved.clear()
            factorised = factorise(self.system, poisson_ratio)
            self.solved[poisson_ratio] = solve(factorised, self.right.at(poisson_ratio))
        return self.solved[poisson_ratio]


@dataclass(frozen=True, slots=True, eq=False)
class FullResponse:
    """Response of one probing on the full model.

    Attributes
    ----------
    model : FullModel
    rows : ProbeRows
    """

    model: FullModel
    rows: ProbeRows

    def value(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows 4"]:
        """Displacement times shear modulus per unit force, and under the body force
        (`ResponseModel`)."""
        x = self.model.solution(poisson_ratio)[:, self.rows.columns]
        equations = np.zeros((6, x.shape[1]))
        if self.rows.tip is not None:
            equations = (self.rows.tip.matrix @ x).reshape(6, -1)
        return _response(self.rows, self.rows.surface @ x, equations, poisson_ratio)

    def slope(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows 4"]:
        """Derivative of `value` with respect to Poisson's ratio, by a central difference (error
        1e-8)."""
        return _slope(self.value, poisson_ratio)


def reduced_response(model: ReducedModel, rows: ProbeRows) -> ReducedResponse:
    """Project one probing's rows on the directions of the reduced model.

    Parameters
    ----------
    model : ReducedModel
    rows : ProbeRows

    Returns
    -------
    ReducedResponse
    """
    directions = model.directions[:-1, :, rows.columns]
    surface = np.stack([rows.surface @ term for term in directions], axis=2)
    tip = np.zeros((6, rows.columns.size, directions.shape[0]))
    if rows.tip is not None:
        matrix = rows.tip.matrix.reshape(6, -1)
        tip = np.stack([matrix @ term for term in directions], axis=2)
    return ReducedResponse(
        model, rows, surface.transpose(1, 0, 2).copy(), tip.transpose(1, 0, 2).copy()
    )


def _response(
    rows: ProbeRows,
    observed: Float[np.ndarray, "r c"],
    equations: Float[np.ndarray, "6 c"],
    nu: float,
) -> Float[np.ndarray, "n_rows 4"]:
    particular = rows.particular
    if rows.tip is not None:
        own = rows.tip.own[0] + nu * rows.tip.own[1]
        right = rows.tip.right[0] + nu * (rows.tip.right[1] + nu * rows.tip.right[2])
        at_tip = np.linalg.solve(own, equations[:3] + nu * equations[3:] - right)
        observed = np.concatenate([observed, at_tip])
        particular = np.concatenate([particular, rows.tip.particular])
    out = np.zeros((observed.shape[0], 4))
    out[:, :3] = observed[:, :3]
    if observed.shape[1] > 3:
        out[:, 3] = observed[:, 3] + dilation_factor(nu) * (observed[:, 4] + particular)
    return out


def _slope(value: Value, nu: float) -> Float[np.ndarray, "n_rows 4"]:
    return (value(nu + SLOPE_STEP) - value(nu - SLOPE_STEP)) / (2 * SLOPE_STEP)

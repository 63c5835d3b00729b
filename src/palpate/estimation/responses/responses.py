"""What a boundary element model says that each probing should have seen, as a function of Poisson's
ratio.

The rows of a probing are those of `observations.ResponseModel`: its observed points, then its
contact point. Two makers give them: `reduced_response` from one factorisation for all Poisson's
ratios, `full_responses` from a new factorisation at each, the plain way and the reference.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from palpate.bem import BoundarySystem, RightHand, dilation_factor, factorise, solve
from palpate.estimation.responses.reduced_model import ReducedModel

_SLOPE_STEP = 1e-4


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

    def seen(self, solution: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "rows c"]:
        """Observed displacements, then the six equations (constant, slope) of the contact point,
        zero where its displacement was not measured."""
        tip = np.zeros((6, solution.shape[1]))
        if self.tip is not None:
            tip = self.tip.matrix.reshape(6, -1) @ solution
        return np.concatenate([self.surface @ solution, tip])


@dataclass(frozen=True, slots=True, eq=False)
class ProbeResponse:
    """Response of one probing (`ResponseModel`).

    Attributes
    ----------
    rows : ProbeRows
    seen : callable                   Poisson's ratio -> `ProbeRows.seen` of the solution there
    """

    rows: ProbeRows
    seen: Callable[[float], Float[np.ndarray, "rows c"]]

    def value(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows c"]:
        """Displacement times shear modulus per unit force, and under the body force
        (`ResponseModel`)."""
        seen = self.seen(poisson_ratio)
        observed, equations = seen[:-6], seen[-6:]
        particular, tip = self.rows.particular, self.rows.tip
        if tip is not None:
            own = tip.own[0] + poisson_ratio * tip.own[1]
            right = tip.right[0] + poisson_ratio * (tip.right[1] + poisson_ratio * tip.right[2])
            left = equations[:3] + poisson_ratio * equations[3:]
            observed = np.concatenate([observed, np.linalg.solve(own, left - right)])
            particular = np.concatenate([particular, tip.particular])
        response = np.zeros((observed.shape[0], 4))
        response[:, :3] = observed[:, :3]
        if observed.shape[1] > 3:
            factor = dilation_factor(poisson_ratio)
            response[:, 3] = observed[:, 3] + factor * (observed[:, 4] + particular)
        return response

    def slope(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows c"]:
        """Derivative of `value` with respect to Poisson's ratio, by a central difference (error
        1e-8)."""
        higher, lower = (self.value(poisson_ratio + step) for step in (_SLOPE_STEP, -_SLOPE_STEP))
        return (higher - lower) / (2 * _SLOPE_STEP)


def full_responses(
    system: BoundarySystem, right: RightHand, rows: Sequence[ProbeRows]
) -> list[ProbeResponse]:
    """Responses of all probings, the system factorised anew at each Poisson's ratio.

    Parameters
    ----------
    system : BoundarySystem
    right : RightHand                 of all probings
    rows : sequence of ProbeRows

    Returns
    -------
    list of ProbeResponse             the latest solution is kept: all probings ask for the same one
    """

    @lru_cache(maxsize=1)
    def solution(poisson_ratio: float) -> Float[np.ndarray, "k c"]:
        return solve(factorise(system, poisson_ratio), right.at(poisson_ratio))

    def seen_by(probe: ProbeRows) -> Callable[[float], Float[np.ndarray, "rows c"]]:
        return lambda poisson_ratio: probe.seen(solution(poisson_ratio)[:, probe.columns])

    return [ProbeResponse(probe, seen_by(probe)) for probe in rows]


def reduced_response(model: ReducedModel, rows: ProbeRows) -> ProbeResponse:
    """Response of one probing, its rows projected on the directions of the reduced model.

    Parameters
    ----------
    model : ReducedModel
    rows : ProbeRows

    Returns
    -------
    ProbeResponse
    """
    terms = [rows.seen(term) for term in model.directions[:, :, rows.columns]]
    projected = np.stack(terms, axis=2).transpose(1, 0, 2).copy()

    def seen(poisson_ratio: float) -> Float[np.ndarray, "rows c"]:
        weights, _ = model.coefficients(poisson_ratio, rows.columns)
        return (projected @ weights.T[:, :, None])[:, :, 0].T

    return ProbeResponse(rows, seen)

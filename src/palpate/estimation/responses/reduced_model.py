"""The solution at every Poisson's ratio from one factorisation.

The system is linear in nu: (K + d K') x = b + d b', with d the distance of nu from a centre. Its
solution is a power series in d whose terms follow from one another by a back substitution. A
handful of them span a space in which a small least-squares problem finds the solution at any nu,
far outside the radius of convergence of the series itself.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.bem import BoundarySystem, RightHand, factorise, solve, system_slope
from palpate.errors import NotConvergedError

CENTRE = 0.3
FEWEST_DIRECTIONS = 10
MOST_DIRECTIONS = 40
SAMPLED_ROWS = 500


@dataclass(frozen=True, slots=True, eq=False)
class ReducedModel:
    """Directions in which the solutions for all Poisson's ratios lie.

    Attributes
    ----------
    centre : float                            Poisson's ratio of the factorisation
    directions : (j + 1, k, c) float          terms of the power series for each of c right-hand
                                              sides; the last one serves to measure the residual
                                              only
    triangular : (c, j, j) float              triangular factor of each column's directions from the
                                              third on
    scale : (c,) float                        norm of each column's solution at the centre, over the
                                              same rows
    """

    centre: float
    directions: Float[np.ndarray, "terms k c"]
    triangular: Float[np.ndarray, "c rank rank"]
    scale: Float[np.ndarray, " c"]

    def coefficients(
        self, poisson_ratio: float, columns: Int[np.ndarray, " c"] | slice = slice(None)
    ) -> tuple[Float[np.ndarray, "j c"], float]:
        """Weights of the directions that give the solution at one Poisson's ratio.

        Parameters
        ----------
        poisson_ratio : float
        columns : (c,) int        right-hand sides asked for, all by default

        Returns
        -------
        (j, c) float              the first is 1, the second the distance from the centre: the
                                  right-hand side is quadratic, and these take its terms up to
                                  there; the others minimise the residual
        float                     largest residual over the columns, relative to the solution at the
                                  centre
        """
        distance = poisson_ratio - self.centre
        count = self.directions.shape[0] - 3
        step = np.eye(count + 1, count) - distance * np.eye(count + 1, count, k=-1)
        triangular = self.triangular[columns]
        matrix = triangular @ step
        right = distance**2 * triangular[:, :, 0]
        q, r = np.linalg.qr(matrix)
        inner = np.linalg.solve(r, np.einsum("cij,ci->cj", q, right)[:, :, None])[:, :, 0]
        left = right - np.einsum("cij,cj->ci", matrix, inner)
        residual = np.linalg.norm(left, axis=1) / self.scale[columns]
        first = np.broadcast_to([1.0, distance], (inner.shape[0], 2))
        weights = np.concatenate([first, inner], axis=1)
        return weights.T, float(residual.max(initial=0.0))


def make_reduced_model(
    system: BoundarySystem,
    right: RightHand,
    *,
    poisson_range: tuple[float, float] = (0.0, 0.4999),
    tolerance: float = 1e-6,
) -> ReducedModel:
    """Factorise once and gather directions until they serve the whole range.

    Parameters
    ----------
    system : BoundarySystem
    right : RightHand                 c columns
    poisson_range : (float, float)    Poisson's ratios that will be asked for
    tolerance : float                 largest relative residual at both ends, where it is largest

    Returns
    -------
    ReducedModel

    Raises
    ------
    SingularSystemError               the support does not hold the object
    NotConvergedError                 the tolerance is not met with `MOST_DIRECTIONS`
    """
    factorised = factorise(system, CENTRE)
    matrix_slope = system_slope(system)
    terms = [solve(factorised, right.at(CENTRE))]
    _, slope, curvature = right.terms
    slope = slope + 2 * CENTRE * curvature
    terms.append(solve(factorised, slope - matrix_slope.apply(terms[0])))
    terms.append(solve(factorised, curvature - matrix_slope.apply(terms[1])))
    residual = np.inf
    while len(terms) <= MOST_DIRECTIONS:
        terms.append(solve(factorised, -matrix_slope.apply(terms[-1])))
        if len(terms) >= FEWEST_DIRECTIONS:
            model = _model_of(terms)
            residual = max(model.coefficients(nu)[1] for nu in poisson_range)
            if residual <= tolerance:
                return model
    raise NotConvergedError(
        f"the reduced model leaves a residual of {residual:.1e} over Poisson's ratios "
        f"{poisson_range[0]} to {poisson_range[1]}, at most {tolerance:.0e} is allowed; narrow the "
        "range, or use the method nelder-mead"
    )


def _model_of(terms: list[Float[np.ndarray, "k c"]]) -> ReducedModel:
    directions = np.stack(terms)
    # A least-squares problem of ten unknowns needs no more rows than these: every step-th unknown.
    rows = directions[:, :: max(1, directions.shape[1] // SAMPLED_ROWS)]
    triangular = np.array(np.linalg.qr(rows[2:].transpose(2, 1, 0), mode="r"))
    return ReducedModel(CENTRE, directions, triangular, np.linalg.norm(rows[0], axis=0))

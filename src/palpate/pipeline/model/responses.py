"""Displacements that the model predicts for each probing, as a function of Poisson's ratio.

The rows of a probing are those of `estimation.ResponseModel`: its observed points, then its contact
point. Two functions make them: `reduced_responses` from one factorisation for all Poisson's ratios,
`full_responses` (the plain reference) from a new factorisation at each.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from numpy.polynomial.chebyshev import chebpts1, chebvander
from numpy.polynomial.polyutils import mapdomain

from palpate.bem import SolutionModel
from palpate.pipeline.model.probe_rows import ProbeRows

_SLOPE_STEP = 1e-4
# Degrees of the series tried, and the coefficient over the largest below which they end: well below
# the error of a reduced model.
_DEGREES = (16, 32, 64, 128)
_SERIES_ERROR = 1e-10
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True, slots=True, eq=False)
class ProbeResponse:
    """Response of one probing (`estimation.ResponseModel`).

    Attributes
    ----------
    rows : ProbeRows
    blocks : callable                 Poisson's ratio -> (1 + d, rows, c): `ProbeRows.observed` of
                                      the solution there, and its derivatives with respect to the
                                      compliance of each of d compliant supports
    """

    rows: ProbeRows
    blocks: Callable[[float], Float[np.ndarray, "n rows c"]]

    def value(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows c"]:
        """Displacement times shear modulus per unit force and under known loads, and displacement
        per unit of motion (`estimation.ResponseModel`)."""
        return self._value_of(self.blocks(poisson_ratio)[0], poisson_ratio)

    def change(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows p"]:
        """Displacement times shear modulus for the p columns of perturbed contacts [m Pa].

        Parameters
        ----------
        poisson_ratio : float
        """
        moved, _ = self._moved(self.blocks(poisson_ratio)[0], poisson_ratio)
        return moved[:, moved.shape[1] - self.rows.changes :]

    def compliance_derivative(
        self, poisson_ratio: float, support: int
    ) -> Float[np.ndarray, "n_rows c"]:
        """Derivative of `value` with respect to the compliance [m/Pa] of one support, (n_rows, c).

        Parameters
        ----------
        poisson_ratio : float [-]
        support : int                 index among the d supports
        """
        value, change = self.blocks(poisson_ratio)[[0, 1 + support]]
        # Nonlinear only for a support that is pulled: its force replaces its translations.
        size = max(float(np.linalg.norm(change)), _TINY)
        step = _SLOPE_STEP * float(np.linalg.norm(value)) / size
        more, less = (
            self._value_of(value + side * change, poisson_ratio) for side in (step, -step)
        )
        return (more - less) / (2 * step)

    def _value_of(
        self, observed: Float[np.ndarray, "rows c"], poisson_ratio: float
    ) -> Float[np.ndarray, "n_rows t"]:
        """`value`, from what is observed of the solution."""
        moved, force = self._moved(observed, poisson_ratio)
        particular, tip = self.rows.particular, self.rows.tip
        if tip is not None:
            particular = np.concatenate([particular, tip.particular])
        kept = moved.shape[1] - self.rows.changes
        return self.rows.response(moved[:, :kept], force[:, :kept], particular, poisson_ratio)

    def _moved(
        self, observed: Float[np.ndarray, "rows c"], poisson_ratio: float
    ) -> tuple[Float[np.ndarray, "n_rows c"], Float[np.ndarray, "3 c"]]:
        """Displacement of the rows for every column, and the force on the pulled support."""
        displacement, equations, force = np.split(observed, [-9, -3])
        tip = self.rows.tip
        if tip is not None:
            own = tip.own[0] + poisson_ratio * tip.own[1]
            right = tip.right[0] + poisson_ratio * (tip.right[1] + poisson_ratio * tip.right[2])
            left = equations[:3] + poisson_ratio * equations[3:]
            displacement = np.concatenate([displacement, np.linalg.solve(own, left - right)])
        return displacement, force


def full_responses(
    solution: Callable[[float], Float[np.ndarray, "k c"]],
    rows: Sequence[ProbeRows],
    *,
    blocks: int = 1,
) -> list[ProbeResponse]:
    """Responses of all probings, the system factorised anew at each Poisson's ratio.

    Parameters
    ----------
    solution : function               Poisson's ratio -> (k, c) float: solutions and their
                                      derivatives in blocks (`bem.SpringSystem`)
    rows : sequence of ProbeRows
    blocks : int                      1 + d, d the number of compliant supports

    Returns
    -------
    list of ProbeResponse             these share a cache of the latest solution
    """
    latest = lru_cache(maxsize=1)(solution)

    def response_of(probe: ProbeRows) -> ProbeResponse:
        def observed(poisson_ratio: float) -> Float[np.ndarray, "n rows c"]:
            parts = np.split(latest(poisson_ratio)[:, probe.columns], blocks)
            return np.stack([probe.observed(part) for part in parts])

        return ProbeResponse(probe, observed)

    return list(map(response_of, rows))


def reduced_responses(
    model: SolutionModel,
    rows: Sequence[ProbeRows],
    poisson_range: tuple[float, float],
    *,
    blocks: int = 1,
) -> list[ProbeResponse]:
    """Responses of all probings from a reduced model, as Chebyshev series in Poisson's ratio.

    Parameters
    ----------
    model : SolutionModel
    rows : sequence of ProbeRows
    poisson_range : (float, float)    that the model covers
    blocks : int                      1 + d, as `full_responses`

    Returns
    -------
    list of ProbeResponse
    """
    projected = [_projected(model, probe, blocks) for probe in rows]
    for degree in _DEGREES:
        weights = [model.coefficients(nu)[0] for nu in _nodes(degree, poisson_range)]
        series = [
            _series(basis, [weight[:, probe.columns] for weight in weights])
            for probe, basis in zip(rows, projected, strict=True)
        ]
        if all(len(each) < degree for each in series):
            break
    return [
        _series_response(probe, coefficients, poisson_range)
        for probe, coefficients in zip(rows, series, strict=True)
    ]


def _projected(
    model: SolutionModel, probe: ProbeRows, blocks: int
) -> Float[np.ndarray, "n c rows j"]:
    """Observations of each basis vector."""
    terms = [
        [probe.observed(part) for part in np.split(vectors, blocks)]
        for vectors in model.basis(probe.columns)
    ]
    return np.stack(terms).transpose(1, 3, 2, 0).copy()


def _nodes(degree: int, ends: tuple[float, float]) -> list[float]:
    """Chebyshev points of an interval."""
    return list(mapdomain(chebpts1(degree + 1), (-1.0, 1.0), ends))


def _series(
    projected: Float[np.ndarray, "n c rows j"], weights: Sequence[Float[np.ndarray, "j c"]]
) -> Float[np.ndarray, "k n rows c"]:
    """Chebyshev coefficients of observations, as many as they need, from their values at as many
    points as there are weights."""
    values = np.stack([(projected @ each.T[:, :, None])[..., 0] for each in weights])
    degree = len(weights) - 1
    at_nodes = chebvander(chebpts1(degree + 1), degree)
    # Orthogonal at these points.
    transform = at_nodes.T / np.square(at_nodes).sum(axis=0)[:, None]
    coefficients = np.tensordot(transform, values, axes=1)
    size = np.abs(coefficients).max(axis=(1, 3))
    needed = (size > _SERIES_ERROR * size.max(axis=0)).any(axis=1)
    last = int(np.flatnonzero(needed).max(initial=0))
    return coefficients[: last + 1].swapaxes(2, 3).copy()


def _series_response(
    probe: ProbeRows,
    coefficients: Float[np.ndarray, "k n rows c"],
    ends: tuple[float, float],
) -> ProbeResponse:
    degree = len(coefficients) - 1

    @lru_cache(maxsize=1)
    def observed(poisson_ratio: float) -> Float[np.ndarray, "n rows c"]:
        terms = chebvander(mapdomain([poisson_ratio], ends, (-1.0, 1.0)), degree)[0]
        return np.tensordot(terms, coefficients, axes=1)

    return ProbeResponse(probe, observed)

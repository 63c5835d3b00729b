"""Displacements that a boundary element model predicts for each probing, as a function of Poisson's
ratio.

The rows of a probing are those of `observations.ResponseModel`: its observed points, then its
contact point. Two functions make them: `reduced_responses` from one factorisation for all Poisson's
ratios, `full_responses` (the plain reference) from a new factorisation at each.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from numpy.polynomial.chebyshev import chebpts1, chebvander
from numpy.polynomial.polyutils import mapdomain
from scipy.sparse import csr_array

from palpate.bem import (
    BoundarySystem,
    CompressedSystem,
    RightHand,
    dilation_factor,
    factorise,
    solve,
)
from palpate.errors import InputError
from palpate.estimation.reduced_model import SolutionModel

_SLOPE_STEP = 1e-4
# Degrees of the series tried, and the coefficient over the largest below which they end: well below
# the error of a reduced model.
_DEGREES = (16, 32, 64, 128)
_SERIES_ERROR = 1e-10
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True, slots=True, eq=False)
class PointRows:
    """Equations for the displacement of a contact point from the unknowns and loads
    (`bem.PointEquations`).

    Attributes
    ----------
    matrix : (2, 3, k) float          constant and slope in Poisson's ratio
    own : (2, 3, 3) float             constant and slope
    right : (3, 3, c) float           constant, slope and curvature
    particular : (3,) float [m Pa]    particular solution for a body force, over `dilation_factor`
    """

    matrix: Float[np.ndarray, "2 3 k"]
    own: Float[np.ndarray, "2 3 3"]
    right: Float[np.ndarray, "3 3 c"]
    particular: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True, eq=False)
class ProbeMotions:
    """Motions of a probing's supports.

    Attributes
    ----------
    own : (n_rows, q) float           prescribed displacement per unit of each motion, at the rows
                                      of the probing; the solution adds that of the free surface
    support_force : (3, k) sparse or None    takes the unknowns to the resultant force on the
                                      support that is pulled, for a shear modulus of one pascal
    pulled_translations : (3,) int    indices of the motions that are that support's translations
                                      along x, y and z: its force replaces them
    holding : (3, 3) float            projector onto the directions in which the support holds the
                                      object and is pulled
    """

    own: Float[np.ndarray, "n_rows q"]
    support_force: csr_array | None = None
    pulled_translations: tuple[int, ...] = ()
    holding: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))

    def split(
        self, moved: Float[np.ndarray, "n_rows q"], force: Float[np.ndarray, "3 c"]
    ) -> tuple[Float[np.ndarray, "n_rows 3"], Float[np.ndarray, "n_rows r"]]:
        """Displacement per newton on the support that is pulled, and per unit of the remaining
        motions at constant force on it.

        Parameters
        ----------
        moved : (n_rows, q) float     displacement per unit of each motion
        force : (3, q) float          force on the support per unit of each

        Returns
        -------
        two arrays                    the second without the columns `pulled_translations`
        """
        pulled = list(self.pulled_translations)
        others = np.setdiff1d(np.arange(moved.shape[1]), pulled)
        # A roller transmits force along the directions that it holds only.
        value, vector = np.linalg.eigh(self.holding)
        along = vector[:, value > 0.5]
        compliance = along @ np.linalg.solve(along.T @ force[:, pulled] @ along, along.T)
        per_newton = moved[:, pulled] @ compliance
        return per_newton, moved[:, others] - per_newton @ force[:, others]


@dataclass(frozen=True, slots=True, eq=False)
class ProbeRows:
    """Observations of a probing as linear functions of the solutions.

    Attributes
    ----------
    columns : (c,) int                right-hand sides: the force along x, y, z, unless it acts on a
                                      support; known loads; the two of a body force, if any; motions
                                      of supports; perturbed contacts
    surface : (3 n, k) sparse         takes the unknowns to the observed displacements
    particular : (3 n,) float [m Pa]  particular solution there for a body force, over
                                      `dilation_factor`
    tip : PointRows or None           None: the contact point's displacement was not measured
    known_loads : (l,) float          multiplier of each known load
    has_body_force : bool             whether a body force acts
    motions : ProbeMotions or None    None: no support moves
    changes : int                     number of columns for perturbed contacts, the last ones
    """

    columns: Int[np.ndarray, " c"]
    surface: csr_array
    particular: Float[np.ndarray, " r"]
    tip: PointRows | None
    known_loads: Float[np.ndarray, " l"] = field(default_factory=lambda: np.zeros(0))
    has_body_force: bool = False
    motions: ProbeMotions | None = None
    changes: int = 0

    @property
    def support_force(self) -> csr_array | None:
        """See `ProbeMotions`."""
        return None if self.motions is None else self.motions.support_force

    def observed(self, solution: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "rows c"]:
        """Observed displacements, then the six equations (constant, slope) of the contact point and
        the force on a support; zero where these are not needed."""
        tip, force = np.zeros((6, solution.shape[1])), np.zeros((3, solution.shape[1]))
        if self.tip is not None:
            tip = self.tip.matrix.reshape(6, -1) @ solution
        if self.support_force is not None:
            force = self.support_force @ solution
        return np.concatenate([self.surface @ solution, tip, force])

    def response(
        self,
        moved: Float[np.ndarray, "n_rows c"],
        force: Float[np.ndarray, "3 c"],
        particular: Float[np.ndarray, " n_rows"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "n_rows t"]:
        """Assemble the response (`ResponseModel`) from the solutions for the columns.

        Parameters
        ----------
        moved : (n_rows, c) float             displacement of each solution, for G = 1 Pa
        force : (3, c) float                  on the support that is pulled
        particular : (n_rows,) float          as the attribute, the tip included
        poisson_ratio : float
        """
        combination = np.zeros((moved.shape[1], 4))
        first = 0 if self.support_force is not None else 3
        combination[:first, :3] = np.eye(first, 3)
        last = first + len(self.known_loads)
        combination[first:last, 3] = self.known_loads
        offset = np.zeros((len(moved), 4))
        if self.has_body_force:
            factor = dilation_factor(poisson_ratio)
            combination[last : last + 2, 3] = 1.0, factor
            offset[:, 3] = factor * particular
        per_load = moved @ combination + offset
        if self.motions is None:
            return per_load
        count = self.motions.own.shape[1]
        per_motion = self.motions.own + moved[:, moved.shape[1] - count :]
        if self.support_force is not None:
            per_newton, per_motion = self.motions.split(per_motion, force[:, -count:])
            # The force on the support is prescribed, so the support yields to the other loads.
            per_load[:, 3] -= per_newton @ (force @ combination[:, 3])
            per_load[:, :3] = per_newton
        return np.concatenate([per_load, per_motion], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class ProbeResponse:
    """Response of one probing (`ResponseModel`).

    Attributes
    ----------
    rows : ProbeRows
    observed : callable               Poisson's ratio -> `ProbeRows.observed` of the solution there
    """

    rows: ProbeRows
    observed: Callable[[float], Float[np.ndarray, "rows c"]]

    def value(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows c"]:
        """Displacement times shear modulus per unit force and under known loads, and displacement
        per unit of motion (`ResponseModel`)."""
        moved, force = self._moved(poisson_ratio)
        particular, tip = self.rows.particular, self.rows.tip
        if tip is not None:
            particular = np.concatenate([particular, tip.particular])
        kept = moved.shape[1] - self.rows.changes
        return self.rows.response(moved[:, :kept], force[:, :kept], particular, poisson_ratio)

    def change(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows p"]:
        """Displacement times shear modulus for the p columns of perturbed contacts [m Pa].

        Parameters
        ----------
        poisson_ratio : float
        """
        moved, _ = self._moved(poisson_ratio)
        return moved[:, moved.shape[1] - self.rows.changes :]

    def _moved(
        self, poisson_ratio: float
    ) -> tuple[Float[np.ndarray, "n_rows c"], Float[np.ndarray, "3 c"]]:
        """Displacement of the rows for every column, and the force on the pulled support."""
        displacement, equations, force = np.split(self.observed(poisson_ratio), [-9, -3])
        tip = self.rows.tip
        if tip is not None:
            own = tip.own[0] + poisson_ratio * tip.own[1]
            right = tip.right[0] + poisson_ratio * (tip.right[1] + poisson_ratio * tip.right[2])
            left = equations[:3] + poisson_ratio * equations[3:]
            displacement = np.concatenate([displacement, np.linalg.solve(own, left - right)])
        return displacement, force


@dataclass(frozen=True, slots=True, eq=False)
class SpringResponse(ProbeResponse):
    """Response of one probing of an object on compliant supports (`ResponseModel`).

    Attributes
    ----------
    blocks : callable                 Poisson's ratio -> (1 + d, rows, c): `observed` there, and its
                                      derivatives with respect to the compliance (give) of each of d
                                      supports
    """

    blocks: Callable[[float], Float[np.ndarray, "n rows c"]]

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

        def moved(give: float) -> Float[np.ndarray, "n_rows c"]:
            return ProbeResponse(self.rows, lambda _: value + give * change).value(poisson_ratio)

        return (moved(step) - moved(-step)) / (2 * step)


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
    list of ProbeResponse             these share a cache of the latest solution

    Raises
    ------
    InputError                        the system is compressed: it has no factorisation
    """
    if isinstance(system, CompressedSystem):
        raise InputError(
            f"the method nelder-mead factorises anew at every step, and a surface of"
            f" {len(system.surface.mesh.vertices)} vertices is solved by iteration instead: leave"
            " --method out, or simplify the surface"
        )

    def solution(poisson_ratio: float) -> Float[np.ndarray, "k c"]:
        return solve(factorise(system, poisson_ratio), right.at(poisson_ratio))

    springs = full_spring_responses(solution, rows, blocks=1)
    return [ProbeResponse(response.rows, response.observed) for response in springs]


def full_spring_responses(
    solution: Callable[[float], Float[np.ndarray, "k c"]], rows: Sequence[ProbeRows], blocks: int
) -> list[SpringResponse]:
    """As `full_responses`, for an object on springs.

    Parameters
    ----------
    solution : function               Poisson's ratio -> (k, c) float: solutions and their
                                      derivatives in blocks (`SpringSystem`)
    rows : sequence of ProbeRows
    blocks : int                      1 + d, d the number of derivatives

    Returns
    -------
    list of SpringResponse
    """
    latest = lru_cache(maxsize=1)(solution)

    def response_of(probe: ProbeRows) -> SpringResponse:
        def observed(poisson_ratio: float) -> Float[np.ndarray, "n rows c"]:
            parts = np.split(latest(poisson_ratio)[:, probe.columns], blocks)
            return np.stack([probe.observed(part) for part in parts])

        return SpringResponse(probe, lambda poisson_ratio: observed(poisson_ratio)[0], observed)

    return list(map(response_of, rows))


def reduced_responses(
    model: SolutionModel, rows: Sequence[ProbeRows], poisson_range: tuple[float, float]
) -> list[ProbeResponse]:
    """Responses of all probings from a reduced model, as Chebyshev series in Poisson's ratio.

    Parameters
    ----------
    model : SolutionModel
    rows : sequence of ProbeRows
    poisson_range : (float, float)    that the model covers

    Returns
    -------
    list of ProbeResponse
    """
    springs = reduced_spring_responses(model, rows, 1, poisson_range)
    return [ProbeResponse(response.rows, response.observed) for response in springs]


def reduced_spring_responses(
    model: SolutionModel, rows: Sequence[ProbeRows], blocks: int, poisson_range: tuple[float, float]
) -> list[SpringResponse]:
    """As `reduced_responses`, for an object on springs.

    Parameters
    ----------
    model : SolutionModel             of `make_spring_model`
    rows : sequence of ProbeRows
    blocks : int                      1 + d: solutions and their derivatives
    poisson_range : (float, float)    that the model covers

    Returns
    -------
    list of SpringResponse
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
) -> SpringResponse:
    degree = len(coefficients) - 1

    @lru_cache(maxsize=1)
    def observed(poisson_ratio: float) -> Float[np.ndarray, "n rows c"]:
        terms = chebvander(mapdomain([poisson_ratio], ends, (-1.0, 1.0)), degree)[0]
        return np.tensordot(terms, coefficients, axes=1)

    return SpringResponse(probe, lambda poisson_ratio: observed(poisson_ratio)[0], observed)

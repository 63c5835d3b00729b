"""Displacements that the model predicts for each probing, as a function of Poisson's ratio.

The rows of a probing are those of `estimation.ResponseModel`: its observed points, then its contact
point. Two functions make them: `reduced_responses` from one factorisation for all Poisson's ratios,
`full_responses` (the plain reference) from a new factorisation at each. On compliant supports they
depend on the modulus, too (`spring_responses`).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np
from jaxtyping import Float, Int
from numpy.polynomial.chebyshev import chebpts1, chebvander
from numpy.polynomial.polyutils import mapdomain
from scipy.sparse import csr_array

from palpate.bem import (
    CENTRE,
    CentredSystem,
    SolutionModel,
    Springs,
    factorise,
    make_spring_factors,
    make_spring_model,
    make_spring_system,
)
from palpate.estimation import (
    FitMethod,
    FitSettings,
    Nuisance,
    NuisanceParameter,
    ResponseTerms,
    Settlement,
)
from palpate.pipeline.model.object_model import ObjectModel, ObservationMatrix
from palpate.pipeline.model.supports import (
    compliances,
    compliant_supports,
    weight_on_springs,
)

_SLOPE_STEP = 1e-4
# Solutions that are kept: derivatives in Poisson's ratio ask for three, again and again where it is
# held.
_KEPT = 8
# Degrees of the series tried, and the coefficient over the largest below which they end: of
# displacements that of single precision, in which they are kept, as they are a good part of what a
# fit keeps. Forces on a support that is pulled are inverted: to shift the end of a thin sheet
# across takes 1e-4 of the force that shifts it along.
_DEGREES = (16, 32, 64, 128)
_SERIES_ERROR, _FORCE_ERROR = 3e-8, 1e-10
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True, slots=True, eq=False)
class ProbeResponse:
    """Response of one probing (`estimation.ResponseModel`).

    Attributes
    ----------
    rows : ObservationMatrix
    blocks : callable                 Poisson's ratio -> (1 + d, rows, c):
                                      `ObservationMatrix.observed` of the solution there, and its
                                      derivatives with respect to the compliance of each of d
                                      compliant supports
    """

    rows: ObservationMatrix
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
        count = moved.shape[1] - self.rows.changes
        return self.rows.response(moved[:, :count], force[:, :count], poisson_ratio)

    def _moved(
        self, observed: Float[np.ndarray, "rows c"], poisson_ratio: float
    ) -> tuple[Float[np.ndarray, "n_rows c"], Float[np.ndarray, "3 c"]]:
        """Displacement of the rows for every column, and the force on the pulled support."""
        constant, slope = self.rows.indentation
        return observed[:-3] + constant + poisson_ratio * slope, observed[-3:]


# Function from a shear modulus [Pa] to the responses of some rows.
Responses = Callable[[float], list[ProbeResponse]]


def full_responses(
    solution: Callable[[float], Float[np.ndarray, "k c"]],
    rows: Sequence[ObservationMatrix],
    *,
    blocks: int = 1,
) -> list[ProbeResponse]:
    """Responses of all probings, the system factorised anew at each Poisson's ratio.

    Parameters
    ----------
    solution : function               Poisson's ratio -> (k, c) float: solutions and their
                                      derivatives in blocks (`bem.SpringSystem`)
    rows : sequence of ObservationMatrix
    blocks : int                      1 + d, d the number of compliant supports

    Returns
    -------
    list of ProbeResponse             these share a cache of the latest solutions
    """
    latest = lru_cache(maxsize=_KEPT)(solution)

    def response_of(probe: ObservationMatrix) -> ProbeResponse:
        def observed(poisson_ratio: float) -> Float[np.ndarray, "n rows c"]:
            parts = np.split(latest(poisson_ratio)[:, probe.columns], blocks)
            return np.stack([probe.observed(part) for part in parts])

        if probe.support_force is None:
            return ProbeResponse(probe, observed)
        return ProbeResponse(probe.where_force_counts(observed(CENTRE)[0]), observed)

    return list(map(response_of, rows))


def reduced_responses(
    model: SolutionModel,
    rows: Iterable[ObservationMatrix],
    poisson_range: tuple[float, float],
    *,
    blocks: int = 1,
    columns: Int[np.ndarray, " m"] | None = None,
) -> list[ProbeResponse]:
    """Responses of probings from a reduced model, as Chebyshev series in Poisson's ratio.

    Parameters
    ----------
    model : SolutionModel
    rows : iterable of ObservationMatrix
    poisson_range : (float, float)    that the model covers
    blocks : int                      1 + d, as `full_responses`
    columns : (m,) int or None        ascending; which right-hand sides the model is of; None: all

    Returns
    -------
    list of ProbeResponse
    """

    @cache
    def weights(degree: int) -> list[Float[np.ndarray, "j c"]]:
        return [model.coefficients(nu)[0] for nu in _nodes(degree, poisson_range)]

    def response_of(probe: ObservationMatrix) -> ProbeResponse:
        own = probe.columns if columns is None else np.searchsorted(columns, probe.columns)
        projected = _projected(model, probe, own, blocks)
        for degree in _DEGREES:
            at_nodes = [node_weights[:, own] for node_weights in weights(degree)]
            moved = _series(projected[:, :, :-3], at_nodes, _SERIES_ERROR).astype(np.float32)
            force = _series(projected[:, :, -3:], at_nodes, _FORCE_ERROR)
            if max(len(moved), len(force)) < degree:
                break
        return _series_response(probe, (moved, force), poisson_range)

    # One after the other: what is projected is larger than its series.
    return list(map(response_of, rows))


def spring_responses(
    model: ObjectModel, springs: Springs, rows: Sequence[ObservationMatrix], settings: FitSettings
) -> Responses:
    """Responses of probings of an object on springs, from one factorisation for all materials.

    Parameters
    ----------
    model : ObjectModel
    springs : Springs               of this model
    rows : sequence of ObservationMatrix
    settings : FitSettings          method and range of Poisson's ratio

    Returns
    -------
    function                        shear modulus [Pa] -> list of ProbeResponse

    Raises
    ------
    SingularSystemError             the support does not hold the object
    NotConvergedError               the basis of the reduced model does not converge
    """
    system = model.system
    unit_compliances = compliances(model.session) / system.traction_length
    known_traction = _known_traction(model, springs)
    changes, blocks = springs.compliance_derivatives(unit_compliances), 1 + len(unit_compliances)
    if settings.method == FitMethod.NELDER_MEAD:

        def exact(shear_modulus: float) -> list[ProbeResponse]:
            compliance = springs.compliance(shear_modulus * unit_compliances)
            right = model.right.on_springs(compliance, changes, known_traction)

            def solution(poisson_ratio: float) -> Float[np.ndarray, "k c"]:
                factors = make_spring_factors(factorise(system, poisson_ratio), system, springs)
                return make_spring_system(factors, compliance, changes).solve(
                    right.at(poisson_ratio)
                )

            return full_responses(solution, rows, blocks=blocks)

        return exact
    centred = CentredSystem(system, CENTRE)
    factors = make_spring_factors(centred.factorised, system, springs)

    def reduced(shear_modulus: float) -> list[ProbeResponse]:
        reduced_model = make_spring_model(
            centred.slope, factors, model.right,
            springs.compliance(shear_modulus * unit_compliances), changes,
            known_traction=known_traction, poisson_range=settings.poisson_range,
        )  # fmt: skip
        return reduced_responses(reduced_model, rows, settings.poisson_range, blocks=blocks)

    return reduced


def settlement(
    model: ObjectModel, response: ProbeResponse, shear_modulus: float
) -> Settlement | None:
    """Dependence of a response on the shear modulus at which it was taken.

    Parameters
    ----------
    model : ObjectModel
    response : ProbeResponse
    shear_modulus : float [Pa]      at which it was taken

    Returns
    -------
    Settlement or None              None: no support has a stiffness
    """
    scale = shear_modulus / model.system.traction_length * compliances(model.session)
    if not scale.any():
        return None

    def derivative(poisson_ratio: float) -> Float[np.ndarray, "n_rows c"]:
        parts = [
            scale[k] * response.compliance_derivative(poisson_ratio, int(k))
            for k in np.flatnonzero(scale)
        ]
        return np.asarray(np.sum(parts, axis=0))

    return Settlement(shear_modulus, derivative)


def compliance_error(model: ObjectModel, response: ProbeResponse) -> Nuisance | None:
    """Error of the supports' compliance stated by the session: beds of springs in excess of the
    model's, one parameter for each support, shared by all probings.

    Negative compliance is unphysical, but a symmetric prior keeps noise alone from biasing the
    estimate towards soft supports.

    Parameters
    ----------
    model : ObjectModel
    response : ProbeResponse

    Returns
    -------
    Nuisance or None                None: compliances are exact
    """
    std, length = model.session.errors.support_compliance, model.system.traction_length
    if std == 0.0:
        return None
    supports = compliant_supports(model.session)

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r 2 c s"]:
        moved = [
            response.compliance_derivative(at.poisson_ratio, k)[at.rows] / length
            for k in range(len(supports))
        ]
        # It does not depend on the material.
        derivative = std * np.stack(moved, axis=2)
        return np.stack([np.zeros_like(derivative), derivative], axis=1)

    parameters = (
        NuisanceParameter(f"compliance of support {k + 1}", std, "m/Pa", "compliance of supports")
        for k in supports
    )
    return Nuisance(tuple(parameters), effects)


def _projected(
    model: SolutionModel, probe: ObservationMatrix, own: Int[np.ndarray, " c"], blocks: int
) -> Float[np.ndarray, "n c rows j"]:
    """Observations of each basis vector."""
    terms = [
        [probe.observed(part) for part in np.split(vectors, blocks)] for vectors in model.basis(own)
    ]
    return np.stack(terms).transpose(1, 3, 2, 0).copy()


def _nodes(degree: int, ends: tuple[float, float]) -> list[float]:
    """Chebyshev points of an interval."""
    return list(mapdomain(chebpts1(degree + 1), (-1.0, 1.0), ends))


def _series(
    projected: Float[np.ndarray, "n c rows j"],
    weights: Sequence[Float[np.ndarray, "j c"]],
    error: float,
) -> Float[np.ndarray, "k n rows c"]:
    """Chebyshev coefficients of observations from their values at as many points as there are
    weights, without the last ones that are below an error relative to the largest."""
    values = np.stack(
        [(projected @ column_weights.T[:, :, None])[..., 0] for column_weights in weights]
    )
    degree = len(weights) - 1
    at_nodes = chebvander(chebpts1(degree + 1), degree)
    # Orthogonal at these points.
    transform = at_nodes.T / np.square(at_nodes).sum(axis=0)[:, None]
    coefficients = np.tensordot(transform, values, axes=1)
    size = np.abs(coefficients).max(axis=(1, 3), initial=0.0)
    needed = (size > error * size.max(axis=0)).any(axis=1)
    last = int(np.flatnonzero(needed).max(initial=0))
    return coefficients[: last + 1].swapaxes(2, 3)


def _series_response(
    probe: ObservationMatrix,
    coefficients: tuple[Float[np.ndarray, "k n rows c"], Float[np.ndarray, "l n 3 c"]],
    ends: tuple[float, float],
) -> ProbeResponse:
    """Response from the coefficients of the displacements and of the forces."""

    def observed(poisson_ratio: float) -> Float[np.ndarray, "n rows c"]:
        x = mapdomain([poisson_ratio], ends, (-1.0, 1.0))
        parts = [
            np.einsum("k,knrc->nrc", chebvander(x, len(part) - 1)[0], part) for part in coefficients
        ]
        return np.concatenate(parts, axis=1)

    probe = probe.where_force_counts(observed(float(np.mean(ends)))[0])
    if probe.changes:
        # Value and change are asked for together.
        observed = lru_cache(maxsize=1)(observed)
    # The series has taken the matrix up, which would be most of what a fit of many probings keeps.
    return ProbeResponse(replace(probe, surface=csr_array(probe.surface.shape)), observed)


def _known_traction(model: ObjectModel, springs: Springs) -> Float[np.ndarray, "e c"] | None:
    """Known part of the traction on every spring, for each column of the model [N/m]."""
    if model.body is None:
        return None
    traction = np.zeros((len(springs.support_fraction), model.right.terms.shape[2]))
    # That of the body force is the first of its two columns.
    first = model.loads.weight_columns[0]
    traction[:, first] = weight_on_springs(model.system, springs, model.body)
    return traction

"""Responses of probings of an object on compliant supports, and their dependence on its modulus."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from palpate.bem import (
    CENTRE,
    CentredSystem,
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
from palpate.pipeline.model.compliant_supports import (
    compliances,
    compliant_supports,
    weight_on_springs,
)
from palpate.pipeline.model.object_model import ObjectModel
from palpate.pipeline.model.probe_rows import ProbeRows
from palpate.pipeline.model.responses import ProbeResponse, full_responses, reduced_responses

# Function from a shear modulus [Pa] to the responses of some rows.
Responses = Callable[[float], list[ProbeResponse]]


def spring_responses(
    model: ObjectModel, springs: Springs, rows: Sequence[ProbeRows], settings: FitSettings
) -> Responses:
    """Responses of probings of an object on springs, from one factorisation for all materials.

    Parameters
    ----------
    model : ObjectModel
    springs : Springs               of this model
    rows : sequence of ProbeRows
    settings : FitSettings          method and range of Poisson's ratio

    Returns
    -------
    function                        shear modulus [Pa] -> list of ProbeResponse

    Raises
    ------
    SingularSystemError             the support does not hold the object
    NotConvergedError               the basis of the reduced model does not converge
    """
    system, each = model.system, compliances(model.session) / model.system.traction_length
    known_traction = _known_traction(model, springs)
    changes, blocks = springs.compliance_derivatives(each), 1 + len(each)
    if settings.method == FitMethod.NELDER_MEAD:

        def exact(shear_modulus: float) -> list[ProbeResponse]:
            compliance = springs.compliance(shear_modulus * each)
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
            centred.slope, factors, model.right, springs.compliance(shear_modulus * each), changes,
            known_traction=known_traction, poisson_range=settings.poisson_range,
        )  # fmt: skip
        return reduced_responses(reduced_model, rows, settings.poisson_range, blocks=blocks)

    return reduced


def _known_traction(model: ObjectModel, springs: Springs) -> Float[np.ndarray, "e c"] | None:
    """Known part of the traction on every spring, for each column of the model [N/m]."""
    if model.body is None:
        return None
    traction = np.zeros((len(springs.support_fraction), model.right.terms.shape[2]))
    # That of the body force is the first of its two columns.
    first = model.loads.weight_columns[0]
    traction[:, first] = weight_on_springs(model.system, springs, model.body)
    return traction


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
        own = std * np.stack(moved, axis=2)
        return np.stack([np.zeros_like(own), own], axis=1)

    parameters = (
        NuisanceParameter(f"compliance of support {k + 1}", std, "m/Pa", "compliance of supports")
        for k in supports
    )
    return Nuisance(tuple(parameters), effects)

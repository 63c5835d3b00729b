"""The fit of pokes without pictures: how far a tool goes in under its force, at many places."""

import time
from collections.abc import Callable
from dataclasses import asdict, replace

import numpy as np
from jaxtyping import Float
from numpy.polynomial.chebyshev import chebpts1, chebvander
from numpy.polynomial.polyutils import mapdomain

from palpate.errors import NotConvergedError
from palpate.estimation import (
    FitResult,
    FitSettings,
    Nuisance,
    Prediction,
    ProbeObservations,
    ResponseTerms,
    Settlement,
    best_constants_of,
    fit,
    predictions_of,
)
from palpate.field import PokeModel, PokeResponse, make_poke_model, tool_dent
from palpate.pipeline.heterogeneous import Material, fit_with_field, wants_field
from palpate.pipeline.model.shared_errors import force_gain, tool_compliance
from palpate.probe import local_surface, on_flat
from palpate.progress import Progress, part_of, silent
from palpate.records import Probing, Session

# Poisson's ratios at which the body's compliance is computed, less one: that of a layer on a rigid
# base is right to 1e-3 in between.
_DEGREE = 5
# Rounds for the modulus about which the growth of contacts is expanded, and its change that ends
# them: of second order in what it leaves.
_MOST_ROUNDS, _TOLERANCE = 8, 0.02
# Poisson's ratios about that of a fit at which a prediction takes the body's compliance.
_NEAR = 1e-3
# Fractions of the work that the elements, and the fit of one modulus, are done at.
_MODELLED, _FITTED = 0.2, 0.4

# Poisson's ratio -> compliance of the body at each poke.
_Regular = Callable[[float], Float[np.ndarray, " k"]]


def fit_pokes(
    session: Session,
    *,
    settings: FitSettings = FitSettings(),
    material: Material = Material.HOMOGENEOUS,
    progress: Progress = silent,
) -> FitResult:
    """Estimate the elastic constants of a poked object, or the field of its modulus.

    The body is resolved by finite elements, what is under the tool in closed form
    (`field.poke_responses`).

    Parameters
    ----------
    session : Session               `without_pictures`
    settings, material, progress    as `fit_session`

    Returns
    -------
    FitResult

    Raises
    ------
    InputError                      as `fit_session`
    MeshError                       the surface cannot be filled with elements
    NotConvergedError               the modulus does not settle
    """
    start = time.perf_counter()
    progress("finite elements", 0.0)
    session = _flattened(session)
    model = make_poke_model(session)
    report = part_of(progress, 0.0, _MODELLED)
    regular = _regular(model, settings.poisson_range, _DEGREE, report)
    modelled = time.perf_counter()
    observations = _settled_observations(session, regular, settings)
    report = part_of(progress, _MODELLED, _FITTED)
    result, field = fit(observations, settings=settings, progress=report), None
    if wants_field(material, session, observations, result):
        last = part_of(progress, _FITTED, 1.0)
        result, field = fit_with_field(session, observations, result, material, settings, last)
    progress("fit done", 1.0)
    seconds = {"assembly": modelled - start} | result.estimate.seconds
    chosen = {"material": material, "errors": asdict(session.errors)}
    estimate = replace(
        result.estimate,
        seconds=seconds | {"total": time.perf_counter() - start},
        settings=result.estimate.settings | chosen | {"elements": len(model.body.solid.elements)},
    )

    def predict(others: Session) -> tuple[Prediction, ...]:
        others, ratio = _flattened(others), result.minimum.poisson_ratio
        near = _regular(model.loaded(others), (ratio - _NEAR, ratio + _NEAR), 1)
        predicted = poke_observations(others, near, result.minimum.shear_modulus)
        if field is not None:
            predicted = field.with_field(others, predicted)
        return predictions_of(result.minimum, predicted)

    return replace(result, estimate=estimate, predict=predict)


def poke_observations(
    session: Session, regular: _Regular, shear_modulus: float
) -> list[ProbeObservations]:
    """Observations of pokes of a homogeneous body: of each the component of the tool's displacement
    along which it moved most.

    Parameters
    ----------
    session : Session               k probings
    regular : function              Poisson's ratio -> (k,) float [1/m]: `PokeModel.regular`
    shear_modulus : float [Pa]      about which the growth of contacts is expanded

    Returns
    -------
    list of k ProbeObservations
    """
    return [
        _observations(session, probing, lambda nu, k=k: float(regular(nu)[k]), shear_modulus)
        for k, probing in enumerate(session.probings)
    ]


def _observations(
    session: Session, probing: Probing, regular: Callable[[float], float], modulus: float
) -> ProbeObservations:
    force, priors = probing.force, session.errors
    size = float(np.linalg.norm(force))
    direction = force / size

    def whole(poisson_ratio: float) -> float:
        return regular(poisson_ratio) + tool_dent(probing, modulus, poisson_ratio).compliance

    def growing(poisson_ratio: float) -> float:
        own = tool_dent(probing, modulus, poisson_ratio)
        return own.growth * own.compliance

    along = int(np.abs(direction).argmax())
    measured = np.full(3, np.nan)
    tip, std = probing.tip_displacement, probing.tip_displacement_std
    assert tip is not None  # noqa: S101
    measured[along] = float(tip @ direction) * direction[along]
    nuisances = []
    if (gain := priors.gain_std(probing.force_sensor)) > 0.0:
        nuisances.append(_gain(gain, probing.force_sensor))
    if priors.tool_compliance > 0.0:
        nuisances.append(tool_compliance(priors.tool_compliance, force, 0))
    return ProbeObservations(
        name=probing.name,
        position=probing.contact.point[None],
        displacement=measured[None],
        std=None if std is None else np.abs(std * direction[along])[None],
        force=force,
        force_std=np.full(3, priors.force * size) if probing.force_std is None
        else probing.force_std,
        tip_displacement=None,
        tip_displacement_std=None,
        response=PokeResponse(direction, whole),
        settlement=Settlement(modulus, PokeResponse(direction, growing).value),
        landmarks={"the contact": probing.contact.point[None]},
        nuisances=tuple(nuisances),
    )  # fmt: skip


def _gain(std: float, sensor: str) -> Nuisance:
    """Gain of the force sensor: the dent grows with the force as with the compliance, which is the
    first of the response's two terms."""

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r 1 c 1"]:
        moved = np.zeros((len(at.rows), 1, at.value.shape[2], 1))
        moved[:, 0, :3, 0] = std * at.value[:, 0, :3]
        return moved

    return replace(force_gain(std, sensor), effects=effects)


def _flattened(session: Session) -> Session:
    """The session with the tools that dent a flat surface as its own dent the object's."""
    probings = []
    for probing in session.probings:
        contact, tool = probing.contact, probing.contact.tool
        assert tool is not None  # noqa: S101
        curvature = local_surface(session.mesh, contact.point, tool.radius).curvature
        contact = replace(contact, tool=on_flat(tool, curvature))
        probings.append(replace(probing, contact=contact))
    return replace(session, probings=tuple(probings))


def _regular(
    model: PokeModel, ends: tuple[float, float], degree: int, progress: Progress = silent
) -> _Regular:
    """Compliance of the body at each poke, as a polynomial in Poisson's ratio."""
    ratios = mapdomain(chebpts1(degree + 1), (-1.0, 1.0), ends)
    values = []
    for number, ratio in enumerate(ratios):
        progress("compliance of the body", number / len(ratios))
        values.append(model.regular(float(ratio)))
    table = np.stack(values)
    at_nodes = chebvander(chebpts1(degree + 1), degree)
    coefficients = np.linalg.solve(at_nodes, table)
    return lambda ratio: chebvander(mapdomain([ratio], ends, (-1.0, 1.0)), degree)[0] @ coefficients


def _settled_observations(
    session: Session, regular: _Regular, settings: FitSettings
) -> list[ProbeObservations]:
    """Observations about the modulus that fits best."""
    modulus = float(np.median([_apparent(probing) for probing in session.probings]))
    for _ in range(_MOST_ROUNDS):
        observations = poke_observations(session, regular, modulus)
        _, best = best_constants_of(observations, settings=settings)
        if abs(np.log(best / modulus)) < _TOLERANCE:
            return observations
        modulus = best
    raise NotConvergedError(
        f"the shear modulus did not settle (last {modulus:.3g} Pa): forces and depths of the pokes"
        " do not belong together; check the tool's radius and the units"
    )


def _apparent(probing: Probing) -> float:
    """Shear modulus of an incompressible half space that one poke would mean."""
    tip = probing.tip_displacement
    assert tip is not None  # noqa: S101
    force = float(np.linalg.norm(probing.force))
    depth = float(tip @ probing.force) / force
    own = tool_dent(probing, 1.0, 0.5)
    # The dent of a modulus G is that of 1 Pa times G^(q - 1).
    return float((max(depth, 1e-9) / (own.compliance * force)) ** (-1.0 / (1.0 - own.growth)))

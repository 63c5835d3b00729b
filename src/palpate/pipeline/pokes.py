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
    fit,
    joint_minimum,
    predictions_of,
)
from palpate.field import PokeModel, PokeResponse, dents, growths, make_poke_model, tools
from palpate.geometry import closest_points
from palpate.pipeline.heterogeneous import Material, fit_other_causes
from palpate.pipeline.model.shared_errors import force_gain, tool_compliance
from palpate.probe import local_surface, on_flat
from palpate.progress import Progress, part_of, silent
from palpate.records import DisplacementField, Session, Status
from palpate.shapes import Points

# Poisson's ratios at which the body's compliance is computed, less one: that of a layer on a rigid
# base is right to 1e-3 in between.
_DEGREE = 5
# Rounds for the modulus about which the growth of contacts is expanded, and its change that ends
# them: of second order in what it leaves.
_MOST_ROUNDS, _TOLERANCE = 8, 0.02
# Width of the range of Poisson's ratios, up to that of a fit, in which a prediction takes the
# body's compliance.
_NEAR = 2e-3
_TINY = 1e-9
# Fractions of the work that the elements, and the fit of one modulus, are done at.
_MODELLED, _FITTED = 0.2, 0.4
_BROKEN = (Status.MODEL_CONTRADICTED, Status.NOT_CONVERGED)
# Name of the probing that all pokes make up.
POKES = "pokes"

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
    stage_progress = part_of(progress, 0.0, _MODELLED)
    regular = _regular(model, settings.poisson_range, _DEGREE, stage_progress)
    modelled = time.perf_counter()
    observations = _settled_observations(session, regular, settings)
    stage_progress = part_of(progress, _MODELLED, _FITTED)
    result, field = fit(observations, settings=settings, progress=stage_progress), None
    if material is not Material.HOMOGENEOUS:
        last = part_of(progress, _FITTED, 1.0)
        result, field = fit_other_causes(material, session, observations, result, settings, last)
    progress("fit done", 1.0)
    seconds = {"assembly": modelled - start} | result.estimate.seconds
    chosen = {"material": material, "errors": asdict(session.errors)}
    estimate, status = result.estimate, result.estimate.status
    if field is not None and estimate.identifiable["young_modulus"] and status not in _BROKEN:
        # Poisson's ratio, which pokes hardly tell, is not what is asked.
        status = Status.HETEROGENEOUS
    estimate = replace(
        estimate,
        status=status,
        seconds=seconds | {"total": time.perf_counter() - start},
        settings=result.estimate.settings | chosen | {"elements": len(model.body.solid.elements)},
    )

    def predict(others: Session) -> tuple[Prediction, ...]:
        others, ratio = _flattened(others), result.minimum.poisson_ratio
        near = _regular(model.under(others), (ratio - _NEAR, ratio), 1)
        modulus = result.minimum.shear_modulus / (1.0 - ratio)
        predicted = poke_observations(others, near, modulus)
        if field is not None:
            predicted = field.with_field(others, predicted)
        return predictions_of(result.minimum, predicted)

    return replace(result, estimate=estimate, predict=predict)


def pooled(session: Session) -> Session:
    """A session of pokes with one probing in place of all, as their fit takes them: a point for
    each poke, displaced as the tool; contact and force are those of the first.

    Parameters
    ----------
    session : Session               `without_pictures`

    Returns
    -------
    Session
    """
    together = replace(
        session.probings[0], name=POKES, displacement=_field(session), tip_displacement=None,
        tip_displacement_std=None,
    )  # fmt: skip
    return replace(session, probings=(together,))


def _field(session: Session) -> DisplacementField:
    """How far the tool went in along its force, at each poke."""
    points = np.stack([probing.contact.point for probing in session.probings])
    force, tip = _forces(session), _tips(session)
    push = force / np.linalg.norm(force, axis=1, keepdims=True)
    return DisplacementField(
        points,
        push * (tip * push).sum(axis=1, keepdims=True),
        _std(session, push),
        None,
        closest_points(session.mesh, points),
        str(session.path),
    )


def poke_observations(
    session: Session, regular: _Regular, modulus: float
) -> list[ProbeObservations]:
    """Observations of pokes of a homogeneous body, as one probing with a point for each: of each
    the component of the tool's displacement along which it moved most.

    Parameters
    ----------
    session : Session               k probings
    regular : function              Poisson's ratio -> (k,) float [1/m]: `PokeModel.regular`
    modulus : float [Pa]            G / (1 - nu) about which the growth of contacts is expanded

    Returns
    -------
    list of one ProbeObservations
    """
    priors, growth, force = session.errors, growths(session), _forces(session)
    field = _field(session)
    size = np.abs(field.displacement)
    main = size == size.max(axis=1, keepdims=True)

    # A dent times G is that at M = `modulus`, plus G / (M (1 - nu)) - 1 times its growth: a
    # constant and G / M times the rest, as a `Settlement` at M has it.
    def growing(poisson_ratio: float) -> Float[np.ndarray, " k"]:
        return growth * dents(session, modulus, poisson_ratio) / (1.0 - poisson_ratio)

    def whole(poisson_ratio: float) -> Float[np.ndarray, " k"]:
        dented = dents(session, modulus, poisson_ratio)
        rest = regular(poisson_ratio) + (1.0 - growth) * dented
        return np.asarray(rest + growing(poisson_ratio))

    nuisances = []
    if priors.force_gain > 0.0:
        nuisances.append(_gain(priors.force_gain))
    if priors.tool_compliance > 0.0:
        nuisances.append(tool_compliance(priors.tool_compliance, force))
    return [
        ProbeObservations(
            name=POKES,
            position=field.points,
            displacement=np.where(main, field.displacement, np.nan),
            std=field.std,
            force=np.zeros(3),
            force_std=np.zeros(3),
            tip_displacement=None,
            tip_displacement_std=None,
            response=PokeResponse(force, whole),
            settlement=Settlement(modulus, PokeResponse(force, growing).value),
            nuisances=tuple(nuisances),
        )
    ]


def _forces(session: Session) -> Points:
    return np.stack([probing.force for probing in session.probings])


def _tips(session: Session) -> Points:
    tips = [probing.tip_displacement for probing in session.probings]
    return np.stack([tip for tip in tips if tip is not None])


def _std(session: Session, push: Points) -> Points | None:
    """Standard deviations of what is observed, including those of the forces, as if depths were
    proportional to forces; None if one is unknown."""
    stds = [probing.tip_displacement_std for probing in session.probings]
    known = [std for std in stds if std is not None]
    if len(known) < len(stds):
        return None
    relative = [
        session.errors.force
        if probing.force_std is None
        else float(np.linalg.norm(probing.force_std) / np.linalg.norm(probing.force))
        for probing in session.probings
    ]
    depth = np.linalg.norm(_tips(session), axis=1)
    along = np.hypot(np.linalg.norm(np.stack(known) * push, axis=1), relative * depth)
    # A component that did not move is not observed.
    return along[:, None] * np.maximum(np.abs(push), _TINY)


def _gain(std: float) -> Nuisance:
    """Gain of the force sensor: the dent grows with the force as with the compliance, which is the
    first of the response's two terms."""

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r 1 c 1"]:
        moved = np.zeros((len(at.rows), 1, at.value.shape[2], 1))
        moved[:, 0, 3, 0] = std * at.value[:, 0, 3]
        return moved

    return replace(force_gain(std), effects=effects)


def _flattened(session: Session) -> Session:
    """The session with tools that would dent a flat surface as its own tools dent the object."""
    probings = []
    for probing, tool in zip(session.probings, tools(session), strict=True):
        curvature = local_surface(session.mesh, probing.contact.point, tool.radius).curvature
        contact = replace(probing.contact, tool=on_flat(tool, curvature))
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
    # As of a half space, whose dent goes with the modulus to the power q - 1.
    depth, force = (
        np.linalg.norm(vectors, axis=1) for vectors in (_tips(session), _forces(session))
    )
    # For M = 1 Pa; times G over the force, which is half of M.
    softest = dents(session, 1.0, 0.5) * force / 0.5
    modulus = float(np.median((softest / depth) ** (1.0 / (1.0 - growths(session)))))
    for _ in range(_MOST_ROUNDS):
        observations = poke_observations(session, regular, modulus)
        minimum = joint_minimum(observations, settings)
        best = minimum.shear_modulus / (1.0 - minimum.poisson_ratio)
        if abs(np.log(best / modulus)) < _TOLERANCE:
            return observations
        modulus = best
    raise NotConvergedError(
        f"the modulus did not settle (last {modulus:.3g} Pa): forces and depths of the pokes"
        " do not belong together; check the tool's radius and the units"
    )

"""Whether a body is the same everywhere, and predictions of pushes that were not fitted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from palpate.checkpoints import Cache
from palpate.errors import InputError, MeshError, NotConvergedError, SingularSystemError
from palpate.estimation import (
    Evaluation,
    FitResult,
    FitSettings,
    Prediction,
    ProbeObservations,
    contradicted,
    fit,
    predictions_of,
)
from palpate.field import (
    DECISIVE,
    Cause,
    Explanation,
    RegionFit,
    UnevenBody,
    evidence_of_errors,
    explanations,
    fit_field,
    fit_inclusions,
    fit_regions,
    no_field_reason,
)
from palpate.machine import machine_memory
from palpate.pipeline.contacts import has_tools, with_contact_radii
from palpate.pipeline.model.grading import graded_session, refined_session
from palpate.pipeline.model.object_model import make_object_model
from palpate.pipeline.model.shared_errors import calibration_strains, with_stretch
from palpate.pipeline.observations import converged_observations
from palpate.progress import Progress, part_of
from palpate.records import (
    Estimate,
    FieldEstimate,
    ModulusMap,
    ProbeEstimate,
    Reciprocity,
    Session,
    Status,
)

# Fraction of the work that finding the field takes, and of that without a field where other causes
# are asked for.
_FOUND, _ASKED = 0.7, 0.15
# Memory for three components of a point and 300 modes, each held eleven times: in the response, its
# four columns twice over, and in the derivatives.
_BYTES_A_POINT = 8.0 * 3 * 300 * 11
# Of the machine's memory: the rest of the fit needs some, too.
_USABLE = 0.5
# Where pushes break the law of reciprocity, which every elastic body on every support obeys.
_NO_MATERIAL = (
    "No field of moduli was looked for, since pushes contradict each other whatever the material;"
    " --material field looks for one all the same."
)
# What causes mean to a reader.
_MEANING = {
    Cause.DIRECTION: (
        "Young's modulus is no single number, and the constants shown are means over directions."
    ),
    Cause.SUPPORT: (
        "look whether the object is held wherever the session says so, and give the stiffness of a"
        " support that is soft."
    ),
}


class Material(StrEnum):
    """What an object may be made of: one material; the regions that its session names; a field of
    moduli where the data are decisively likelier with one; or regions where there are any, and a
    field only where one material leaves something to be desired."""

    HOMOGENEOUS = "homogeneous"
    REGIONS = "regions"
    FIELD = "field"
    AUTO = "auto"


@dataclass(frozen=True, slots=True, eq=False)
class Predictor:
    """Predicts displacements of probings of the fitted object from their forces.

    Attributes
    ----------
    minimum : Evaluation
    field : UnevenBody or None      None: the object is the same everywhere
    settings : FitSettings
    """

    minimum: Evaluation
    field: UnevenBody | None
    settings: FitSettings

    def __call__(self, session: Session) -> tuple[Prediction, ...]:
        """Predictions at the measured points of every probing of a session.

        Parameters
        ----------
        session : Session           of the same object on the same supports

        Returns
        -------
        tuple of Prediction

        Raises
        ------
        InputError                  a probing without points, a bad contact
        """
        ratio, modulus = self.minimum.poisson_ratio, self.minimum.shear_modulus
        refined = refined_session(session)
        if has_tools(refined):
            refined = with_contact_radii(refined, shear_modulus=modulus, poisson_ratio=ratio)
        graded = graded_session(refined)
        observations = converged_observations(
            graded, make_object_model(graded), settings=self.settings
        )
        observations = with_stretch(observations, calibration_strains(session))
        if self.field is not None:
            observations = self.field.with_field(graded, observations)
        return predictions_of(self.minimum, observations)


@dataclass(frozen=True, slots=True, eq=False)
class FittedBody:
    """What a plan needs of a fit, which of many pushes is large.

    Attributes
    ----------
    estimate : Estimate
    field : UnevenBody or None      None: the body is the same everywhere
    errors : name -> float          values of the field's coefficients
    """

    estimate: Estimate
    field: UnevenBody | None
    errors: dict[str, float]


def fitted_body(fitted: FitResult) -> FittedBody:
    """The body of a fit.

    Parameters
    ----------
    fitted : FitResult
    """
    problem, predict = fitted.minimum.problem, fitted.predict
    values = fitted.minimum.theta[problem.layout.errors].tolist()
    errors = {
        each.name: value
        for each, value in zip(problem.shared, values, strict=True)
        if each.is_material
    }
    field = predict.field if isinstance(predict, Predictor) else None
    return FittedBody(fitted.estimate, field, errors)


def fit_material(
    material: Material,
    session: Session,
    observations: Sequence[ProbeObservations],
    settings: FitSettings,
    progress: Progress,
    cache: Cache | None = None,
    tested: Reciprocity | None = None,
) -> tuple[FitResult, UnevenBody | None]:
    """The fit with what the object may be made of.

    Parameters
    ----------
    material : Material
    session : Session                           k probings
    observations : sequence of k ProbeObservations      with the homogeneous body's response
    settings : FitSettings
    progress : callable
    cache : Cache or None                       as in `explanations`
    tested : Reciprocity or None                the test of the pushes against each other

    Returns
    -------
    FitResult
    UnevenBody or None              None: one modulus everywhere

    Raises
    ------
    InputError                      a field or regions that are not computed for such a session
    MeshError, NotConvergedError    as `fit_field`, `fit_regions`
    """
    if session.regions and material in (Material.REGIONS, Material.AUTO):
        return _fit_with_regions(session, observations, settings, progress)
    if material is Material.HOMOGENEOUS:
        return fit(observations, settings=settings, progress=progress), None
    result = fit(observations, settings=settings, progress=part_of(progress, 0.0, _ASKED))
    return fit_other_causes(
        material, session, observations, result, settings, progress, cache, tested
    )


def _fit_with_regions(
    session: Session,
    observations: Sequence[ProbeObservations],
    settings: FitSettings,
    progress: Progress,
) -> tuple[FitResult, RegionFit]:
    """The fit with a modulus for every region of the session."""
    stage_progress = part_of(progress, 0.0, _FOUND)
    regions = fit_regions(session, observations, settings=settings, progress=stage_progress)
    result = fit(regions.observations, settings=settings, progress=part_of(progress, _FOUND, 1.0))
    estimate, estimates = result.estimate, regions.estimates(result.minimum)
    if estimate.status is Status.MODEL_CONTRADICTED:
        estimates = tuple(region.without_interval for region in estimates)
    notes = tuple(region.note for region in estimates if region.note)
    estimate = replace(estimate, regions=estimates, notes=(*estimate.notes, *notes))
    return replace(result, estimate=estimate, map=regions.map(result.minimum)), regions


def fit_other_causes(
    material: Material,
    session: Session,
    observations: Sequence[ProbeObservations],
    plain: FitResult,
    settings: FitSettings,
    progress: Progress,
    cache: Cache | None = None,
    tested: Reciprocity | None = None,
) -> tuple[FitResult, UnevenBody | None]:
    """The fit with a field of moduli, or with another cause where that is decisively likelier;
    `plain` where one modulus will do, or no material at all.

    Parameters
    ----------
    material : Material             field or auto
    session : Session                           k probings
    observations : sequence of k ProbeObservations      with the homogeneous body's response
    plain : FitResult                           of these
    settings : FitSettings
    progress : callable
    cache : Cache or None                       as in `explanations`
    tested : Reciprocity or None                the test of the pushes against each other

    Raises
    ------
    InputError                      a field is asked for and not computed for such a session
    MeshError, NotConvergedError    as `fit_field`
    """
    reason = _no_field_reason(session, observations)
    if material is Material.FIELD:
        if reason:
            raise InputError(f"{session.path}: {reason} Fit with --material homogeneous")
        return _fit_with_field(session, observations, plain, material, settings, progress)
    if reason:
        return plain, None
    if tested is not None and tested.is_unexplained:
        return _noted(plain, _NO_MATERIAL), None
    progress("evidence of other causes", _ASKED)
    try:
        likeliest, *others = explanations(session, observations, plain.minimum, cache=cache)
    except (MeshError, SingularSystemError):
        return plain, None
    field = max(
        explanation.log_evidence
        for explanation in (likeliest, *others)
        if explanation.cause is Cause.PLACE
    )
    errors = evidence_of_errors(plain.minimum)
    if errors - likeliest.log_evidence > DECISIVE:
        return plain, None
    if likeliest.log_evidence - max(field, errors) > DECISIVE:
        return _fit_with_cause(likeliest, field, session, observations, plain, settings, progress)
    if field > DECISIVE or plain.estimate.status is Status.MODEL_CONTRADICTED:
        return _fit_with_field(session, observations, plain, material, settings, progress)
    return plain, None


def _fit_with_cause(
    cause: Explanation,
    field: float,
    session: Session,
    observations: Sequence[ProbeObservations],
    plain: FitResult,
    settings: FitSettings,
    progress: Progress,
) -> tuple[FitResult, Explanation]:
    """The fit with a cause to first order: what it predicts is better, but no interval is that of a
    constant."""
    if cause.cause is Cause.SUPPORT:
        cause = cause.with_parts_let_go(plain.minimum, settings)
    with_cause = cause.with_field(session, observations)
    result = fit(with_cause, settings=settings, progress=part_of(progress, _FOUND, 1.0))
    note = (
        f"The displacements ask for {cause.cause} (log evidence {cause.log_evidence:.0f} over one"
        f" modulus; {field:.0f} for {Cause.PLACE}): {_MEANING[cause.cause]}"
    )
    estimate = replace(contradicted(result.estimate), notes=(note, *result.estimate.notes))
    return replace(result, estimate=estimate), cause


def _no_field_reason(session: Session, observations: Sequence[ProbeObservations]) -> str:
    """Why no field is computed, as full sentences; empty where one is."""
    if reason := no_field_reason(session):
        return reason
    points = sum(len(probe.position) for probe in observations)
    needed, usable = _BYTES_A_POINT * points, _USABLE * machine_memory()
    if needed <= usable:
        return ""
    return (
        f"A field of moduli takes {needed / 1e9:.1f} GB of memory for {points} measured points;"
        f" {usable / 1e9:.1f} GB can be used here. Measure fewer points, or fewer pushes (--probe)."
    )


def _fit_with_field(
    session: Session,
    observations: Sequence[ProbeObservations],
    plain: FitResult,
    material: Material,
    settings: FitSettings,
    progress: Progress,
) -> tuple[FitResult, UnevenBody | None]:
    """The fit with a field of moduli, where the data are decisively likelier with one.

    Parameters
    ----------
    session : Session                           k probings
    observations : sequence of k ProbeObservations      with the homogeneous body's response
    plain : FitResult                           of these
    material : Material                         auto: `plain`, with a note, where none can be found
    settings : FitSettings
    progress : callable

    Returns
    -------
    FitResult                                   `plain` where one modulus will do
    UnevenBody or None              None: one modulus will do

    Raises
    ------
    InputError, MeshError, NotConvergedError    as `fit_field`
    """
    stage_progress = part_of(progress, 0.0, _FOUND)
    try:
        field = fit_field(session, observations, settings=settings, progress=stage_progress)
    except (MeshError, NotConvergedError, SingularSystemError) as error:
        if material is Material.FIELD:
            raise
        return _noted(plain, f"No field of moduli was found: {error}."), None
    if field.log_evidence < DECISIVE:
        return plain, None
    last = part_of(progress, _FOUND, 1.0)
    result = fit(field.observations, settings=settings, progress=last)
    posterior = field.posterior(result.minimum)
    round_parts = fit_inclusions(field, posterior, observations, settings)
    if round_parts is None or round_parts.log_evidence - field.log_evidence < DECISIVE:
        described, mapped = field.estimate(posterior), posterior.map()
        return _heterogeneous(result, plain, described, mapped), field
    result = fit(round_parts.observations, settings=settings, progress=last)
    described, mapped = round_parts.described(result.minimum)
    return _heterogeneous(result, plain, described, mapped), round_parts


def _heterogeneous(
    result: FitResult, plain: FitResult, described: FieldEstimate, mapped: ModulusMap
) -> FitResult:
    """A fit that describes moduli that differ from place to place, compared with the plain fit."""
    estimate = result.estimate
    status = Status.HETEROGENEOUS if estimate.status is Status.OK else estimate.status
    probes = tuple(
        replace(probe, homogeneous_error=alone.prediction_error)
        for probe, alone in zip(estimate.probes, plain.estimate.probes, strict=True)
    )
    verdict, *parts = described.sentences
    verdict += _gain(probes)
    sentences = [verdict, *(["; ".join(parts)] if parts else [])]
    notes = tuple(f"{sentence[0].upper()}{sentence[1:]}." for sentence in sentences)
    estimate = replace(
        estimate, status=status, field=described, probes=probes, notes=(*notes, *estimate.notes)
    )
    return replace(result, estimate=estimate, map=mapped)


def _noted(result: FitResult, note: str) -> FitResult:
    notes = (*result.estimate.notes, note)
    return replace(result, estimate=replace(result.estimate, notes=notes))


def _gain(probes: Sequence[ProbeEstimate]) -> str:
    """How much better pushes are predicted from the others with a field, as the end of a sentence;
    empty for a single push."""
    pairs = [
        (probe.prediction_error, probe.homogeneous_error)
        for probe in probes
        if probe.prediction_error and probe.homogeneous_error
    ]
    if not pairs:
        return ""
    share = float(np.median([with_field / with_one for with_field, with_one in pairs]))
    return (
        f"; predicted from the others, a push is off by {100.0 * share:.2g} % as much as with one"
        " modulus, noise included"
    )

"""Whether a body is the same everywhere, and predictions of pushes that were not fitted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from palpate.errors import InputError, MeshError, NotConvergedError, SingularSystemError
from palpate.estimation import (
    Evaluation,
    FitResult,
    FitSettings,
    Prediction,
    ProbeObservations,
    fit,
    predictions_of,
)
from palpate.field import (
    DECISIVE,
    FieldFit,
    RegionFit,
    field_evidence,
    fit_field,
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
from palpate.records import Session, Status

# Fraction of the work that finding the field takes.
_FOUND = 0.7
# Memory for three components of a point and 300 modes, each held eleven times: in the response, its
# four columns twice over, and in the derivatives.
_BYTES_A_POINT = 8.0 * 3 * 300 * 11
# Of the machine's memory: the rest of the fit needs some, too.
_USABLE = 0.5


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
    field : FieldFit, RegionFit or None     None: the object is the same everywhere
    settings : FitSettings
    """

    minimum: Evaluation
    field: FieldFit | RegionFit | None
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


def fit_material(
    material: Material,
    session: Session,
    observations: Sequence[ProbeObservations],
    settings: FitSettings,
    progress: Progress,
) -> tuple[FitResult, FieldFit | RegionFit | None]:
    """The fit with what the object may be made of.

    Parameters
    ----------
    material : Material
    session : Session                           k probings
    observations : sequence of k ProbeObservations      with the homogeneous body's response
    settings : FitSettings
    progress : callable

    Returns
    -------
    FitResult
    FieldFit, RegionFit or None                 None: one modulus everywhere

    Raises
    ------
    InputError                      regions are asked for, and there are none; a field or regions
                                    that are not computed for such a session
    MeshError, NotConvergedError    as `fit_field`, `fit_regions`
    """
    if material is Material.REGIONS and not session.regions:
        raise InputError(
            f"{session.path}: has no [[region]] table, but --material regions asks for them: say"
            " which parts have a modulus of their own"
        )
    if session.regions and material in (Material.REGIONS, Material.AUTO):
        return _fit_with_regions(session, observations, settings, progress)
    result = fit(observations, settings=settings, progress=progress)
    if not wants_field(material, session, observations, result):
        return result, None
    return fit_with_field(session, observations, result, material, settings, progress)


def _fit_with_regions(
    session: Session,
    observations: Sequence[ProbeObservations],
    settings: FitSettings,
    progress: Progress,
) -> tuple[FitResult, RegionFit]:
    """The fit with a modulus for every region of the session."""
    report = part_of(progress, 0.0, _FOUND)
    regions = fit_regions(session, observations, settings=settings, progress=report)
    result = fit(regions.observations, settings=settings, progress=part_of(progress, _FOUND, 1.0))
    estimate, estimates = result.estimate, regions.estimates(result.minimum)
    if estimate.status is Status.MODEL_CONTRADICTED:
        estimates = tuple(each.without_interval for each in estimates)
    notes = tuple(each.note for each in estimates if each.note)
    estimate = replace(estimate, regions=estimates, notes=(*estimate.notes, *notes))
    return replace(result, estimate=estimate, map=regions.map(result.minimum)), regions


def wants_field(
    material: Material,
    session: Session,
    observations: Sequence[ProbeObservations],
    result: FitResult,
) -> bool:
    """Whether to fit a field: where it is asked for, or where one may be computed and one modulus
    is contradicted, or less likely to first order.

    Parameters
    ----------
    material : Material
    session : Session                           k probings
    observations : sequence of k ProbeObservations      with the homogeneous body's response
    result : FitResult                          of these

    Raises
    ------
    InputError                      a field is asked for and not computed for such a session
    """
    reason = _no_field_reason(session, observations)
    if material is Material.FIELD and reason:
        raise InputError(f"{reason} Fit with --material homogeneous")
    if material is not Material.AUTO or reason:
        return material is Material.FIELD
    if result.estimate.status is Status.MODEL_CONTRADICTED:
        return True
    try:
        return field_evidence(session, observations, result.minimum) > DECISIVE
    except (MeshError, SingularSystemError):
        return False


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


def fit_with_field(
    session: Session,
    observations: Sequence[ProbeObservations],
    plain: FitResult,
    material: Material,
    settings: FitSettings,
    progress: Progress,
) -> tuple[FitResult, FieldFit | None]:
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
    FieldFit or None                            None: one modulus will do

    Raises
    ------
    InputError, MeshError, NotConvergedError    as `fit_field`
    """
    report = part_of(progress, 0.0, _FOUND)
    try:
        field = fit_field(session, observations, settings=settings, progress=report)
    except (MeshError, NotConvergedError, SingularSystemError) as error:
        if material is Material.FIELD:
            raise
        note = f"No field of moduli was found: {error}."
        notes = (*plain.estimate.notes, note)
        return replace(plain, estimate=replace(plain.estimate, notes=notes)), None
    if field.log_evidence < DECISIVE:
        return plain, None
    result = fit(field.observations, settings=settings, progress=part_of(progress, _FOUND, 1.0))
    posterior = field.posterior(result.minimum)
    described = field.estimate(posterior)
    estimate = result.estimate
    status = Status.HETEROGENEOUS if estimate.status is Status.OK else estimate.status
    verdict, *parts = described.sentences
    sentences = [verdict, *(["; ".join(parts)] if parts else [])]
    notes = tuple(f"{each[0].upper()}{each[1:]}." for each in sentences)
    estimate = replace(estimate, status=status, field=described, notes=(*notes, *estimate.notes))
    return replace(result, estimate=estimate, map=posterior.map()), field

"""From a session to its elastic constants: the only place that joins probe, boundary elements and
estimation."""

import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.estimation import FitResult, FitSettings, ProbeFit, ProbeObservations, fit
from palpate.pipeline.calibrated_space import calibration_strains, length_error, with_stretch
from palpate.pipeline.model.contacts.contact_radii import has_tools
from palpate.pipeline.model.grading import graded_session, refined_session
from palpate.pipeline.model.large_strain import fit_at_finite_strain
from palpate.pipeline.model.object_model import ObjectModel, make_object_model
from palpate.pipeline.notes import session_notes
from palpate.pipeline.observations.consistent_contacts import with_consistent_contacts
from palpate.pipeline.observations.converged_observations import converged_observations
from palpate.pipeline.observations.mesh_errors import ungraded_observations, with_mesh_steps
from palpate.pipeline.reciprocity import reciprocity
from palpate.progress import Progress, part_of, silent
from palpate.records import ProbeEstimate, Session, SupportEstimate, require_probings

# Fractions of the work that are done when the graded mesh's model, its factorisation and the
# estimation start.
_GRADED, _ASSEMBLED, _FIT_STARTS = 0.4, 0.65, 0.9
# Fraction of the work on the given mesh that its own model takes.
_OWN = 0.4
# Further notes are details.
_MOST_NOTES = 3


def fit_session(
    session: Session,
    *,
    settings: FitSettings = FitSettings(),
    cache: Path | None = None,
    finite_strain: bool = False,
    progress: Progress = silent,
) -> FitResult:
    """Estimate the elastic constants of a session's object.

    Parameters
    ----------
    session : Session                 every probing with a displacement
    settings : FitSettings            method, noise model and range of Poisson's ratio
    cache : Path or None              folder in which what is computed of the body is kept for reuse
    finite_strain : bool              True: correct for finite strain
    progress : callable               called with the current step (text) and the fraction done

    Returns
    -------
    FitResult                         its estimate with the seconds of every stage, and all settings

    Raises
    ------
    InputError                        a probing without displacements, a bad contact
    SingularSystemError               the support does not hold the object
    NotConvergedError                 contact radii, compliant supports or finite-strain corrections
                                      did not converge
    """
    start = time.perf_counter()
    require_probings(session)
    strains = calibration_strains(session)
    progress("the given mesh", 0.0)
    refined = refined_session(session)
    # First, so that its memory is free again before the graded model is made.
    report = part_of(progress, 0.0, _GRADED, prefix="the given mesh: ")
    # The correction for finite strain presses a ball where it touched first, and lets it slide.
    refined, ungraded = _on_ungraded_mesh(refined, settings, cache, not finite_strain, report)
    compared = time.perf_counter()
    progress("integrals over the surface", _GRADED)
    graded = graded_session(refined)
    integrals = part_of(progress, _GRADED, _ASSEMBLED)
    model = make_object_model(graded, cache=cache, progress=integrals)
    assembled = time.perf_counter()
    progress("factorisation", _ASSEMBLED)
    observations = converged_observations(
        graded, model, settings=settings, coarser=ungraded, with_surface=True
    )
    observations = with_stretch(observations, strains)
    factorised = time.perf_counter()
    last = part_of(progress, _FIT_STARTS, 1.0)
    result = fit(observations, settings=settings, progress=last)
    if finite_strain:
        result = fit_at_finite_strain(refined, observations, result, settings, last)
    stages = {"given_mesh": compared - start, "assembly": assembled - compared}
    stages |= {"factorisation": factorised - assembled, **result.estimate.seconds}
    progress("fit done", 1.0)
    probes = _probe_estimates(model, result)
    tested = reciprocity(session) if len(session.probings) > 1 else None
    notes = session_notes(
        session, refined, graded, result, probes, tested, finite_strain=finite_strain
    )
    estimate = replace(
        result.estimate,
        probes=probes,
        notes=notes[:_MOST_NOTES],
        details=notes[_MOST_NOTES:],
        reciprocity=tested,
        seconds=stages | {"total": time.perf_counter() - start},
        settings={
            **result.estimate.settings,
            "surface": "smooth" if session.smooth else "flat",
            "finite_strain": finite_strain,
            "lengths": length_error(session, strains),
            **_described(session, refined, graded),
        },
    )
    return replace(result, estimate=estimate, probes=_on_given_mesh(result.probes, session))


def _described(session: Session, refined: Session, graded: Session) -> dict[str, Any]:
    """Prior errors and assumed forces of a session, and the sizes of its meshes."""
    return {
        "errors": asdict(session.errors),
        "vertices": [len(each.mesh.vertices) for each in (session, refined, graded)],
        "assumed_forces": [
            probing.name for probing in session.probings if probing.force_std is None
        ],
    }


def _on_given_mesh(probes: Sequence[ProbeFit], session: Session) -> tuple[ProbeFit, ...]:
    """Surfaces restricted to the vertices of the given mesh, which come first in the graded one."""
    count = len(session.mesh.vertices)
    return tuple(
        probe if probe.surface is None else replace(probe, surface=probe.surface[:count])
        for probe in probes
    )


def _on_ungraded_mesh(
    session: Session,
    settings: FitSettings,
    cache: Path | None,
    displaced: bool,
    progress: Progress,
) -> tuple[Session, list[ProbeObservations]]:
    """A session with the contacts of its tools, `displaced` with the object or where they touched
    first, and its observations with the model of the mesh before grading."""
    report = part_of(progress, 0.0, _OWN)
    if has_tools(session):
        session, observations = with_consistent_contacts(
            session,
            settings=settings,
            cache=cache,
            displaced=displaced,
            progress=report,
        )
    else:
        # The model is not kept, so that its memory is free before the next model is made.
        observations = ungraded_observations(
            session, settings=settings, cache=cache, progress=report
        )[1]
    return session, with_mesh_steps(
        session, observations, settings=settings, cache=cache,
        progress=part_of(progress, _OWN, 1.0),
    )  # fmt: skip


def _probe_estimates(model: ObjectModel, result: FitResult) -> tuple[ProbeEstimate, ...]:
    """The result's probe estimates, with the motions of their supports."""
    return tuple(
        replace(probe, supports=_support_estimates(model, k, result.probes[k]))
        for k, probe in enumerate(result.estimate.probes)
    )


def _support_estimates(
    model: ObjectModel, index: int, fitted: ProbeFit
) -> tuple[SupportEstimate, ...]:
    """Motions of the supports in a probing; NaN for translations of a support that is pulled."""
    pulled = model.pulled_translations(index)
    rest = [j for j in range(6 * len(model.supports)) if j not in pulled]
    value, std = np.full((2, 6 * len(model.supports)), np.nan)
    value[rest], std[rest] = fitted.motion[: len(rest)], fitted.motion_std[: len(rest)]
    estimates = []
    for support, moved, error in zip(
        model.supports, value.reshape(-1, 2, 3), std.reshape(-1, 2, 3), strict=True
    ):
        parts = (tuple(part.tolist()) for part in (moved[0], error[0], moved[1], error[1]))
        estimates.append(SupportEstimate(support.number, *parts))
    return tuple(estimates)

"""From a session to its elastic constants: the only place that joins probe, boundary elements and
estimation."""

import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.bem import SurfaceSettings
from palpate.errors import NotConvergedError
from palpate.estimation import (
    FitResult,
    FitSettings,
    ProbeFit,
    ProbeObservations,
    best_constants_of,
    fit,
    predicted_surface,
)
from palpate.pipeline.calibrated_space import calibration_strains, length_error, with_stretch
from palpate.pipeline.model import (
    OUTWARD_ERROR,
    RADIUS_ERROR,
    ObjectModel,
    displaced_contacts,
    fit_at_finite_strain,
    graded_session,
    has_tools,
    largest_change,
    make_object_model,
    resolved_session,
    with_contact_radii,
)
from palpate.pipeline.observations import (
    converged_observations,
    ungraded_observations,
    with_mesh_steps,
)
from palpate.pipeline.rejections import rejection_note, rejections
from palpate.progress import Progress, part_of, silent
from palpate.records import (
    BIASED,
    SLIDES,
    STICKS,
    ProbeEstimate,
    Session,
    Status,
    SupportEstimate,
    require_probings,
)
from palpate.shapes import Vertices

# Fractions of the work that are done when the graded mesh's model, its factorisation and the
# estimation start.
_GRADED, _ASSEMBLED, _FIT_STARTS = 0.4, 0.65, 0.9
# Fraction of the work on the given mesh that its own model takes.
_OWN = 0.4
# Contact radii vary only with the cube root of the modulus, so they converge with the constants.
# The relative tolerance is a tenth of the prior standard deviation of such a radius.
_MOST_CONTACT_ROUNDS, _CONTACT_TOLERANCE = 8, 0.005
# Slopes of the fitted modulus over the one that radii were computed for, beyond which a secant step
# is no longer trusted.
_SECANT_SLOPES = (-1.0, 0.8)
# At one half the formulae of the contact have a removable singularity.
_LARGEST_RATIO = 0.4999
# A rotation [rad] above this, which causes a spurious strain of 1e-5, is mentioned.
_LARGE_ROTATION = 5e-3
# Further notes are details.
_MOST_NOTES = 3
# Depth over the radius of a contact, of which half is about the strain under it, from which the
# error of a model of small strain is no longer small; what the tool deforms reaches so many radii.
_FAR, _REACH = 0.1, 3.0
# A contact that ends up this many radii beside the point that was touched first is mentioned.
_MENTIONED = 0.05


def fit_session(
    session: Session,
    *,
    settings: FitSettings = FitSettings(),
    surface: SurfaceSettings = SurfaceSettings(),
    cache: Path | None = None,
    finite_strain: bool = False,
    progress: Progress = silent,
) -> FitResult:
    """Estimate the elastic constants of a session's object.

    Parameters
    ----------
    session : Session                 every probing with a displacement
    settings : FitSettings            method, noise model and range of Poisson's ratio
    surface : SurfaceSettings         interpolation of the surface between the vertices
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
    resolved = resolved_session(session, surface=surface)
    # First, so that its memory is free again before the graded model is made.
    report = part_of(progress, 0.0, _GRADED, prefix="the given mesh: ")
    # The correction for finite strain presses a ball where it touched first, and lets it slide.
    resolved, ungraded = _on_ungraded_mesh(
        resolved, settings, surface, cache, not finite_strain, report
    )
    compared = time.perf_counter()
    progress("integrals over the surface", _GRADED)
    graded = graded_session(resolved, surface=surface)
    integrals = part_of(progress, _GRADED, _ASSEMBLED)
    model = make_object_model(graded, surface=surface, cache=cache, progress=integrals)
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
        result = fit_at_finite_strain(resolved, observations, result, settings, last)
    stages = {"given_mesh": compared - start, "assembly": assembled - compared}
    stages |= {"factorisation": factorised - assembled, **result.estimate.seconds}
    progress("fit done", 1.0)
    probes = _probe_estimates(model, result)
    notes = _notes(session, resolved, result.estimate.notes, probes, finite_strain)
    if not finite_strain:
        notes = _with_strain(notes, graded, result)
    estimate = replace(
        result.estimate,
        probes=probes,
        notes=notes[:_MOST_NOTES],
        details=notes[_MOST_NOTES:],
        seconds=stages | {"total": time.perf_counter() - start},
        settings={
            **result.estimate.settings,
            "surface": asdict(surface),
            "finite_strain": finite_strain,
            "lengths": length_error(session, strains),
            **_described(session, resolved, graded),
        },
    )
    return replace(result, estimate=estimate, probes=_on_given_mesh(result.probes, session))


def _notes(
    session: Session,
    resolved: Session,
    fitted: Sequence[str],
    probes: Sequence[ProbeEstimate],
    finite_strain: bool,
) -> tuple[str, ...]:
    """Notes on the fit, its support motions and contacts, the pictures and the session, the most
    important first."""
    # A warning of bias does not apply where finite strain is corrected for.
    biased = [note for note in session.notes if BIASED in note and not finite_strain]
    others = [note for note in session.notes if BIASED not in note]
    found = _contact_notes(resolved, probes) + _rejection_notes(session)
    return (*fitted[:1], *biased, *_rotation_notes(probes), *fitted[1:], *found, *others)


def _described(session: Session, resolved: Session, graded: Session) -> dict[str, Any]:
    """Prior errors and assumed forces of a session, and the sizes of its meshes."""
    return {
        "errors": asdict(session.errors),
        "vertices": [len(each.mesh.vertices) for each in (session, resolved, graded)],
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
    surface: SurfaceSettings,
    cache: Path | None,
    displaced: bool,
    progress: Progress,
) -> tuple[Session, list[ProbeObservations]]:
    """A session with the contacts of its tools, `displaced` with the object or where they touched
    first, and its observations with the model of the mesh before grading."""
    report = part_of(progress, 0.0, _OWN)
    if has_tools(session):
        session, observations = _with_consistent_contacts(
            session, settings, surface, cache, displaced, report
        )
    else:
        # The model is not kept, so that its memory is free before the next model is made.
        observations = ungraded_observations(
            session, settings=settings, surface=surface, cache=cache, progress=report
        )[1]
    return session, with_mesh_steps(
        session, observations, settings=settings, surface=surface, cache=cache,
        progress=part_of(progress, _OWN, 1.0),
    )  # fmt: skip


def _with_consistent_contacts(
    session: Session,
    settings: FitSettings,
    surface: SurfaceSettings,
    cache: Path | None,
    displaced: bool,
    progress: Progress,
) -> tuple[Session, list[ProbeObservations]]:
    """A session with contacts of its tools that are consistent with the constants fitted to it, and
    its observations with the model of the mesh before grading."""
    model, fitted, taken = None, list[float](), list[float]()
    for iteration in range(_MOST_CONTACT_ROUNDS):
        # The number of iterations is not known: each takes half of the remaining progress.
        model, observations = ungraded_observations(
            session, settings=settings, surface=surface, cache=cache, like=model,
            with_surface=displaced,
            progress=part_of(progress, 1.0 - 0.5**iteration, 1.0 - 0.5 ** (iteration + 1)),
        )  # fmt: skip
        ratio, modulus = best_constants_of(observations, settings=settings)
        fitted.append(float(np.log(modulus)))
        taken.append(_consistent_modulus(taken, fitted))
        constants = {
            "shear_modulus": float(np.exp(taken[-1])),
            "poisson_ratio": min(ratio, _LARGEST_RATIO),
        }
        updated = session
        if displaced:
            moved = [_displacement_of_vertices(probe, ratio, modulus) for probe in observations]
            updated = displaced_contacts(session, model.system.surface, moved, **constants)
        updated = with_contact_radii(updated, **constants)
        change = largest_change(session, updated)
        # Responses of all vertices are large, and not needed any more.
        observations = [replace(probe, vertices=None) for probe in observations]
        if change < _CONTACT_TOLERANCE:
            return session, observations
        previous, session = session, updated
    # What Poisson's ratio that hardly counts leaves of a change is within the error of the radii.
    if change < previous.errors.touched_radius:
        return previous, observations
    raise NotConvergedError(
        f"what the tools touch still changes after {_MOST_CONTACT_ROUNDS} fits: the"
        " force and the displacements do not belong together; check tool_radius and the unit of"
        " the force"
    )


def _displacement_of_vertices(probe: ProbeObservations, ratio: float, modulus: float) -> Vertices:
    """Displacement of all vertices under the measured force, (v, 3) [m]."""
    load = np.concatenate([np.append(probe.force, 1.0) / modulus, probe.motion])
    moved = predicted_surface(probe, ratio, load)
    return np.zeros((0, 3)) if moved is None else moved


def _consistent_modulus(taken: Sequence[float], fitted: Sequence[float]) -> float:
    """Logarithm of the modulus for which radii are to be computed next: the last one fitted, from
    the third on a step of the secant method.

    Parameters
    ----------
    taken : sequence of n float         those that radii have been computed for
    fitted : sequence of n + 1 float    fitted with the initial radii, then with each of these
    """
    if len(taken) < 2 or taken[-1] == taken[-2]:
        return fitted[-1]
    slope = (fitted[-1] - fitted[-2]) / (taken[-1] - taken[-2])
    return taken[-1] + (fitted[-1] - taken[-1]) / (1.0 - float(np.clip(slope, *_SECANT_SLOPES)))


def _rotation_notes(probes: Sequence[ProbeEstimate]) -> list[str]:
    """Notes on rotations of supports that are not small."""
    notes = []
    for probe in probes:
        for support in probe.supports:
            rotation = float(np.linalg.norm(support.rotation))
            if rotation > _LARGE_ROTATION:
                notes.append(
                    f"Support {support.support} turned by {rotation:.2g} rad in probing"
                    f" {probe.name!r}. Displacements are taken as linear in the turn, which leaves"
                    f" a false strain of {0.5 * rotation**2:.1g} across its axis: where that"
                    " counts, turn the measured displacements back first."
                )
    return notes


def _with_strain(notes: tuple[str, ...], session: Session, result: FitResult) -> tuple[str, ...]:
    """Notes with one on strain that is not small: first, or after what contradicts the model."""
    contradicted = result.estimate.status is Status.MODEL_CONTRADICTED
    first = int(contradicted)
    return (
        *notes[:first], *_pressed_far(session, result.probes, contradicted), *notes[first:]
    )  # fmt: skip


def _pressed_far(session: Session, probes: Sequence[ProbeFit], contradicted: bool) -> list[str]:
    """A note on the probing that strains the object most under its contact, where that is much: of
    a patch of fixed size, or, where the model is contradicted, of any. What a ball touches grows
    with the load and takes most of the second order with it."""
    depths = {}
    for probing, probe in zip(session.probings, probes, strict=True):
        contact, size = probing.contact, float(np.linalg.norm(probing.force))
        fixed = contact.tool is None and contact.radius is not None
        if probe.surface is None or size == 0.0 or not (fixed or contradicted):
            continue
        distance = np.linalg.norm(session.mesh.vertices - contact.point, axis=1)
        near = probe.surface[distance < _REACH * contact.reach] @ probing.force / size
        depths[probing.name] = float(np.ptp(near)) / contact.reach if near.size else 0.0
    deepest = max(depths, key=lambda name: depths[name], default="")
    if depths.get(deepest, 0.0) < _FAR:
        return []
    note = (
        f"In {deepest} the tool went in by {100 * depths[deepest]:.0f} % of the radius of its"
        f" contact, far for a model of small strain: fit with --strain finite, or press less."
    )
    return [note]


def _contact_notes(session: Session, probes: Sequence[ProbeEstimate]) -> list[str]:
    """Notes on the contacts computed for the tools: radii, places, doubts about the friction."""
    radii, places, doubted = [], [], dict[str, list[str]]()
    for probing, probe in zip(session.probings, probes, strict=True):
        contact, tool = probing.contact, probing.contact.tool
        if tool is None or contact.radius is None:
            continue
        radii.append(f"{1e3 * contact.radius:.3g} mm in {probing.name}")
        beside = float(np.linalg.norm(contact.point - contact.start))
        if beside > _MENTIONED * contact.radius:
            places.append(f"{1e3 * beside:.2g} mm in {probing.name}")
        own = [each for each in probe.errors if each.name.startswith((RADIUS_ERROR, OUTWARD_ERROR))]
        if any(error.is_surprising for error in own):
            doubted.setdefault(tool.friction, []).append(probing.name)
    notes = [f"Radius that the tool touches: {', '.join(radii)}."] if radii else []
    if places:
        notes.append(
            "The object moves sideways under the tool, which ends up pressing beside the point that"
            f" it touched first: {', '.join(places)}."
        )
    for friction, names in doubted.items():
        other = SLIDES if friction == STICKS else STICKS
        notes.append(
            f"What the tool touches in {', '.join(names)} is far from what follows from its shape"
            f' and friction = "{friction}": if the tool is right, try friction = "{other}".'
        )
    return notes


def _rejection_notes(session: Session) -> list[str]:
    """A note on points that could not be tracked in the pictures."""
    counts = rejections(session)
    return [rejection_note(counts)] if any(each.lost for each in counts) else []


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

"""From a session to its elastic constants: the only place that joins probe, boundary elements and
estimation.

The steps of a fit, and the notes for its reader: what the estimate says of itself, and what its
session, tools, supports and pictures add to it, the most important first.
"""

import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.bem import DENSE_RESIDUAL
from palpate.checkpoints import Cache
from palpate.errors import InputError
from palpate.estimation import FitMethod, FitResult, FitSettings, ProbeFit, ProbeObservations, fit
from palpate.pipeline.contacts import has_tools, with_consistent_contacts
from palpate.pipeline.creep import with_relaxation
from palpate.pipeline.heterogeneous import (
    Material,
    Predictor,
    fit_material,
)
from palpate.pipeline.load_dependence import is_shown, load_dependence
from palpate.pipeline.model.contact_loads import OUTWARD_ERROR, RADIUS_ERROR
from palpate.pipeline.model.finite_body import require_finite_strain
from palpate.pipeline.model.grading import graded_session, refined_session
from palpate.pipeline.model.large_strain import fit_at_finite_strain
from palpate.pipeline.model.object_model import ObjectModel, make_object_model
from palpate.pipeline.model.shared_errors import calibration_strains, length_error, with_stretch
from palpate.pipeline.model.supports import MovingSupport
from palpate.pipeline.motion.figures import rejection_note, rejections
from palpate.pipeline.observations import (
    UNGRADED_RESIDUAL,
    compared_meshes,
    converged_observations,
    reduced_model_of,
    ungraded_model,
    ungraded_observations,
    with_mesh_steps,
)
from palpate.pipeline.once import made_once
from palpate.pipeline.pokes import fit_pokes
from palpate.pipeline.reciprocity import reciprocity
from palpate.progress import Progress, part_of, silent
from palpate.records import (
    BIASED,
    FRICTIONS,
    Estimate,
    ProbeEstimate,
    Reciprocity,
    Session,
    Status,
    SupportEstimate,
    load_text,
    require_probings,
    without_pictures,
)
from palpate.threads import serial_algebra

# Fractions of the work that are done when the estimation starts, which takes seconds, or minutes of
# finite strain or of factorising anew; and of the work before it, when the graded mesh's model and
# its factorisation start.
_FIT_STARTS, _LONG_FIT_STARTS = 0.75, 0.03
_GRADED, _ASSEMBLED = 0.45, 0.72
# Fraction of the work on the given mesh that its own model takes.
_OWN = 0.4
# Further notes are details.
_MOST_NOTES = 3
# A rotation [rad] above this, which causes a spurious strain of 1e-5, is mentioned.
_LARGE_ROTATION = 5e-3
# Depth over the radius of a contact, of which half is about the strain under it, from which the
# error of a model of small strain is no longer small; what the tool deforms reaches so many radii.
_FAR, _REACH = 0.1, 3.0
# The supports that move, and which of their translations a probing pulls.
_Moving = tuple[Sequence[MovingSupport], tuple[int, ...]]
# A contact that ends up this many radii beside the point that was touched first is mentioned.
_MENTIONED = 0.05


@serial_algebra()
def fit_session(
    session: Session,
    *,
    settings: FitSettings = FitSettings(),
    cache: Cache | None = None,
    finite_strain: bool = False,
    material: Material = Material.HOMOGENEOUS,
    progress: Progress = silent,
) -> FitResult:
    """Estimate the elastic constants of a session's object.

    Parameters
    ----------
    session : Session                 every probing with a displacement
    settings : FitSettings            method, noise model and range of Poisson's ratio
    cache : Cache or None             folder in which what is computed of the body is kept for reuse
    finite_strain : bool              True: correct for finite strain
    material : Material               not homogeneous: look for a field of moduli as well
    progress : callable               called with the current step (text) and the fraction done

    Returns
    -------
    FitResult                         its estimate with the seconds of every stage, and all settings

    Raises
    ------
    InputError                        a probing without displacements, a bad contact; a field of
                                      moduli that is asked for and not computed for such a session
    SingularSystemError               the support does not hold the object
    NotConvergedError                 contact radii, compliant supports or finite-strain corrections
                                      did not converge
    """
    require_probings(session)
    if without_pictures(session):
        if finite_strain:
            raise InputError("pokes without pictures take --strain small: press less far")
        result = fit_pokes(session, settings=settings, material=material, progress=progress)
        return with_relaxation(session, result)
    if material is Material.REGIONS and not session.regions:
        raise InputError(
            f"{session.path}: has no [[region]] table, but --material regions asks for them: say"
            " which parts have a modulus of their own"
        )
    with_regions = session.regions and material in (Material.REGIONS, Material.AUTO)
    if finite_strain and (with_regions or material is Material.FIELD):
        raise InputError(
            f"{session.path}: regions and fields with moduli of their own take --strain small; or"
            " leave them out with --material homogeneous"
        )
    if finite_strain:
        require_finite_strain(session)
    return _fit_displacements(session, settings, cache, finite_strain, material, progress)


def _fit_displacements(
    session: Session,
    settings: FitSettings,
    cache: Cache | None,
    finite_strain: bool,
    material: Material,
    progress: Progress,
) -> FitResult:
    """As `fit_session`, of a session with measured displacements."""
    start = time.perf_counter()
    strains = calibration_strains(session)
    chosen = {"finite_strain": finite_strain, "material": material}
    chosen |= {"lengths": length_error(session, strains)}
    before, last = _parts(progress, settings, finite_strain=finite_strain)
    before("the given mesh", 0.0)
    refined = refined_session(session, cache=cache)
    # First, so that its memory is free again before the graded model is made.
    first_part = part_of(before, 0.0, _GRADED, prefix="the given mesh: ")
    # The correction for finite strain presses a ball where it touched first, and lets it slide.
    refined, ungraded = _on_ungraded_mesh(refined, settings, cache, not finite_strain, first_part)
    compared = time.perf_counter()
    before("integrals over the surface", _GRADED)
    graded = graded_session(refined, cache=cache)
    moving, observations, assembled = _on_graded_mesh(graded, ungraded, settings, cache, before)
    observations = with_stretch(observations, strains)
    factorised = time.perf_counter()
    tested = reciprocity(session) if len(session.probings) > 1 and not finite_strain else None
    if finite_strain:
        linear, field = fit(observations, settings=settings), None
        result = fit_at_finite_strain(refined, observations, linear, settings, last)
    else:
        result, field = fit_material(material, graded, observations, settings, last, cache, tested)
    stages = {"given_mesh": compared - start, "assembly": assembled - compared}
    stages |= {"factorisation": factorised - assembled} | result.estimate.seconds
    progress("fit done", 1.0)
    result, probes = _with_load(graded, result), _probe_estimates(moving, result)
    notes = _session_notes(
        session, refined, graded, result, probes, tested, finite_strain=finite_strain
    )
    estimate = replace(
        result.estimate,
        probes=probes,
        notes=notes[:_MOST_NOTES],
        details=(*notes[_MOST_NOTES:], *_agreement(tested)),
        reciprocity=tested,
        seconds=stages | {"total": time.perf_counter() - start},
        settings=result.estimate.settings | chosen | _described(session, refined, graded),
    )
    return replace(
        with_relaxation(refined, replace(result, estimate=estimate)),
        probes=_on_given_mesh(result.probes, session),
        predict=Predictor(result.minimum, field, settings),
    )  # fmt: skip


@serial_algebra()
def prepare_body(
    session: Session,
    *,
    settings: FitSettings = FitSettings(),
    cache: Path,
) -> None:
    """Compute what `fit_session` needs of a body, and keep it in the cache where it finds it.

    These are the reduced models of all contacts, with the factors that other contacts on the same
    body need as well. Where a contact follows from a tool and the fitted constants, only the
    factors are computed. Nothing is kept of a body that is too large for dense matrices.

    Parameters
    ----------
    session : Session                     displacements are not needed
    settings : FitSettings                with the method reduced
    cache : Path                          folder, created if absent

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `session_observations`
    """
    refined = refined_session(session)
    with_loads = not has_tools(session)
    compared = [(body, rings) for _, body, rings in compared_meshes(refined)]
    for body, rings in [(refined, 1), *compared]:
        model = ungraded_model(body, settings=settings, rings=rings, cache=cache)
        _keep(model, settings, UNGRADED_RESIDUAL, with_loads=with_loads)
    if with_loads:
        graded = graded_session(refined)
        model = make_object_model(graded, cache=cache)
        _keep(model, settings, DENSE_RESIDUAL, with_loads=True)


def _parts(
    progress: Progress, settings: FitSettings, *, finite_strain: bool
) -> tuple[Progress, Progress]:
    """Progress of the work before the estimation, and of the estimation."""
    is_long = finite_strain or settings.method == FitMethod.NELDER_MEAD
    starts = _LONG_FIT_STARTS if is_long else _FIT_STARTS
    return part_of(progress, 0.0, starts), part_of(progress, starts, 1.0)


def _described(session: Session, refined: Session, graded: Session) -> dict[str, Any]:
    """Prior errors and assumed forces of a session, and the sizes of its meshes."""
    return {
        "surface": "smooth" if session.smooth else "flat",
        "errors": asdict(session.errors),
        "vertices": [len(meshed.mesh.vertices) for meshed in (session, refined, graded)],
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
    cache: Cache | None,
    displaced: bool,
    progress: Progress,
) -> tuple[Session, list[ProbeObservations]]:
    """A session with the contacts of its tools, `displaced` with the object or where they touched
    first, and its observations with the model of the mesh before grading, where contacts that are
    within a tolerance of these will do."""
    first_part = part_of(progress, 0.0, _OWN)
    if has_tools(session):
        session, observations, settled = with_consistent_contacts(
            session,
            settings=settings,
            cache=cache,
            displaced=displaced,
            progress=first_part,
        )
    else:
        # The model is not kept, so that its memory is free before the next model is made.
        observations = ungraded_observations(
            session, settings=settings, cache=cache, progress=first_part
        )[1]
        settled = session
    return settled, with_mesh_steps(
        session, observations, settings=settings, cache=cache,
        progress=part_of(progress, _OWN, 1.0),
    )  # fmt: skip


def _on_graded_mesh(
    session: Session,
    coarser: Sequence[ProbeObservations],
    settings: FitSettings,
    cache: Cache | None,
    progress: Progress,
) -> tuple[list[_Moving], list[ProbeObservations], float]:
    """What moves in each probing, the observations with the model of the graded mesh, and when its
    integrals were done. The model itself is let go: the observations have taken up what it knows of
    loads, which of many pushes is large."""
    integrals = part_of(progress, _GRADED, _ASSEMBLED)
    coarser_of = {probe.name: probe for probe in coarser}
    assembled = time.perf_counter()

    def make(new: Session) -> list[tuple[_Moving, ProbeObservations]]:
        nonlocal assembled
        model = make_object_model(new, cache=cache, progress=integrals)
        assembled = time.perf_counter()
        progress("factorisation", _ASSEMBLED)
        observations = converged_observations(
            new,
            model,
            settings=settings,
            coarser=[coarser_of[probing.name] for probing in new.probings],
            with_surface=True,
        )
        pulled = map(model.pulled_translations, range(len(new.probings)))
        moving = [(model.supports, translations) for translations in pulled]
        return list(zip(moving, observations, strict=True))

    made = made_once(session, ("graded", settings), make, cache)
    return [moving for moving, _ in made], [probe for _, probe in made], assembled


def _probe_estimates(moving: Sequence[_Moving], result: FitResult) -> tuple[ProbeEstimate, ...]:
    """The result's probe estimates, with the motions of their supports."""
    return tuple(
        replace(probe, supports=_support_estimates(*each, fitted))
        for probe, each, fitted in zip(result.estimate.probes, moving, result.probes, strict=True)
    )


def _support_estimates(
    moving: Sequence[MovingSupport], pulled: tuple[int, ...], fitted: ProbeFit
) -> tuple[SupportEstimate, ...]:
    """Motions of the supports in a probing; NaN for translations of a support that is pulled."""
    rest = [j for j in range(6 * len(moving)) if j not in pulled]
    value, std = np.full((2, 6 * len(moving)), np.nan)
    value[rest], std[rest] = fitted.motion[: len(rest)], fitted.motion_std[: len(rest)]
    estimates = []
    for support, moved, error in zip(
        moving, value.reshape(-1, 2, 3), std.reshape(-1, 2, 3), strict=True
    ):
        parts = (tuple(part.tolist()) for part in (moved[0], error[0], moved[1], error[1]))
        estimates.append(SupportEstimate(support.number, *parts))
    return tuple(estimates)


def _session_notes(
    session: Session,
    refined: Session,
    graded: Session,
    result: FitResult,
    probes: Sequence[ProbeEstimate],
    tested: Reciprocity | None,
    *,
    finite_strain: bool,
) -> tuple[str, ...]:
    """Notes on a fit.

    Parameters
    ----------
    session : Session               as it was read
    refined : Session              with the contacts that were fitted
    graded : Session                with the mesh that was fitted
    result : FitResult              with the notes of the estimate
    probes : sequence of ProbeEstimate    with the motions of their supports
    tested : Reciprocity or None    the test of the pushes against each other
    finite_strain : bool            whether it was corrected for

    Returns
    -------
    tuple of str                    full sentences, the most important first
    """
    fitted = result.estimate.notes
    contradicted = result.estimate.status is Status.MODEL_CONTRADICTED
    # Neither strain nor a bias is to be warned of where finite strain is corrected for.
    strained = _strain_notes(graded, result.probes, contradicted=contradicted)
    biased = [note for note in session.notes if BIASED in note]
    if finite_strain:
        strained = biased = []
    others = [note for note in session.notes if BIASED not in note]
    notes = _contact_notes(refined, probes) + _rejection_notes(session)
    strained = [*_load_notes(result.estimate, finite_strain=finite_strain), *strained]
    first = (*fitted[:1], *strained) if contradicted else (*strained, *fitted[:1])
    # Pushes that contradict each other leave the model nothing to explain.
    broken = [tested.text] if tested is not None and not tested.holds else []
    rotated = _rotation_notes(probes)
    return (*broken, *first, *biased, *rotated, *fitted[1:], *notes, *others)


def _agreement(tested: Reciprocity | None) -> list[str]:
    """A sentence that pushes agree, for the detailed notes."""
    return [tested.text] if tested is not None and tested.holds and tested.is_tested else []


def _with_load(session: Session, result: FitResult) -> FitResult:
    """A result with how its modulus changes with the load, where the pushes show it."""
    load = load_dependence(session, result.minimum)
    if not is_shown(load):
        return result
    return replace(result, estimate=replace(result.estimate, load=load))


def _load_notes(estimate: Estimate, *, finite_strain: bool) -> list[str]:
    """A note on a modulus that changes with the load."""
    load = estimate.load
    if load is None:
        return []
    cause = "stiffens" if load.exponent.value > 0.0 else "softens, or a tool slips,"
    fit = "" if finite_strain else ", or fit the stiffening (--strain finite)"
    note = (
        f"{load_text(estimate)} The object or its shape {cause} under load, and the constants are a"
        f" mean over these loads: for small ones fit the gentle pushes alone (--probe){fit}."
    )
    return [note]


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


def _strain_notes(session: Session, probes: Sequence[ProbeFit], *, contradicted: bool) -> list[str]:
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
        contact_errors = [
            error for error in probe.errors if error.name.startswith((RADIUS_ERROR, OUTWARD_ERROR))
        ]
        if any(error.is_surprising for error in contact_errors):
            doubted.setdefault(tool.friction_name, []).append(probing.name)
    notes = [f"Radius that the tool touches: {', '.join(radii)}."] if radii else []
    if places:
        notes.append(
            "The object moves sideways under the tool, which ends up pressing beside the point that"
            f" it touched first: {', '.join(places)}."
        )
    for friction, names in doubted.items():
        other = next(name for name in FRICTIONS if name != friction)
        notes.append(
            f"What the tool touches in {', '.join(names)} is far from what follows from its shape"
            f' and friction = "{friction}": if the tool is right, try friction = "{other}".'
        )
    return notes


def _rejection_notes(session: Session) -> list[str]:
    """A note on points that could not be tracked in the pictures."""
    counts = rejections(session)
    return [rejection_note(counts)] if any(count.lost for count in counts) else []


def _keep(model: ObjectModel, settings: FitSettings, residual: float, *, with_loads: bool) -> None:
    """Compute a model's factors, and its reduced model with its loads, for the cache."""
    # On springs, a reduced model depends on the shear modulus.
    if with_loads and model.springs is None:
        reduced_model_of(model, settings=settings, residual=residual)
    else:
        model.solver.prepare()

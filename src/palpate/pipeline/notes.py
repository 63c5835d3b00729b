"""Notes for the reader of a fit: what the estimate says of itself, and what its session, tools,
supports and pictures add to it, the most important first."""

from collections.abc import Sequence

import numpy as np

from palpate.estimation import FitResult, ProbeFit
from palpate.pipeline.model.contacts.outward import OUTWARD_ERROR
from palpate.pipeline.model.contacts.perturbations import RADIUS_ERROR
from palpate.pipeline.rejections import rejection_note, rejections
from palpate.records import (
    BIASED,
    SLIDES,
    STICKS,
    ProbeEstimate,
    Reciprocity,
    Session,
    Status,
)

# A rotation [rad] above this, which causes a spurious strain of 1e-5, is mentioned.
_LARGE_ROTATION = 5e-3
# Depth over the radius of a contact, of which half is about the strain under it, from which the
# error of a model of small strain is no longer small; what the tool deforms reaches so many radii.
_FAR, _REACH = 0.1, 3.0
# A contact that ends up this many radii beside the point that was touched first is mentioned.
_MENTIONED = 0.05


def session_notes(
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
    found = _contact_notes(refined, probes) + _rejection_notes(session)
    first = (*fitted[:1], *strained) if contradicted else (*strained, *fitted[:1])
    # Pushes that contradict each other leave the model nothing to explain; else it is a detail.
    broken = [tested.text] if tested is not None and not tested.holds else []
    sound = [tested.text] if tested is not None and tested.holds and tested.is_tested else []
    return (
        *broken,
        *first,
        *biased,
        *_rotation_notes(probes),
        *fitted[1:],
        *found,
        *others,
        *sound,
    )


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

"""Notes for the reader of an estimate, as full sentences, the most important first."""

from collections.abc import Mapping, Sequence

import numpy as np

from palpate.estimation.checks import Contradiction, FreedForce
from palpate.estimation.observed_rows import FIRST_CLAIMED, GROUP_NAMES
from palpate.estimation.posterior import Posterior, valley_text
from palpate.records import SURPRISING, ErrorEstimate, error_texts, length_unit

# The most frequent causes, by the landmark near which the model fails.
_SUSPECTS = {
    "the contact": (
        "the contact's point, radius or profile, the direction of the force, or a mesh too coarse"
        " there"
    ),
    "the support": "a support that slips, gives, or reaches farther or less far than stated",
}
_OTHER_SUSPECTS = (
    "points that are misplaced on the mesh, or material that is not the same everywhere and in all"
    " directions; or the support"
)
# So few points leave the noise level and the shared errors undetermined.
_FEW_POINTS = 4


def fit_notes(
    posterior: Posterior,
    determined: Mapping[str, bool],
    contradictions: Sequence[Contradiction],
    freed: Sequence[FreedForce],
    errors: Sequence[ErrorEstimate],
) -> tuple[str, ...]:
    """Notes on contradictions of the model, forces set free, implausible errors, constants that are
    not determined, few points and noise levels.

    Parameters
    ----------
    posterior : Posterior           of all probings
    determined : constant's name -> bool
    contradictions : sequence of Contradiction
    freed : sequence of FreedForce
    errors : sequence of ErrorEstimate      of the session and of all its probings

    Returns
    -------
    tuple of str                    empty if there is nothing to note
    """
    notes = []
    if contradictions:
        notes.append(_contradiction_note(contradictions[0]))
    if freed:
        names = ", ".join(f"{each.name!r} by {each.deviation:.1f}" for each in freed)
        notes.append(
            "A force that disagrees with all others was left out, in standard deviations of the"
            f" difference: {names}; check that sensor reading and its unit."
        )
    surprising = sorted(filter(lambda each: each.is_surprising, errors), key=_sigmas, reverse=True)
    if surprising:
        notes.append(_error_note(surprising))
    if posterior.is_beyond_range():
        notes.append(
            "The data lead beyond the range of Poisson's ratio, whose end,"
            f" {posterior.minimum.poisson_ratio:g}, is therefore no measurement: give a wider"
            " poisson_range if the material may be there, else look for what contradicts the model."
        )
    if not determined["poisson_ratio"]:
        notes.append(
            f"What the data determine is {valley_text(posterior)}; the moduli's intervals are for"
            " all of the range of Poisson's ratio."
        )
    return (*notes, *_count_notes(posterior), *_noise_notes(posterior))


def _contradiction_note(found: Contradiction) -> str:
    if found.kind == "reversed":
        return (
            f"Along {found.source} the residuals are {found.sigmas:.1f} times what moved there: the"
            " model contradicts it. Check the signs and the order of the components of force and"
            " displacement, the rows of the file, and whether the object moved with its support."
        )
    if found.kind == "errors":
        return (
            f"The {found.source} would have to be off by {found.sigmas:.1f} times what the session"
            f" allows: either that is wrong or the model is ({_OTHER_SUSPECTS})."
        )
    near = f"near {found.landmark}, " if found.landmark else ""
    place = ", ".join(f"{1e3 * x:.1f}" for x in found.place)
    return (
        f"The model leaves {100.0 * found.share:.2g} % of the motion of probing {found.source!r}"
        f" unexplained, {found.sigmas:.1f} times as much as its mesh accounts for, most of it"
        f" {near}around ({place}) mm. It may be"
        f" {_SUSPECTS.get(found.landmark, _OTHER_SUSPECTS)}."
    )


def _sigmas(error: ErrorEstimate) -> float:
    return abs(error.value) / error.prior_std


def _error_note(errors: Sequence[ErrorEstimate]) -> str:
    """The largest of some surprising errors."""
    value, std, prior = error_texts(errors[0])
    others = f" {len(errors) - 1} more are listed in the report." if len(errors) > 1 else ""
    return (
        f"Likely fault: the {errors[0].name} is off by {value} +- {std}, more than"
        f" {SURPRISING:.0f} times the {prior} assumed (prior, 1 sigma).{others}"
    )


def _count_notes(posterior: Posterior) -> list[str]:
    """A note where so few points were measured that this alone explains wide intervals."""
    count = sum(len(probe.start) for probe in posterior.minimum.problem.probes)
    if count > _FEW_POINTS:
        return []
    points = "One point was" if count == 1 else f"{count} points were"
    note = (
        f"{points} measured in all: that few cannot tell noise from stiffness, whatever their"
        " quality, and the intervals are wide for that reason; measure ten or more, on all sides"
        " of the contact."
    )
    return [note]


def _noise_notes(posterior: Posterior) -> list[str]:
    problem = posterior.minimum.problem
    present = np.unique(np.concatenate([probe.group for probe in problem.probes]))
    level, notes = problem.level, []
    estimated = [int(g) for g in present if g < FIRST_CLAIMED]
    if estimated:
        parts = [f"{_length_text(level[g])} in {GROUP_NAMES[g]}" for g in estimated]
        notes.append(f"Noise levels were estimated from the residuals: {', '.join(parts)}.")
        own = np.sqrt(np.mean(np.concatenate([each.size for each in problem.unknown]) ** 2))
        if max(level[g] for g in estimated) < own:
            notes[-1] = (
                "The displacements have no noise to speak of: what is left over is no more than the"
                f" model's own error, {_length_text(own)}."
            )
    raised = [int(g) for g in present if g >= FIRST_CLAIMED and level[g] > 1.1]
    if raised:
        parts = [f"{level[g]:.2f} in {GROUP_NAMES[g - FIRST_CLAIMED]}" for g in raised]
        notes.append(
            "Residuals exceed the given standard deviations, which were multiplied by"
            f" {', '.join(parts)}."
        )
    return notes


def _length_text(metres: float) -> str:
    factor, unit = length_unit(float(metres))
    return f"{metres / factor:.2g} {unit}"

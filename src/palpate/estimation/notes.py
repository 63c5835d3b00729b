"""Notes for the reader of an estimate, as full sentences."""

from collections.abc import Mapping, Sequence

import numpy as np

from palpate.estimation.intervals import Contradiction, Uncertainty, identifiable_combination
from palpate.estimation.observed_rows import FIRST_CLAIMED
from palpate.estimation.search import LocalProbe, Misfit
from palpate.records import IMPOSSIBLE, SURPRISING, ErrorEstimate, error_texts, length_unit

_GROUP_NAMES = ("x", "y", "z", "the tip")
# The most frequent causes, by the landmark near which the model fails.
_SUSPECTS = {
    "the contact": (
        "the contact's point, radius or profile, the direction of the force, or a mesh too coarse"
        " there"
    ),
    "the support": "a support that slips, gives, or reaches farther or less far than was said",
}
_OTHER_SUSPECTS = (
    "points that are misplaced on the mesh, or material that is not the same everywhere and in all"
    " directions; or the support"
)
_WORDS = {
    "poisson_ratio": "Poisson's ratio",
    "shear_modulus": "the shear modulus",
    "young_modulus": "Young's modulus",
}
# A variance inflated by more than this factor (correlation, disagreeing probings) is mentioned.
_MENTIONED_FACTOR = 2.0
# So few points leave the noise level and the shared errors undetermined.
_FEW_POINTS = 4
# A component counts as reversed only if its RMS residual exceeds this factor times its own RMS
# displacement and this fraction of that of all components, in at least so many rows.
_REVERSED_FACTOR, _LEAST_FRACTION_OF_ALL, _LEAST_ROWS = 1.3, 0.1, 8
# A force whose robust weight is smaller is mentioned.
_MIN_FORCE_WEIGHT = 0.5
# A force that is impossible is an outlier where so many others agree for each such force: two
# constants are fitted, so that two probings agree on wrong ones, too.
_AGREEING_PER_OUTLIER = 3


def fit_notes(
    misfit: Misfit,
    uncertainty: Uncertainty,
    identifiable: Mapping[str, bool],
    contradictions: Sequence[Contradiction],
    errors: Sequence[ErrorEstimate],
) -> tuple[str, ...]:
    """Notes on noise, correlation, disagreeing probings, downweighted forces, implausible errors,
    constants that are not identifiable, and contradictions of the model.

    Parameters
    ----------
    misfit : Misfit
    uncertainty : Uncertainty       of all probings
    identifiable : constant's name -> bool
    contradictions : sequence of Contradiction
    errors : sequence of ErrorEstimate      of the session and of all its probings

    Returns
    -------
    tuple of str                    empty if there is nothing to note
    """
    notes = [*_count_notes(misfit), *_noise_notes(misfit), *_interval_notes(uncertainty)]
    for probe in uncertainty.minimum.probes:
        if probe.force_weight < _MIN_FORCE_WEIGHT:
            notes.append(
                f"The force of probing {probe.rows.name!r} disagrees with the others by"
                f" {_force_deviation(probe):.1f}"
                " of its standard deviations and was given little weight; check the sensor's scale."
            )
    notes += [_error_note(error) for error in errors if error.is_surprising]
    notes += map(_contradiction_note, contradictions)
    if uncertainty.is_beyond_range():
        notes.append(
            "The data lead beyond the range of Poisson's ratio, whose end,"
            f" {uncertainty.minimum.poisson_ratio:g}, is therefore no measurement: give a wider"
            " poisson_range if the material may be there, else look for what contradicts the model."
        )
    if not identifiable["poisson_ratio"]:
        notes.append(
            f"What the data determine is {identifiable_combination(uncertainty.weights)}; the"
            " moduli's intervals are for all of the range of Poisson's ratio."
        )
    return tuple(notes)


def _count_notes(misfit: Misfit) -> list[str]:
    """A note where so few points were measured that this alone explains wide intervals."""
    count = sum(len(probe.start) for probe in misfit.probes)
    if count > _FEW_POINTS:
        return []
    points = "One point was" if count == 1 else f"{count} points were"
    note = (
        f"{points} measured in all: that few cannot tell noise from stiffness, whatever their"
        " quality, and the intervals are wide for that reason; measure ten or more, on all sides"
        " of the contact."
    )
    return [note]


def _noise_notes(misfit: Misfit) -> list[str]:
    present = np.unique(np.concatenate([probe.group for probe in misfit.probes]))
    notes = []
    estimated = [int(g) for g in present if g < FIRST_CLAIMED]
    if estimated:
        parts = [f"{_length_text(misfit.level[g])} in {_GROUP_NAMES[g]}" for g in estimated]
        notes.append(f"Noise levels were estimated from the residuals: {', '.join(parts)}.")
    raised = [int(g) for g in present if g >= FIRST_CLAIMED and misfit.level[g] > 1]
    if raised:
        parts = [f"{misfit.level[g]:.2f} in {_GROUP_NAMES[g - FIRST_CLAIMED]}" for g in raised]
        notes.append(
            "Residuals exceed the given standard deviations, which were multiplied by"
            f" {', '.join(parts)}."
        )
    return notes


def reversed_notes(misfit: Misfit, uncertainty: Uncertainty) -> list[str]:
    """Notes on components whose residuals exceed the measured displacement: the prediction has the
    opposite sign.

    Noise is part of the measurement, so under a correct model residuals cannot exceed it. The test
    needs only a few points and no claimed noise level.

    Parameters
    ----------
    misfit : Misfit
    uncertainty : Uncertainty       of all probings

    Returns
    -------
    list of str                     empty where no component is contradicted
    """
    probes = uncertainty.minimum.probes
    group = np.concatenate([probe.rows.group for probe in probes]) % FIRST_CLAIMED
    measured = np.concatenate([probe.rows.measured for probe in probes])
    residuals = np.concatenate(
        [probe.residual * probe.rows.sigma(misfit.level) for probe in probes]
    )
    notes = []
    for g in np.unique(group):
        chosen = group == g
        residual, motion = (float(np.sqrt((x[chosen] ** 2).mean())) for x in (residuals, measured))
        is_large = residual > _LEAST_FRACTION_OF_ALL * float(np.sqrt((measured**2).mean()))
        if is_large and chosen.sum() >= _LEAST_ROWS and residual > _REVERSED_FACTOR * motion:
            notes.append(
                f"Along {_GROUP_NAMES[g]} the residuals, {_length_text(residual)}, exceed what"
                f" moved there, {_length_text(motion)}: the model contradicts it. Check the"
                " signs and the order of the components of force and displacement, the rows of the"
                " file, and whether the object moved with its support."
            )
    return notes


def conflicting_force_notes(uncertainty: Uncertainty) -> list[str]:
    """A note where forces disagree beyond five standard deviations and too few others agree for
    them to be outliers.

    Parameters
    ----------
    uncertainty : Uncertainty       of all probings

    Returns
    -------
    list of str                     empty where each such force is outvoted by three others
    """
    off = {probe.rows.name: _force_deviation(probe) for probe in uncertainty.minimum.probes}
    outliers = [name for name, size in off.items() if size > IMPOSSIBLE]
    agreeing = len(off) - len(outliers)
    if agreeing >= _AGREEING_PER_OUTLIER * len(outliers):
        return []
    listed = ", ".join(f"{name!r} by {off[name]:.1f}" for name in outliers)
    note = (
        "The forces of some probings contradict the others, in their standard deviations:"
        f" {listed}. No more than {agreeing} agree, too few to tell which are right"
        f" ({_AGREEING_PER_OUTLIER} for each that does not). Either these forces are wrong or the"
        f" model is: {_OTHER_SUSPECTS}."
    )
    return [note]


def _force_deviation(probe: LocalProbe) -> float:
    """Distance of the estimated force from the measured one, in its standard deviations."""
    return float(np.linalg.norm(probe.shift[:3]))


def _length_text(metres: float) -> str:
    factor, unit = length_unit(float(metres))
    return f"{metres / factor:.2g} {unit}"


def _interval_notes(uncertainty: Uncertainty) -> list[str]:
    notes = []
    if uncertainty.noise.excess > _MENTIONED_FACTOR:
        widened = np.sqrt(uncertainty.noise.excess)
        notes.append(
            "Residuals of neighbouring points are correlated; what the displacements contribute to"
            f" the intervals was widened by {widened:.1f}."
        )
    for name, scatter in uncertainty.scatters.items():
        if scatter.factor > _MENTIONED_FACTOR:
            notes.append(
                f"The probings disagree about {_WORDS[name]} by {np.sqrt(scatter.ratio):.1f} times"
                " what their uncertainties explain; its interval was widened accordingly."
            )
    return notes


def _error_note(error: ErrorEstimate) -> str:
    value, std, prior = error_texts(error)
    return (
        f"Likely fault: the {error.name} is off by {value} +- {std}, more than"
        f" {SURPRISING:.0f} times the {prior} assumed (prior, 1 sigma)."
    )


def _contradiction_note(found: Contradiction) -> str:
    near = f"near {found.landmark}, " if found.landmark else ""
    place = ", ".join(f"{1e3 * x:.1f}" for x in found.place)
    return (
        f"The model contradicts probing {found.name!r}: {100.0 * found.share:.2g} % of the motion"
        f" is left over and not noise, most of it {near}around ({place}) mm. It may be"
        f" {_SUSPECTS.get(found.landmark, _OTHER_SUSPECTS)}."
    )

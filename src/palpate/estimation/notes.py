"""What the reader of an estimate must be told, in full sentences."""

from collections.abc import Mapping

import numpy as np

from palpate.estimation.intervals import FixedWeights, Scatter, ScoreNoise, told_combination
from palpate.estimation.noise import Misfit, ScoredMinimum
from palpate.estimation.observations import CLAIMED_GROUPS, GROUP_COUNT

_GROUP_NAMES = ("x", "y", "z", "the tip")
_WORDS = {
    "poisson_ratio": "Poisson's ratio",
    "shear_modulus": "the shear modulus",
    "young_modulus": "Young's modulus",
}
_DOUBTED_FORCE = 0.5


def fit_notes(
    misfit: Misfit,
    minimum: ScoredMinimum,
    noise: ScoreNoise,
    scatters: Mapping[str, Scatter],
    identifiable: Mapping[str, bool],
    weights: FixedWeights,
) -> tuple[str, ...]:
    """Sentences about noise, correlation, disagreement, doubted forces and what is not told.

    Parameters
    ----------
    misfit : Misfit
    minimum : ScoredMinimum
    noise : ScoreNoise
    scatters : constant's name -> Scatter
    identifiable : constant's name -> bool
    weights : FixedWeights
    """
    notes = [*_noise_notes(misfit), *_interval_notes(noise, scatters)]
    for probe, one in zip(misfit.probes, minimum.probes, strict=True):
        if one.force_weight < _DOUBTED_FORCE:
            off = float(np.linalg.norm(one.shift))
            notes.append(
                f"The force of probing {probe.name!r} disagrees with the others by {off:.1f} of"
                " its standard deviations and was given little weight; check the sensor's scale."
            )
    if not identifiable["poisson_ratio"]:
        notes.append(
            "Poisson's ratio cannot be told; what the data do tell is"
            f" {told_combination(weights)}. Moduli are given for all of its range."
        )
    return tuple(notes)


def _noise_notes(misfit: Misfit) -> list[str]:
    present = np.unique(np.concatenate([probe.group for probe in misfit.probes]))
    notes = []
    estimated = [int(g) for g in present if g < CLAIMED_GROUPS.start]
    if estimated:
        parts = [f"{misfit.level[g]:.2e} m in {_GROUP_NAMES[g]}" for g in estimated]
        notes.append(f"Noise levels were estimated from the residuals: {', '.join(parts)}.")
    raised = [int(g) for g in present if g >= CLAIMED_GROUPS.start and misfit.level[g] > 1]
    if raised:
        half = GROUP_COUNT // 2
        parts = [f"{misfit.level[g]:.2f} in {_GROUP_NAMES[g - half]}" for g in raised]
        notes.append(
            "Residuals exceed the given standard deviations, which were multiplied by"
            f" {', '.join(parts)}."
        )
    return notes


def _interval_notes(noise: ScoreNoise, scatters: Mapping[str, Scatter]) -> list[str]:
    notes = []
    if noise.correlation.variance > 1:
        widened = np.sqrt(noise.correlation.variance)
        notes.append(
            "Residuals of neighbouring points are correlated; what the displacements contribute to"
            f" the intervals was widened by {widened:.1f}."
        )
    for name, scatter in scatters.items():
        if scatter.is_surprising:
            notes.append(
                f"The probings disagree about {_WORDS[name]} by {np.sqrt(scatter.ratio):.1f} times"
                " what their uncertainties explain; its interval was widened accordingly."
            )
    return notes

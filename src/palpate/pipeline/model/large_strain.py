"""An estimate whose object was pressed far: the linear one, corrected until it stands still."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from palpate.errors import NotConvergedError
from palpate.estimation import (
    FitResult,
    FitSettings,
    MaterialLaw,
    ProbeFit,
    ProbeObservations,
    fit,
)
from palpate.lab import FinitePress
from palpate.pipeline.model.finite_strain import make_finite_body, strain_corrections
from palpate.progress import Progress, part_of
from palpate.records import Session
from palpate.shapes import Points

# A correction of a tenth changes by a tenth of itself for a tenth of the modulus: each round gains
# a digit or so.
_MOST_ROUNDS = 8
_SETTLED_SHEAR, _SETTLED_RATIO = 1e-3, 5e-4
# Soft materials of the same constants differ from each other, at finite strain, by a good part of
# what they differ from a linear one.
_OTHER_LAWS = 0.3


def fit_at_finite_strain(
    session: Session,
    observations: Sequence[ProbeObservations],
    linear: FitResult,
    settings: FitSettings,
    progress: Progress,
) -> FitResult:
    """Correct a linear estimate for what finite strain adds.

    Parameters
    ----------
    session : Session               that was observed
    observations : sequence of ProbeObservations
    linear : FitResult              of these
    settings : FitSettings
    progress : callable

    Returns
    -------
    FitResult                       with a note that says how large the correction is

    Raises
    ------
    InputError                      supports or loads that finite strain does not serve
    NotConvergedError               no equilibrium, or the constants do not settle
    """
    body = make_finite_body(session)
    found = linear
    presses: tuple[FinitePress | None, ...] = ()
    for turn in range(_MOST_ROUNDS):
        before = found.estimate
        say = part_of(progress, turn / _MOST_ROUNDS, (turn + 1) / _MOST_ROUNDS)
        corrections, presses = strain_corrections(
            body,
            shear_modulus=before.shear_modulus.value,
            poisson_ratio=before.poisson_ratio.value,
            starts=presses,
            progress=say,
        )
        corrected = [_corrected(one, d) for one, d in zip(observations, corrections, strict=True)]
        found = fit(corrected, settings=settings)
        now = found.estimate
        moved = abs(now.shear_modulus.value / before.shear_modulus.value - 1.0)
        turned = abs(now.poisson_ratio.value - before.poisson_ratio.value)
        if moved < _SETTLED_SHEAR and turned < _SETTLED_RATIO:
            break
    else:
        raise NotConvergedError(
            f"the constants still change after {_MOST_ROUNDS} corrections for finite strain: the"
            " object is pressed too far for this; press less, or leave --strain finite out"
        )
    notes = (*found.estimate.notes, _size_note(observations, corrections))
    probes = [_whole(one, d) for one, d in zip(found.probes, corrections, strict=True)]
    return replace(found, estimate=replace(found.estimate, notes=notes), probes=tuple(probes))


def _corrected(observed: ProbeObservations, correction: Points) -> ProbeObservations:
    """What a linear object would have shown."""
    n = len(observed.position)
    tip = observed.tip_displacement
    law = MaterialLaw(_OTHER_LAWS, correction.ravel())
    return replace(
        observed,
        displacement=observed.displacement - correction[:n],
        tip_displacement=None if tip is None else tip - correction[n],
        nuisances=(*observed.nuisances, law),
    )


def _whole(probe: ProbeFit, correction: Points) -> ProbeFit:
    """Predictions of the object as it is."""
    n = len(probe.predicted)
    left_out = probe.left_out_predicted
    return replace(
        probe,
        predicted=probe.predicted + correction[:n],
        left_out_predicted=None if left_out is None else left_out + correction[:n],
    )


def _size_note(observations: Sequence[ProbeObservations], corrections: Sequence[Points]) -> str:
    """How large the corrections are, in words."""
    shares = [_share(one, d) for one, d in zip(observations, corrections, strict=True)]
    worst = int(np.argmax(shares))
    whole = float(np.sqrt(np.mean(np.square(shares))))
    return (
        f"Finite strain: the linear model alone is {100 * whole:.2g} % off here (rms over the"
        f" points; {100 * shares[worst]:.2g} % in {observations[worst].name}); corrected with"
        " neo-Hookean finite elements."
    )


def _share(observed: ProbeObservations, correction: Float[np.ndarray, "p 3"]) -> float:
    """Size of a correction over that of the displacement, where it was measured."""
    moved = observed.displacement
    seen = np.isfinite(moved)
    ours = correction[: len(moved)][seen]
    return float(np.linalg.norm(ours) / max(np.linalg.norm(moved[seen]), np.finfo(float).tiny))

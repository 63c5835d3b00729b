"""Estimate for an object that was pressed far: the linear one, corrected until it converges."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.errors import NotConvergedError
from palpate.estimation import (
    CorrectionError,
    FitResult,
    FitSettings,
    NuisanceParameter,
    ProbeFit,
    ProbeObservations,
    fit,
)
from palpate.lab import FinitePress, SplitNeoHookean
from palpate.pipeline.model.finite_strain import FiniteBody, make_finite_body, strain_corrections
from palpate.progress import Progress, part_of
from palpate.records import Session
from palpate.shapes import Points

# A correction of 10 % changes by 10 % of itself if the modulus changes by 10 %: each round gains
# about one digit.
_MOST_ROUNDS = 8
_SETTLED_SHEAR, _SETTLED_RATIO = 1e-3, 5e-4
# At finite strain, soft materials of the same constants differ from each other by a good part of
# their difference from a linear one.
_OTHER_LAWS = 0.3
# Edge ratio of the coarser elements: the error, of second order, is about the change from these.
_COARSER = 1.4
# Fraction of the work that the coarser elements take.
_ROUGH = 0.35


def fit_at_finite_strain(
    session: Session,
    observations: Sequence[ProbeObservations],
    linear: FitResult,
    settings: FitSettings,
    progress: Progress,
) -> FitResult:
    """Correct a linear estimate for finite strain.

    Parameters
    ----------
    session : Session               of the observations
    observations : sequence of ProbeObservations
    linear : FitResult              of these
    settings : FitSettings
    progress : callable

    Returns
    -------
    FitResult                       with a note on the size of the correction

    Raises
    ------
    InputError                      supports or loads that are not supported at finite strain
    NotConvergedError               no equilibrium, or the constants do not converge
    """
    task = _Task(observations, settings)
    rough = task.settled(
        make_finite_body(session, coarser=_COARSER), linear, (), part_of(progress, 0.0, _ROUGH)
    )
    constants = rough.found.estimate
    other, _ = strain_corrections(
        rough.body,
        shear_modulus=constants.shear_modulus.value,
        poisson_ratio=constants.poisson_ratio.value,
        law=SplitNeoHookean,
        starts=rough.presses,
    )
    coarser = [_Coarser(one, law - one) for one, law in zip(rough.corrections, other, strict=True)]
    fine = task.settled(
        make_finite_body(session), rough.found, coarser, part_of(progress, _ROUGH, 1.0)
    )
    found = fine.found
    notes = (*found.estimate.notes, _size_note(observations, fine.corrections))
    probes = [_whole(one, d) for one, d in zip(found.probes, fine.corrections, strict=True)]
    return replace(found, estimate=replace(found.estimate, notes=notes), probes=tuple(probes))


@dataclass(frozen=True, slots=True, eq=False)
class _Coarser:
    """Of one probing: its correction in coarser elements, and the change by the other law [m]."""

    correction: Points
    law: Points


@dataclass(frozen=True, slots=True, eq=False)
class _Settled:
    """A converged estimate with its corrections."""

    body: FiniteBody
    found: FitResult
    corrections: tuple[Points, ...]
    presses: tuple[FinitePress | None, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """Observations to be corrected, and the settings of their fits."""

    observations: Sequence[ProbeObservations]
    settings: FitSettings

    def settled(
        self, body: FiniteBody, start: FitResult, coarser: Sequence[_Coarser], progress: Progress
    ) -> _Settled:
        """Correct with the given elements until the constants converge."""
        found = start
        presses: tuple[FinitePress | None, ...] = ()
        for turn in range(_MOST_ROUNDS):
            before = found.estimate
            corrections, presses = strain_corrections(
                body,
                shear_modulus=before.shear_modulus.value,
                poisson_ratio=before.poisson_ratio.value,
                starts=presses,
                progress=part_of(progress, turn / _MOST_ROUNDS, (turn + 1) / _MOST_ROUNDS),
            )
            found = fit(self.corrected(corrections, coarser), settings=self.settings)
            now = found.estimate
            moved = abs(now.shear_modulus.value / before.shear_modulus.value - 1.0)
            turned = abs(now.poisson_ratio.value - before.poisson_ratio.value)
            if moved < _SETTLED_SHEAR and turned < _SETTLED_RATIO:
                return _Settled(body, found, corrections, presses)
        raise NotConvergedError(
            f"the constants still change after {_MOST_ROUNDS} corrections for finite strain: the"
            " object is pressed too far for this; press less, or leave --strain finite out"
        )

    def corrected(
        self, corrections: Sequence[Points], coarser: Sequence[_Coarser]
    ) -> list[ProbeObservations]:
        """Observations of an equivalent linear object, with the errors of the corrections."""
        known: Sequence[_Coarser | None] = coarser or [None] * len(corrections)
        return [
            _corrected(observed, correction, rough)
            for observed, correction, rough in zip(
                self.observations, corrections, known, strict=True
            )
        ]


def _corrected(
    observed: ProbeObservations, correction: Points, rough: _Coarser | None
) -> ProbeObservations:
    n = len(observed.position)
    tip = observed.tip_displacement
    return replace(
        observed,
        displacement=observed.displacement - correction[:n],
        tip_displacement=None if tip is None else tip - correction[n],
        nuisances=(*observed.nuisances, _error(observed.name, correction, rough)),
    )


def _error(name: str, correction: Points, rough: _Coarser | None) -> CorrectionError:
    """Error of a correction: other laws, and the elements."""
    errors = [("finite strain", "from linear to neo-Hookean", _OTHER_LAWS, correction)]
    if rough is not None:
        mesh_step = correction - rough.correction
        errors += [
            ("finite strain", "from one neo-Hookean law to another", 1.0, rough.law),
            (f"finite strain of {name}", "from coarser to finer elements", 1.0, mesh_step),
        ]
    parameters = (
        NuisanceParameter(f"{of}, in steps {step},", std, of="finite strain")
        for of, step, std, _ in errors
    )
    steps = [std * moved.ravel() for *_, std, moved in errors]
    return CorrectionError(tuple(parameters), np.stack(steps, axis=1))


def _whole(probe: ProbeFit, correction: Points) -> ProbeFit:
    """Predictions with the correction added back."""
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

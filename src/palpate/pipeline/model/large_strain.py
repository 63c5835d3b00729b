"""Estimate for an object that was pressed far: the linear one, corrected until it converges."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.errors import NotConvergedError
from palpate.estimation import (
    FitResult,
    FitSettings,
    Nuisance,
    NuisanceParameter,
    ProbeFit,
    ProbeObservations,
    fit,
    fixed_displacement,
)
from palpate.pipeline.model.finite_strain import FiniteBody, make_finite_body, strain_corrections
from palpate.progress import Progress, part_of
from palpate.records import Session
from palpate.shapes import Points
from palpate.solids import FinitePress, SplitNeoHookean

# A correction of 10 % changes by 10 % of itself if the modulus changes by 10 %: each round gains
# about one digit.
_MOST_ROUNDS = 8
_SHEAR_TOLERANCE, _RATIO_TOLERANCE = 1e-3, 5e-4
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
    SingularSystemError             as in `strain_corrections`
    NotConvergedError               no equilibrium, or the constants do not converge
    """
    task = _Task(observations, settings)
    rough = task.converged(
        make_finite_body(session, coarser=_COARSER), linear, (), part_of(progress, 0.0, _ROUGH)
    )
    constants = rough.result.estimate
    other, _ = strain_corrections(
        rough.body,
        shear_modulus=constants.shear_modulus.value,
        poisson_ratio=constants.poisson_ratio.value,
        law=SplitNeoHookean,
        starts=rough.presses,
    )
    coarser = [
        _Coarser(correction, law - correction)
        for correction, law in zip(rough.corrections, other, strict=True)
    ]
    fine = task.converged(
        make_finite_body(session), rough.result, coarser, part_of(progress, _ROUGH, 1.0)
    )
    result = fine.result
    notes = (*result.estimate.notes, _size_note(observations, fine.corrections))
    probes = [
        _with_correction(probe, correction)
        for probe, correction in zip(result.probes, fine.corrections, strict=True)
    ]
    return replace(result, estimate=replace(result.estimate, notes=notes), probes=tuple(probes))


@dataclass(frozen=True, slots=True, eq=False)
class _Coarser:
    """Of one probing: its correction in coarser elements, and the change by the other law [m]."""

    correction: Points
    law: Points


@dataclass(frozen=True, slots=True, eq=False)
class _Converged:
    """A converged estimate with its corrections."""

    body: FiniteBody
    result: FitResult
    corrections: tuple[Points, ...]
    presses: tuple[FinitePress | None, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """Observations to be corrected, and the settings of their fits."""

    observations: Sequence[ProbeObservations]
    settings: FitSettings

    def converged(
        self, body: FiniteBody, start: FitResult, coarser: Sequence[_Coarser], progress: Progress
    ) -> _Converged:
        """Correct with the given elements until the constants converge."""
        result = start
        presses: tuple[FinitePress | None, ...] = ()
        for iteration in range(_MOST_ROUNDS):
            before = result.estimate
            corrections, presses = strain_corrections(
                body,
                shear_modulus=before.shear_modulus.value,
                poisson_ratio=before.poisson_ratio.value,
                starts=presses,
                progress=part_of(
                    progress, iteration / _MOST_ROUNDS, (iteration + 1) / _MOST_ROUNDS
                ),
            )
            result = fit(self.corrected(corrections, coarser), settings=self.settings)
            now = result.estimate
            shear_change = abs(now.shear_modulus.value / before.shear_modulus.value - 1.0)
            ratio_change = abs(now.poisson_ratio.value - before.poisson_ratio.value)
            if shear_change < _SHEAR_TOLERANCE and ratio_change < _RATIO_TOLERANCE:
                return _Converged(body, result, corrections, presses)
        raise NotConvergedError(
            f"the constants still change after {_MOST_ROUNDS} corrections for finite strain: the"
            " object is pressed too far for this; press less, or leave --strain finite out"
        )

    def corrected(
        self, corrections: Sequence[Points], coarser: Sequence[_Coarser]
    ) -> list[ProbeObservations]:
        """Observations of an equivalent linear object, with the errors of the corrections."""
        each_coarser: Sequence[_Coarser | None] = coarser or [None] * len(corrections)
        return [
            _corrected(observed, correction, rough)
            for observed, correction, rough in zip(
                self.observations, corrections, each_coarser, strict=True
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


def _error(name: str, correction: Points, rough: _Coarser | None) -> Nuisance:
    """Error of a correction: other laws, and the elements."""
    errors = [("finite strain", "from linear to neo-Hookean", _OTHER_LAWS, correction)]
    if rough is not None:
        mesh_step = correction - rough.correction
        errors += [
            ("finite strain", "from one neo-Hookean law to another", 1.0, rough.law),
            (f"finite strain of {name}", "from coarser to finer elements", 1.0, mesh_step),
        ]
    parameters = (
        NuisanceParameter(f"{of}, in steps {step},", std, of="finite strain", is_model_error=True)
        for of, step, std, _ in errors
    )
    steps = [std * moved.ravel() for *_, std, moved in errors]
    moved = np.stack(steps, axis=1)
    return Nuisance(tuple(parameters), lambda at: fixed_displacement(moved[at.rows], at))


def _with_correction(probe: ProbeFit, correction: Points) -> ProbeFit:
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
    shares = [
        _share(observed, correction)
        for observed, correction in zip(observations, corrections, strict=True)
    ]
    worst = int(np.argmax(shares))
    overall = float(np.sqrt(np.mean(np.square(shares))))
    return (
        f"Finite strain: the linear model alone is {100 * overall:.2g} % off here (rms over the"
        f" points; {100 * shares[worst]:.2g} % in {observations[worst].name}); corrected with"
        " neo-Hookean finite elements."
    )


def _share(observed: ProbeObservations, correction: Float[np.ndarray, "p 3"]) -> float:
    """Size of a correction over that of the displacement, where it was measured."""
    measured = np.isfinite(observed.displacement)
    size = float(np.linalg.norm(observed.displacement[measured]))
    applied = correction[: len(measured)][measured]
    return float(np.linalg.norm(applied)) / max(size, float(np.finfo(float).tiny))

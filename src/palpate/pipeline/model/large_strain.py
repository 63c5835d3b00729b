"""Estimate for an object that was pressed far: the linear one, corrected until it converges.

The constants are estimated with a linear model from corrected measurements: the difference between
two finite element solutions, one at finite strain and one linear, both under the same loads and
with the latest constants, is subtracted first (defect correction). The discretisation error of the
elements cancels in the difference. Where a probing names a ball or a flat face that
slides, the linear solution is that for the contact circle of the linear model, and the
finite-strain solution that for the tool itself, pressed in by the same force.

The stiffening of the material is one more parameter, by which the elements give the derivative of
the correction, as by the constants; it stays where the data show it.
"""

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
    ResponseModel,
    fit,
    fixed_displacement,
)
from palpate.pipeline.model.finite_body import FiniteBody, make_finite_body
from palpate.pipeline.model.stiffening import (
    STIFFENING_STD,
    STIFFENS,
    MaterialConstants,
    damped,
    estimated_stiffening,
    is_stiffening,
)
from palpate.progress import Progress, part_of, silent
from palpate.records import (
    Constant,
    Session,
    Status,
    stiffening_text,
)
from palpate.shapes import Points
from palpate.solids import (
    Body,
    FinitePress,
    Law,
    LawOf,
    NeoHookean,
    Sag,
    SplitNeoHookean,
    dilation_slope,
    load_slopes,
    make_body,
    press_finite,
    press_slopes,
    solve_finite,
    solve_load,
    yeoh,
)

_MOST_ROUNDS = 8
_MODULUS_TOLERANCE, _RATIO_TOLERANCE, _STIFFENING_TOLERANCE = 1e-3, 5e-4, 2e-2
# Share of its standard deviation by which a constant may still change: no interval shows it.
_WANDERS = 0.1
# Standard deviations of stiffening below which the material is taken as one that does not stiffen.
_HOPELESS = 1.0
# Soft materials of the same constants differ by about this much of their change from a linear one.
_OTHER_LAWS = 0.3
# Edge ratio of the coarser elements, and the error of second order over the change from these.
_COARSER = 1.4
_BEYOND = 1.0 / (_COARSER**2 - 1.0)
# Fractions of the work that are done with the coarser elements, and with those by another law.
_ROUGH, _OTHER = 0.2, 0.3
# Largest Poisson's ratio for which neo-Hookean elements find an equilibrium.
_LARGEST_RATIO = 0.495


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Displacement of a probing at finite strain minus that of the linear elements.

    Attributes
    ----------
    constants : MaterialConstants
    value : (p, 3) float [m]        at its points, then at its contact point where that was measured
    slope : (3, p, 3) float [m]     by the logarithm of the shear modulus, Poisson's ratio and the
                                    stiffening
    press : FinitePress             the solution at finite strain
    """

    constants: MaterialConstants
    value: Points
    slope: Float[np.ndarray, "3 p 3"]
    press: FinitePress

    def at(self, constants: MaterialConstants) -> Points:
        """The correction for nearly the same constants, (p, 3) [m]."""
        present = self.constants
        change = [
            np.log(constants.shear_modulus / present.shear_modulus),
            constants.poisson_ratio - present.poisson_ratio,
            constants.stiffening - present.stiffening,
        ]
        return self.value + np.tensordot(change, self.slope, axes=1)


# Of one probing: its correction in coarser elements, and that by the other law.
_Coarser = tuple[Correction, Correction]


@dataclass(frozen=True, slots=True, eq=False)
class _Used:
    """Data of an estimate; errors of the corrections are known once there are coarser ones."""

    observations: Sequence[ProbeObservations]
    settings: FitSettings
    coarser: tuple[_Coarser, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _FiniteResponse:
    """A linear response with how its correction depends on force, modulus and Poisson's ratio
    (`ResponseModel`): near the constants it was made for, it is affine in force over modulus."""

    linear: ResponseModel
    poisson_ratio: float
    per_force: Float[np.ndarray, "n_rows 3"]
    slope: Float[np.ndarray, "n_rows 3"]

    def value(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows c"]:
        """Of `ResponseModel`."""
        response = self.linear.value(poisson_ratio).copy()
        response[:, :3] += self.per_force + (poisson_ratio - self.poisson_ratio) * self.slope
        return response


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
    used = _Used(observations, settings)
    body = make_finite_body(session, coarser=_COARSER)
    stage_progress = part_of(progress, 0.0, _ROUGH)
    rough, coarse = _converged(body, used, linear, stage_progress, stiffens=True)
    stage_progress = part_of(progress, _ROUGH, _OTHER)
    other = strain_corrections(
        body, coarse[0].constants, law=SplitNeoHookean, starts=coarse, progress=stage_progress
    )
    used = replace(used, coarser=tuple(zip(coarse, other, strict=True)))
    body, stage_progress = make_finite_body(session), part_of(progress, _OTHER, 1.0)
    result, estimated = rough, estimated_stiffening(rough)
    starts: tuple[Correction, ...] = ()
    if estimated.value > _HOPELESS * estimated.std:
        result, starts = _converged(body, used, rough, stage_progress, stiffens=True)
        estimated = estimated_stiffening(result)
    # What is not shown may be there: the constants allow for it, unless it is hardly suspected.
    if estimated.value <= _HOPELESS * estimated.std:
        result, starts = _converged(
            body, used, result, stage_progress, stiffens=False, starts=starts
        )
    estimate, shown = result.estimate, is_stiffening(estimated)
    sentence, size = stiffening_text(estimated, shown=shown), _size_note(observations, starts)
    notes = (sentence, *estimate.notes, size) if shown else (*estimate.notes, size, sentence)
    if estimate.status is Status.MODEL_CONTRADICTED:
        notes, estimated = (
            (*estimate.notes, size),
            Constant(estimated.value, np.nan, (np.nan, np.nan)),
        )
    stiffening = estimated if shown else None
    return replace(result, estimate=replace(estimate, notes=notes, stiffening=stiffening))


def strain_corrections(
    body: FiniteBody,
    constants: MaterialConstants,
    *,
    law: LawOf = NeoHookean,
    starts: Sequence[Correction] = (),
    progress: Progress = silent,
) -> tuple[Correction, ...]:
    """Displacement at finite strain minus that of the linear elements, for every probing.

    Parameters
    ----------
    body : FiniteBody
    constants : MaterialConstants   a Poisson's ratio above 0.495 is taken for 0.495, a stiffening
                                    below 0 for 0
    law : function                  Lame constants mu and lambda [Pa] -> `Law` of finite strain
                                    that the stiffening is added to
    starts : sequence               corrections for nearly the same constants to start from; empty:
                                    from rest
    progress : callable

    Returns
    -------
    tuple of Correction

    Raises
    ------
    SingularSystemError             the held nodes are collinear
    NotConvergedError               no equilibrium at finite strain
    """
    constants = replace(
        constants,
        poisson_ratio=min(constants.poisson_ratio, _LARGEST_RATIO),
        stiffening=max(constants.stiffening, 0.0),
    )
    elastic = make_body(
        body.solid,
        body.held,
        shear_modulus=constants.shear_modulus,
        poisson_ratio=constants.poisson_ratio,
    )
    sag = _sagged(body, elastic, constants, law) if body.weight.any() else None
    solved: list[tuple[FinitePress, Points, Float[np.ndarray, "3 n 3"]]] = []
    for k, same in enumerate(body.same):
        progress("finite strain", k / len(body.same))
        start = starts[k].press if starts else None
        solved.append(
            solved[same] if same < k else _pressed(body, k, elastic, constants, law, start, sag)
        )
    return tuple(
        Correction(constants, seen @ value, np.stack([seen @ change for change in slope]), press)
        for seen, (press, value, slope) in zip(body.observed, solved, strict=True)
    )


def _pressed(
    body: FiniteBody,
    index: int,
    elastic: Body,
    constants: MaterialConstants,
    plain: LawOf,
    start: FinitePress | None,
    sag: Sag | None,
) -> tuple[FinitePress, Points, Float[np.ndarray, "3 n 3"]]:
    """The solution of one probing at finite strain, and the correction of all nodes with its
    slopes; the object may have weight."""
    load, tip = body.loads[index], body.tips[index]
    law, here, others = _laws(elastic, constants, plain)
    total = load + body.weight
    linear = solve_load(elastic, load if body.at_rest else total)
    if tip is None:
        before = start.displacement if start is not None else sag.displacement if sag else None
        press = FinitePress(solve_finite(elastic, total, law=law, start=before), 0.0)
        moved = load_slopes(elastic, total, press.displacement, law=here, others=others)
    else:
        force = float(np.linalg.norm(load.sum(axis=0)))
        press = press_finite(elastic, tip, force, law=law, start=start, sag=sag)
        moved = press_slopes(elastic, tip, force, press, law=here, others=others, sag=sag)
    change = press.displacement
    if sag is not None and body.at_rest:
        change, moved = change - sag.displacement, moved - sag.slopes
    by_load, by_lame, by_stiffening = moved.T.reshape(3, -1, 3)
    # Both depend on force over modulus alone; d lambda / d nu, in units of mu.
    per_ratio = 2.0 / (1.0 - 2.0 * constants.poisson_ratio) ** 2
    per_ratio *= constants.poisson_ratio < _LARGEST_RATIO
    by_ratio = per_ratio * (by_lame - dilation_slope(elastic, linear))
    slope = np.stack([linear - by_load, by_ratio, by_stiffening])
    return press, change - linear, slope


def _sagged(body: FiniteBody, elastic: Body, constants: MaterialConstants, plain: LawOf) -> Sag:
    """The object under its weight alone."""
    law, here, others = _laws(elastic, constants, plain)
    moved = solve_finite(elastic, body.weight, law=law)
    slopes = load_slopes(elastic, body.weight, moved, law=here, others=others)
    return Sag(body.weight, moved, slopes)


def _laws(
    elastic: Body, constants: MaterialConstants, plain: LawOf
) -> tuple[LawOf, Law, list[Law]]:
    """The law of a material as a function of its constants; the law at these; and laws at others,
    for derivatives: a larger lambda, and more stiffening."""
    (mu, lame), law = elastic.lame, yeoh(constants.stiffening, plain)
    others = [law(mu, lame + mu), yeoh(constants.stiffening + 1.0, plain)(mu, lame)]
    return law, law(mu, lame), others


def _converged(
    body: FiniteBody,
    used: _Used,
    start: FitResult,
    progress: Progress,
    *,
    stiffens: bool,
    starts: Sequence[Correction] = (),
) -> tuple[FitResult, tuple[Correction, ...]]:
    """The estimate from observations of an equivalent linear object, corrected with the given
    elements until the constants converge, of a material that may stiffen or does not; and its
    corrections."""
    result, now = start, _constants(start, stiffens=stiffens)
    last = 0.0, 0.0
    for iteration in range(_MOST_ROUNDS):
        before = now
        stage_progress = part_of(progress, 1.0 - 0.5**iteration, 1.0 - 0.5 ** (iteration + 1))
        starts = strain_corrections(body, before, starts=starts, progress=stage_progress)
        if used.coarser:
            starts = tuple(map(_extrapolated, starts, used.coarser))
        corrected = [
            corrected_observations(observed, correction, rough, stiffens=stiffens)
            for observed, correction, rough in zip(
                used.observations, starts, used.coarser or [None] * len(starts), strict=True
            )
        ]
        result = fit(corrected, settings=used.settings)
        now = _constants(result, stiffens=stiffens)
        if _is_settled(before, now, result):
            probes = tuple(
                _with_correction(probe, _taken_off(correction, stiffens=stiffens))
                for probe, correction in zip(result.probes, starts, strict=True)
            )
            return replace(result, probes=probes), tuple(starts)
        last, now = (before.stiffening, now.stiffening), damped(before, now, last)
    raise NotConvergedError(
        f"the constants still change after {_MOST_ROUNDS} corrections for finite strain: the"
        " object is pressed too far for this; press less, or leave --strain finite out"
    )


def _extrapolated(correction: Correction, rough: _Coarser) -> Correction:
    """A correction of infinitely fine elements, whose error is of second order (Richardson)."""
    step = correction.value - rough[0].at(correction.constants)
    return replace(correction, value=correction.value + _BEYOND * step)


def _is_settled(before: MaterialConstants, now: MaterialConstants, result: FitResult) -> bool:
    """Whether the constants that the data determine stand still; the nu of a beam never does."""
    estimate, stiffening = result.estimate, estimated_stiffening(result)
    least = {
        "shear_modulus": _MODULUS_TOLERANCE * now.shear_modulus,
        "poisson_ratio": _RATIO_TOLERANCE,
        "young_modulus": _MODULUS_TOLERANCE * now.young_modulus,
    }
    known = [name for name in least if estimate.identifiable[name]] or [*least]
    size = max(_STIFFENING_TOLERANCE * (1.0 + now.stiffening), _WANDERS * stiffening.std)
    return abs(now.stiffening - before.stiffening) < size and all(
        abs(getattr(now, name) - getattr(before, name))
        < max(least[name], _WANDERS * getattr(estimate, name).std)
        for name in known
    )


def _constants(result: FitResult, *, stiffens: bool) -> MaterialConstants:
    """Constants of the material from a result; never softening, so that the energy is convex."""
    estimate = result.estimate
    stiffening = max(estimated_stiffening(result).value, 0.0) if stiffens else 0.0
    return MaterialConstants(estimate.shear_modulus.value, estimate.poisson_ratio.value, stiffening)


def _taken_off(correction: Correction, *, stiffens: bool) -> Points:
    """The part of a correction that depends neither on the constants nor on the force."""
    fixed = correction.value + correction.slope[0]
    if stiffens:
        fixed = fixed - correction.constants.stiffening * correction.slope[2]
    return fixed


def corrected_observations(
    observed: ProbeObservations, correction: Correction, rough: _Coarser | None, *, stiffens: bool
) -> ProbeObservations:
    """Observations of an equivalent linear object. What of the correction is affine in force over
    modulus is put into its response.

    Parameters
    ----------
    observed : ProbeObservations
    correction : Correction         of this probing
    rough : _Coarser or None        None: without the errors of the correction's elements and law
    stiffens : bool                 whether the stiffening is estimated; else it is that of the
                                    correction
    """
    n, now = len(observed.position), correction.constants
    tip, fixed = observed.tip_displacement, _taken_off(correction, stiffens=stiffens)
    along = now.shear_modulus * observed.force / float(observed.force @ observed.force)
    by_modulus, by_ratio = (derivative.ravel() for derivative in correction.slope[:2])
    by_force = np.outer(-by_modulus, along), np.outer(by_ratio, along)
    response = _FiniteResponse(observed.response, now.poisson_ratio, *by_force)
    errors = [_error(observed.name, correction, rough)]
    if stiffens:
        parameter = NuisanceParameter(STIFFENS, STIFFENING_STD, is_material=True)
        column = STIFFENING_STD * correction.slope[2].reshape(-1, 1)
        errors.append(Nuisance((parameter,), lambda at: fixed_displacement(column[at.rows], at)))
    return replace(
        observed,
        displacement=observed.displacement - fixed[:n],
        tip_displacement=None if tip is None else tip - fixed[n],
        response=response,
        nuisances=(*observed.nuisances, *errors),
    )


def _error(name: str, correction: Correction, rough: _Coarser | None) -> Nuisance:
    """Error of a correction: other laws, and the elements. Their shapes are known well enough that
    they are no measure of the model's error of unknown shape."""
    now = correction.constants
    plain = correction.at(replace(now, stiffening=0.0))
    errors = [("finite strain", "from linear to neo-Hookean", _OTHER_LAWS, plain)]
    if rough is not None:
        coarse, other = rough
        laws, elements = other.value - coarse.value, correction.value - coarse.at(now)
        errors += [
            ("finite strain", "from one neo-Hookean law to another", 1.0, laws),
            (
                f"finite strain of {name}",
                "from coarser to extrapolated elements",
                _BEYOND / (1.0 + _BEYOND),
                elements,
            ),
        ]
    parameters = (
        NuisanceParameter(f"{what} (in steps {step})", std, of="finite strain")
        for what, step, std, _ in errors
    )
    moved = np.stack([std * step.ravel() for *_, std, step in errors], axis=1)
    return Nuisance(tuple(parameters), lambda at: fixed_displacement(moved[at.rows], at))


def _with_correction(probe: ProbeFit, taken_off: Points) -> ProbeFit:
    """Predictions with what was taken off the measurement added back."""
    n = len(probe.predicted)
    left_out = probe.left_out_predicted
    return replace(
        probe,
        predicted=probe.predicted + taken_off[:n],
        left_out_predicted=None if left_out is None else left_out + taken_off[:n],
    )


def _size_note(observations: Sequence[ProbeObservations], corrections: Sequence[Correction]) -> str:
    """How large the corrections are, in words."""
    pairs = zip(observations, corrections, strict=True)
    shares = [_share(observed, correction.value) for observed, correction in pairs]
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

"""The modulus as a function of time, from the series of probings and their finished static fit.

Poisson's ratio is taken as constant, so every field of a probing is that of its static fit times a
function of time, c(t) = int J(t - s) dF(s): each instant becomes one number.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.estimation import FitResult
from palpate.records import (
    HALF_95,
    Constant,
    Contact,
    Estimate,
    LossPoint,
    Probing,
    RelaxationEstimate,
    RelaxationPoint,
    RelaxationTerm,
    Series,
    Session,
    Sphere,
)
from palpate.relaxation import CreepCompliance, CreepFit, Motion, fit_creep
from palpate.shapes import Flags, Indices, Points

# Least hold over the rise of the force; the grid of time constants ends at this part of the hold.
_LEAST_HOLD, _LONGEST = 3.0, 1.0 / 3.0
# Radii of a contact that grows within which displacement is not linear in the force: beyond them
# G of a half space is wrong by 0.12 %, and Poisson's ratio seems to change by 0.001, not by 0.007
# as beyond two (`python -m benchmarks.creep`).
_FAR = 3.0
# Under a ball and a cone on a half space: power of the force with which the depth goes, and depth
# over (1 - nu) F / (G a), with a the radius of the contact. Johnson, Contact Mechanics (1985).
_BALL, _CONE = (2.0 / 3.0, 3.0 / 8.0), (1.0 / 2.0, 1.0 / 2.0)
_GROWING = {"sphere": _BALL, "hertz": _BALL, "cone": _CONE}
# Largest motion, over that of the static fit, and largest share of the depth under a tool in it.
_LARGEST, _DEEPEST = 3.0, 1.4
_FEW_POINTS = 10
# Times in which a term of the longest time has run out; rises that a term of the shortest takes.
_RUN_OUT, _SEEN = 3.0, 2.0
# Half width of the logarithm of a modulus above which it is not determined.
_WIDE = 0.25
_PER_DECADE = 10
# Change of Poisson's ratio that counts: so many standard deviations, and at least this much.
_SIGMAS, _LEAST_CHANGE = 3.0, 0.01
_STEP = 1e-3
_Quantity = Callable[[CreepCompliance], Float[np.ndarray, " q"]]
# Further notes are details.
_MOST_NOTES = 3


def require_series(session: Session) -> None:
    """Refuse a session from which no modulus over time can be estimated.

    Raises
    ------
    InputError                      no probing has a series
    """
    if all(probing.series is None for probing in session.probings):
        raise InputError(
            f"{session.path}: the modulus over time is asked for, but no [[probe]] has a series:"
            " write force and motion of a push that is held, from before the contact, into a CSV"
            ' file, and name it with series = "FILE"'
        )


def with_relaxation(session: Session, result: FitResult) -> FitResult:
    """A result with the modulus as a function of time, if probings have series.

    Parameters
    ----------
    session : Session               with the contacts that were fitted
    result : FitResult              static, of this session

    Returns
    -------
    FitResult                       with `creep`, and `relaxation` of its estimate; or with a note
                                    that says why not
    """
    if all(probing.series is None for probing in session.probings):
        return result
    reasons, motions, held, remarks = list[str](), list[Motion](), list[Series](), list[str]()
    for k, probing in enumerate(session.probings):
        series = probing.series
        if series is None:
            continue
        if reason := _unusable(session, probing, series):
            reasons.append(f"The series of {probing.name!r} was not used: {reason}.")
            continue
        seen = []
        if len(series.instant) and _far(probing).sum() < _FEW_POINTS:
            reasons.append(
                f"The frames of {probing.name!r} were not used: fewer than {_FEW_POINTS} points are"
                f" farther than {_FAR:g} radii from its contact, which grows; give its tip as well."
            )
        elif len(series.instant):
            seen.append(_seen_in_frames(probing, series, result, k))
            remarks.append(_constant_ratio(probing, series, seen[0]))
        if series.tip is not None:
            seen.append(_seen_at_tip(probing, series, series.tip, result.estimate))
        observed = [motion for source in seen for motion in _motion(series, source)]
        motions += observed
        held += [series for _ in observed]
    estimate = result.estimate
    if motions:
        shortest = min(series.rise for series in held)
        longest = _LONGEST * max(series.hold for series in held)
        try:
            creep = fit_creep(motions, shortest=shortest, longest=longest)
        except InputError as error:
            reasons.append(f"The modulus over time was not determined: {error}.")
        else:
            relaxation = _relaxation(result, creep, held, list(filter(None, remarks)))
            result = replace(result, creep=creep)
            estimate = replace(estimate, relaxation=relaxation)
    notes = (*reasons, *estimate.notes)
    details = (*notes[_MOST_NOTES:], *estimate.details)
    return replace(result, estimate=replace(estimate, notes=notes[:_MOST_NOTES], details=details))


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What was seen of one probing: at k instants, its motion over that of the static fit, the
    standard deviation of that up to a factor, and how far Poisson's ratio is from the fit's."""

    name: str
    instant: Indices
    amplitude: Float[np.ndarray, " k"]
    std: Float[np.ndarray, " k"]
    change: Float[np.ndarray, " k"]


def _unusable(session: Session, probing: Probing, series: Series) -> str:
    """Why the series of a probing cannot be used; empty if it can."""
    if series.hold < _LEAST_HOLD * series.rise:
        return (
            f"the force is held for {series.hold:.3g} s after it rose for {series.rise:.3g} s; hold"
            f" it {_LEAST_HOLD:g} times as long at least, better ten times"
        )
    if probing.loads or session.added_gravity is not None or probing.support_motion is not None:
        return "other loads, or supports that move, do not follow its force"
    return ""


def _motion(series: Series, seen: _Seen) -> list[Motion]:
    """What was seen after the contact: before it nothing moves, whatever the body."""
    used = np.isfinite(seen.amplitude) & (series.time[seen.instant] > series.contact)
    if not used.any():
        return []
    force = series.force / series.force[series.reference]
    return [
        Motion(
            series.time - series.contact, force, seen.instant[used], seen.amplitude[used],
            seen.std[used], series.reference, seen.name,
        )
    ]  # fmt: skip


def _seen_at_tip(probing: Probing, series: Series, tip: Points, estimate: Estimate) -> _Seen:
    """How far the tool went in, as the response of a body whose contact keeps its size.

    A contact that grows is at every time that of an elastic body with the same c(t) (Lee and
    Radok): of the tip's motion, the depth under the tool goes with a power of c, the rest with c.
    """
    measured = probing.tip_displacement
    measured = tip[series.reference] if measured is None else measured
    known = np.isfinite(measured)
    along = tip[:, known] @ measured[known] / float(measured[known] @ measured[known])
    power, _ = _GROWING.get(_shape(probing.contact), (1.0, 0.0))
    share = _depth(probing, estimate) / float(np.linalg.norm(measured[known]))
    share = min(share, _DEEPEST)
    response = np.linspace(0.0, _LARGEST, 3001)
    moved = share * response**power + (1.0 - share) * response
    amplitude = np.sign(along) * np.interp(np.abs(along), moved, response)
    # A first touch is as uncertain as its depth, not more certain.
    slope = np.gradient(response, moved)
    std = np.interp(np.maximum(np.abs(along), 0.01), moved, slope)
    unknown = np.full(len(tip), np.nan)
    return _Seen(f"{probing.name}, tip", np.arange(len(tip)), amplitude, std, unknown)


def _depth(probing: Probing, estimate: Estimate) -> float:
    """Depth [m] under a tool whose contact grows, on a half space; 0 under any other."""
    contact, force = probing.contact, float(np.linalg.norm(probing.force))
    _, factor = _GROWING.get(_shape(contact), (1.0, 0.0))
    compliance = (1.0 - estimate.poisson_ratio.value) / estimate.shear_modulus.value
    radius = contact.radius or 0.0
    if contact.tool is not None and isinstance(contact.tool, Sphere):
        radius = float(np.cbrt(factor * contact.tool.radius * force * compliance))
    return factor * force * compliance / radius if radius > 0.0 else 0.0


def _shape(contact: Contact) -> str:
    return contact.profile if contact.tool is None else contact.tool.shape


def _far(probing: Probing) -> Flags:
    """Points whose displacement is linear in the force: all, except about a contact that grows."""
    if probing.displacement is None:
        return np.zeros(0, dtype=bool)
    points, contact = probing.displacement.points, probing.contact
    grows = _shape(contact) in (*_GROWING, "mesh")
    near = np.linalg.norm(points - contact.point, axis=1) <= _FAR * contact.reach
    return ~(near & grows)


def _seen_in_frames(probing: Probing, series: Series, result: FitResult, index: int) -> _Seen:
    """Motion in every frame, by weighted regression on the static fit's prediction at its
    points."""
    fitted = result.probes[index]
    known = np.isfinite(fitted.predicted) & _far(probing)[:, None]
    sigma = np.ones_like(fitted.predicted) if fitted.sigma is None else fitted.sigma
    weight = np.where(known, fitted.weight / sigma**2, 0.0)
    weight = np.where(np.isfinite(weight), weight, 0.0)
    shape = np.nan_to_num(fitted.predicted)
    minimum = result.minimum
    theta = minimum.theta.copy()
    # Away from either end of the range.
    step = _STEP if minimum.poisson_ratio < 0.25 else -_STEP
    theta[0] += step
    ratio = np.nan_to_num(minimum.problem.predicted_points(index, theta) - shape) / step
    parts = []
    for frame in series.frames:
        here, moved = np.where(np.isfinite(frame), weight, 0.0), np.nan_to_num(frame)
        square = (here * shape**2).sum()
        # What no point shows becomes NaN.
        with np.errstate(divide="ignore", invalid="ignore"):
            across = ratio - shape * (here * shape * ratio).sum() / square
            amplitude = (here * shape * moved).sum() / square
            turn = (here * across * moved).sum() / (here * across**2).sum()
            parts.append((amplitude, 1.0 / np.sqrt(square), turn / amplitude))
    return _Seen(f"{probing.name}, points", series.instant, *np.array(parts).T)


def _constant_ratio(probing: Probing, series: Series, seen: _Seen) -> str:
    """Whether the shape of the motion changes over the hold as with Poisson's ratio; empty if too
    few frames tell."""
    age = series.time[series.instant] - series.contact
    used = (age >= series.rise) & np.isfinite(seen.change)
    if used.sum() < _FEW_POINTS:
        return ""
    x = np.log(age[used] / age[used].max())
    (slope, _), covariance = np.polyfit(
        x, seen.change[used], 1, w=np.abs(seen.amplitude[used]), cov=True
    )
    change, std = -slope * x.min(), -math.sqrt(covariance[0, 0]) * x.min()
    if abs(change) > max(_SIGMAS * std, _LEAST_CHANGE):
        return (
            f"Poisson's ratio changes by {change:+.3f} ± {std:.3f} over the hold of"
            f" {probing.name!r}: the body does not only grow softer, and one function of time does"
            " not describe it."
        )
    return (
        f"Poisson's ratio is constant over the hold of {probing.name!r}: it changes by"
        f" {change:+.3f} ± {std:.3f}."
    )


def _relaxation(
    result: FitResult, creep: CreepFit, held: list[Series], remarks: list[str]
) -> RelaxationEstimate:
    """The modulus over time, with intervals that join those of the static fit and of its shape."""
    estimate = result.estimate
    known = estimate.identifiable
    name = "shear_modulus" if known["shear_modulus"] else "young_modulus"
    static: Constant = getattr(estimate, name)
    rise, hold = min(series.rise for series in held), max(series.hold for series in held)

    def joint(quantity: _Quantity, *, scale: Constant | None) -> list[Constant]:
        values, std = creep.logarithm(quantity)
        pairs = zip(values, creep.quantile * std, strict=True)
        return [_constant(float(value), float(wide), scale) for value, wide in pairs]

    steps = np.arange(
        math.ceil(_PER_DECADE * math.log10(rise) - 1e-9),
        math.floor(_PER_DECADE * math.log10(hold) + 1e-9) + 1,
    )
    time = 10.0 ** (steps / _PER_DECADE)
    curve = joint(lambda fit: fit.relaxation().at(time), scale=static)
    ends = joint(_end_values, scale=static)
    modulus = creep.compliance.relaxation()
    times = joint(lambda fit: fit.relaxation().times, scale=None) if creep.terms else []
    frequency = _frequencies(rise, hold) if creep.terms else np.zeros(0)
    lags = joint(lambda fit: fit.relaxation().loss_angle(frequency), scale=None)
    first, last, why = _ends(creep, ends, rise, hold)
    if not known[name]:
        why.append("No modulus is determined: only ratios of the curve and times are.")
    return RelaxationEstimate(
        name, float(np.mean([series.age for series in held])), rise, hold,
        static.value * modulus.instantaneous,
        tuple(
            RelaxationTerm(time_constant, float(term / modulus.instantaneous))
            for time_constant, term in zip(times, modulus.terms, strict=True)
        ),
        tuple(RelaxationPoint(float(t), constant) for t, constant in zip(time, curve, strict=True)),
        first, last, (*why, *remarks),
        tuple(LossPoint(float(f), lag) for f, lag in zip(frequency, lags, strict=True)),
    )  # fmt: skip


def _frequencies(rise: float, hold: float) -> Float[np.ndarray, " n"]:
    """Whole decades of frequency [Hz] whose radians take from the rise to the hold."""
    ends = np.log10(1.0 / (2.0 * np.pi * np.array([hold, rise])))
    return 10.0 ** np.arange(math.ceil(ends[0] - 1e-9), math.floor(ends[1] + 1e-9) + 1)


def _constant(value: float, wide: float, scale: Constant | None) -> Constant:
    """A value from its logarithm and half the width of that one's interval; as a multiple of a
    constant, with the interval of both."""
    if scale is None:
        scale = Constant(1.0, 0.0, (1.0, 1.0))
    low, high = scale.ci95
    if not 0.0 < low <= high < math.inf:
        return Constant(scale.value * math.exp(value), math.nan, (math.nan, math.nan))
    below, above = (math.hypot(wide, math.log(end / scale.value)) for end in scale.ci95)
    scaled = scale.value * math.exp(value)
    ends = scaled * math.exp(-below), scaled * math.exp(above)
    return Constant(scaled, 0.5 * (ends[1] - ends[0]) / HALF_95, ends)


def _ends(
    creep: CreepFit, ends: list[Constant], rise: float, hold: float
) -> tuple[Constant | None, Constant | None, list[str]]:
    """Instantaneous and long-term modulus where the window shows them, and why not."""
    first, last = ends
    if not creep.terms:
        return first, last, ["No creep is seen: the modulus is the same at all times."]
    compliance = creep.compliance
    shortest, longest = compliance.relaxation().times.min(), compliance.times.max()
    # Of the curve alone: the static modulus is known as well as the table above says.
    early, late = creep.quantile * creep.logarithm(_end_values)[1] > _WIDE
    why = []
    if hidden := shortest < _SEEN * rise or early:
        why.append(
            f"The instantaneous modulus is not determined: a time constant of {shortest:.2g} s is"
            f" too short for a force that rises for {rise:.2g} s; load within"
            f" {min(shortest, rise) / _SEEN:.1g} s."
        )
    if unfinished := longest > hold / _RUN_OUT or late:
        why.append(
            f"The long-term modulus is not determined: hold for"
            f" {max(_RUN_OUT * longest, 2.0 * hold):.2g} s."
        )
    return None if hidden else first, None if unfinished else last, why


def _end_values(compliance: CreepCompliance) -> Float[np.ndarray, " 2"]:
    modulus = compliance.relaxation()
    return np.array([modulus.instantaneous, modulus.long_term])

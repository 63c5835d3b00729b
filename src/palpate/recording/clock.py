"""The offset of a camera's clock from the gauge's, from motion and force of the same presses.

First the offset at which the picture's changes go best with the force over the whole recording.
Then, press by press, the one at which the force is best told from how far the picture has gone,
whatever the law between the two: the same picture has the same force, going in and coming out. A
material with hysteresis shifts that by half of it, as a share of a ramp's time. It costs nothing:
where pictures are taken nothing moves, and a tenth of a second would do.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.errors import RecordError
from palpate.recording.force import Touch
from palpate.recording.pictures import MARGIN, CameraMotion, Ramp

# Steps of the first search [s].
_STEP = 0.02
# Signals that overlap less, as a share of the shorter one, say nothing.
_OVERLAP = 0.5
# Below it the picture does not go with the force at all; another offset as good as this is a doubt.
_LEAST_CORRELATION, _DOUBT = 0.3, 0.95
# Presses that follow each other in the same time, to so many seconds, can be taken for each other.
_REGULAR = 0.05
# Of the press's force: below it, the tool may still be in the air, where motion means no force.
_CONTACT = 0.15
# The same where the clocks are known.
_KNOWN_CONTACT = 0.02
# The law from motion to force: a polynomial of this order, without a say for the offset.
_ORDER = 3
# Pictures of a press that tell more than such a law takes.
_FEWEST = 2 * (_ORDER + 1)
# Steps of the second search [s], and half its width in the last round.
_FINE, _LAST = 0.01, 0.002
# Shares of the way at which loading and unloading are compared.
_COMPARED = np.linspace(0.3, 0.9, 7)


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """A camera's clock beside the gauge's.

    Attributes
    ----------
    camera : str
    offset : float [s]              gauge's time less the camera's
    std : float [s]                 of the offset, from the presses' scatter; NaN: not measured
    correlation : float [-]         of the picture's changes with the force, over the recording
    scatter : float [s]             standard deviation of single presses' offsets; NaN: unknown
    hysteresis : tuple of float [-] of each press: how much larger the force is going in than coming
                                    out, at the same picture, as a share of the full force; NaN:
                                    unknown, as where the offset is found: an offset looks alike
    given : bool                    the offset was told, not found
    doubt : float [s] or None       another offset that fits nearly as well
    """

    camera: str
    offset: float
    std: float
    correlation: float
    scatter: float
    hysteresis: tuple[float, ...]
    given: bool = False
    doubt: float | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What is doubtful about it, as ends of sentences."""
        if self.doubt is None:
            return ()
        text = (
            f"camera {self.camera}: the clocks' offset is {self.offset:.3f} s, but {self.doubt:.1f}"
            " s fits nearly as well: the presses are too alike; make pauses of different length, or"
            " give `offset`"
        )
        return (text,)


@dataclass(frozen=True, slots=True, eq=False)
class SizeOfForce:
    """Size of the force without weight and drift, at even times of the gauge's clock."""

    time: Float[np.ndarray, " n"]
    size: Float[np.ndarray, " n"]

    def at(self, time: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Size at any times [N]."""
        return np.interp(time, self.time, self.size)


def coarse_offset(force: SizeOfForce, motion: CameraMotion) -> tuple[float, float, float | None]:
    """Offset at which the picture's changes go best with the force.

    Parameters
    ----------
    force : SizeOfForce
    motion : CameraMotion

    Returns
    -------
    offset : float [s]              to a fraction of a second: the tool moves in the air as well
    correlation : float [-]
    doubt : float [s] or None       the best offset far from it, where it is nearly as good

    Raises
    ------
    RecordError                     the picture does not go with the force anywhere
    """
    gauge = _even(force.time, force.size)
    camera = _even(motion.time, motion.change)
    # The correlation by its transform; scipy.signal would take every command half a second to load.
    size = len(gauge) + len(camera) - 1
    product = np.fft.irfft(np.fft.rfft(gauge, size) * np.fft.rfft(camera[::-1], size), size)
    # Entry [len(camera) - 1] is where both begin together.
    lag = np.arange(len(product)) - (len(camera) - 1)
    shared = np.minimum(len(gauge), lag + len(camera)) - np.maximum(lag, 0)
    product[shared < _OVERLAP * min(len(gauge), len(camera))] = -np.inf
    quality = product / max(float(np.linalg.norm(gauge) * np.linalg.norm(camera)), 1e-300)
    best = int(quality.argmax())
    correlation = float(quality[best])
    if correlation < _LEAST_CORRELATION:
        raise RecordError(
            f"camera '{motion.camera}': its pictures do not change with the force at any offset of"
            f" the clocks (correlation {correlation:.2f} at best; {_LEAST_CORRELATION} is needed):"
            " is it the video of these presses, and is the object in it? Give `offset` if the"
            " clocks are known"
        )
    begin = float(force.time[0] - motion.time[0])
    away = np.abs(lag - lag[best]) * _STEP > 2.0 * MARGIN
    other = int(np.where(away, quality, -np.inf).argmax())
    doubtful = away.any() and quality[other] > _DOUBT * correlation
    doubt = begin + float(lag[other]) * _STEP if doubtful else None
    return begin + float(lag[best]) * _STEP, correlation, doubt


def _even(time: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"]) -> np.ndarray:
    """Values at even times, without their mean."""
    even = np.interp(np.arange(time[0], time[-1], _STEP), time, values)
    return even - even.mean()


def fine_clock(
    coarse: tuple[float, float, float | None],
    force: SizeOfForce,
    touches: Sequence[Touch],
    ramps: Sequence[Ramp | None],
    camera: str,
) -> Clock:
    """The offset at which the same picture has the same force.

    Parameters
    ----------
    coarse : offset, correlation, doubt     of `coarse_offset`
    force : SizeOfForce
    touches, ramps : sequences      of the same presses
    camera : str

    Returns
    -------
    Clock

    Raises
    ------
    RecordError                     the camera saw none of the presses, or too few pictures of each
    """
    seen = [(t, r) for t, r in zip(touches, ramps, strict=True) if r is not None]
    if not seen:
        raise RecordError(
            f"camera '{camera}': its recording shows none of the {len(touches)} presses; is it"
            " shorter than the force log?"
        )

    def unexplained(offset: float) -> np.ndarray:
        return np.array([_unexplained(force, touch, ramp, offset) for touch, ramp in seen])

    offset, width, step = coarse[0], 0.9 * MARGIN, _FINE
    for _ in range(2):
        trial = offset + np.arange(-width, width + step / 2, step)
        cost = np.stack([unexplained(value) for value in trial])
        # Where no press is seen at some offset, nothing is known of it.
        known = np.isfinite(cost).any(axis=1)
        if not known.any():
            raise RecordError(
                f"camera '{camera}': its pictures lie too far apart to tell its clock, fewer than"
                f" {_FEWEST} of each press; is the frame rate right?"
            )
        mean = np.full(len(trial), np.nan)
        mean[known] = np.nanmean(cost[known], axis=1)
        offset = _lowest(trial, mean)
        width, step = 4.0 * _FINE, _LAST
    single = np.array([_lowest(trial, one) for one in cost.T if np.isfinite(one).all()])
    scatter = float(single.std(ddof=1)) if len(single) > 1 else np.nan
    unknown = (np.nan,) * len(touches)
    std = scatter / np.sqrt(max(len(single), 1))
    doubt = coarse[2]
    if doubt is not None and not _alike(touches, doubt - offset):
        doubt = None
    return Clock(camera, offset, std, coarse[1], scatter, unknown, doubt=doubt)


def _alike(touches: Sequence[Touch], shift: float) -> bool:
    """Whether the presses would follow each other as they do if they were others, so much later.

    Where the pauses differ, each press would ask for an offset of its own.
    """
    begin = np.array([touch.begin for touch in touches])
    away = begin[:, None] - (begin + shift)
    nearest = away[np.abs(away).argmin(axis=0), np.arange(len(begin))]
    inside = (begin + shift > begin[0] - MARGIN) & (begin + shift < begin[-1] + MARGIN)
    return inside.sum() < 2 or float(nearest[inside].std()) < _REGULAR


def _lowest(trial: Float[np.ndarray, " t"], cost: Float[np.ndarray, " t"]) -> float:
    """Where a parabola through the lowest value and its neighbours is lowest."""
    k = int(np.clip(np.nanargmin(cost), 1, len(trial) - 2))
    below, here, above = cost[k - 1 : k + 2]
    bend = below - 2.0 * here + above
    shift = 0.5 * (below - above) / bend if bend > 0.0 else 0.0
    return float(trial[k] + np.clip(shift, -1.0, 1.0) * (trial[1] - trial[0]))


def _in_contact(
    force: SizeOfForce, touch: Touch, ramp: Ramp, offset: float, least: float = _CONTACT
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, shares and forces of the frames in which the tool surely touches."""
    time = ramp.time + offset
    size = force.at(time)
    inside = (time > touch.begin) & (time < touch.end) & (size > least * touch.peak)
    return time[inside], ramp.share[inside], size[inside]


def _unexplained(force: SizeOfForce, touch: Touch, ramp: Ramp, offset: float) -> float:
    """Share of the force's variance that the picture does not tell; NaN: too little is seen."""
    _, share, size = _in_contact(force, touch, ramp, offset)
    if len(share) < _FEWEST:
        return np.nan
    law = np.vander(share, _ORDER + 1)
    rest = size - law @ np.linalg.lstsq(law, size, rcond=None)[0]
    return float(rest @ rest / max(float(np.square(size - size.mean()).sum()), 1e-300))


def hysteresis_of(force: SizeOfForce, touch: Touch, ramp: Ramp, offset: float) -> float:
    """How much larger the force is going in than coming out at the same picture.

    Only with clocks that are known: on even ramps an offset makes the same difference.

    Parameters
    ----------
    force : SizeOfForce
    touch, ramp : Touch, Ramp       of one press
    offset : float [s]              gauge's time less the camera's

    Returns
    -------
    float [-]                       mean over the way, share of the full force; NaN: too little seen
    """
    time, share, size = _in_contact(force, touch, ramp, offset, _KNOWN_CONTACT)
    middle = 0.5 * (touch.begin + touch.end)
    levels = []
    for rows in (time < middle, time > middle):
        if rows.sum() < 4:
            return np.nan
        order = np.argsort(share[rows])
        seen = share[rows][order]
        levels.append(np.interp(_COMPARED, seen, size[rows][order], left=np.nan, right=np.nan))
    difference = levels[0] - levels[1]
    known = np.isfinite(difference)
    return float(difference[known].mean() / touch.peak) if known.any() else np.nan

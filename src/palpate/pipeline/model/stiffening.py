"""The constants of a material at finite strain: its stiffening, and whether it is shown."""

from dataclasses import dataclass, replace

from scipy.special import ndtri

from palpate.estimation import FALSE_ALARM, FitResult
from palpate.records import HALF_95, Constant

# Its prior standard deviation: 1.8 times as stiff at 20 % shear; and its name among the errors.
STIFFENING_STD, STIFFENS = 10.0, "stiffening of the material"
# Standard deviations from which it counts as shown.
_SHOWN = -float(ndtri(0.5 * FALSE_ALARM))


@dataclass(frozen=True, slots=True)
class MaterialConstants:
    """Shear modulus [Pa], Poisson's ratio and stiffening of a material."""

    shear_modulus: float
    poisson_ratio: float
    stiffening: float = 0.0

    @property
    def young_modulus(self) -> float:
        """E = 2 G (1 + nu) [Pa]."""
        return 2.0 * self.shear_modulus * (1.0 + self.poisson_ratio)


def estimated_stiffening(result: FitResult) -> Constant:
    """Stiffening as a result estimates it; 0 before it was looked for."""
    minimum = result.minimum
    names = [parameter.name for parameter in minimum.problem.shared]
    if STIFFENS not in names:
        return Constant(0.0, 0.0, (0.0, 0.0))
    index = minimum.problem.layout.errors.start + names.index(STIFFENS)
    value, std = (
        STIFFENING_STD * float(values[index]) for values in (minimum.theta, minimum.normal.std)
    )
    low, high = value - HALF_95 * std, value + HALF_95 * std
    return Constant(value, std, (min(max(low, 0.0), value), max(high, 0.0)))


def damped(
    before: MaterialConstants, now: MaterialConstants, last: tuple[float, float]
) -> MaterialConstants:
    """Constants of the next correction: between the last two where the stiffening turns back, as
    it may else jump back and forth for ever.

    Parameters
    ----------
    before, now : MaterialConstants     of the last correction, and as estimated with it
    last : (float, float) [-]           stiffening of the correction before that, and as estimated
    """
    earlier, change = last[1] - last[0], now.stiffening - before.stiffening
    if change * earlier >= 0.0:
        return now
    # Where the change would be zero if it were linear in between.
    settled = (before.stiffening * earlier - last[0] * change) / (earlier - change)
    return replace(now, stiffening=settled)


def is_stiffening(stiffening: Constant) -> bool:
    """Whether an estimate shows that the material stiffens.

    Parameters
    ----------
    stiffening : Constant [-]
    """
    return stiffening.value > _SHOWN * stiffening.std

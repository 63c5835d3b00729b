"""Settings of an estimation; the defaults were chosen by measurement."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from palpate.errors import InputError
from palpate.estimation.noise import NOISE_MODELS


class FitMethod(StrEnum):
    """How the misfit is minimised: variable projection on tabulated responses, or a simplex."""

    REDUCED = "reduced"
    NELDER_MEAD = "nelder-mead"


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Settings of an estimation, stored with its result.

    Parameters
    ----------
    method : FitMethod, or its name
    noise : str                         name in `NOISE_MODELS`: "student-t" is robust to gross
                                        outliers, "gaussian" is plain least squares
    poisson_range : (float, float) [-]  prior range of Poisson's ratio, within [-0.99, 0.4999]

    Raises
    ------
    InputError                          unknown method or noise model, or range out of bounds
    """

    method: str = FitMethod.REDUCED.value
    noise: str = "student-t"
    poisson_range: tuple[float, float] = (0.0, 0.4999)

    def __post_init__(self) -> None:
        _check_choice("method", self.method, tuple(FitMethod))
        _check_choice("noise", self.noise, tuple(NOISE_MODELS))
        low, high = self.poisson_range
        if not (np.isfinite([low, high]).all() and -0.99 <= low < high <= 0.4999):
            raise InputError(
                f"poisson_range is {self.poisson_range}; both ends must be in [-0.99, 0.4999], the"
                " lower one first; use (0, 0.4999) for common solids, (-0.99, 0.4999) for auxetics"
            )


def _check_choice(name: str, value: str, allowed: tuple[str, ...]) -> None:
    """Refuse a name that is not among the allowed ones."""
    if value not in allowed:
        names = ", ".join(repr(str(choice)) for choice in allowed)
        raise InputError(f"{name} is {value!r}; must be one of {names}")

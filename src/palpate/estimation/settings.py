"""Everything that can be chosen about an estimation, with defaults that were measured."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from palpate.errors import InputError
from palpate.estimation.noise import NOISE_MODELS


class FitMethod(StrEnum):
    """How the misfit is minimised: variable projection on tabulated responses, or a simplex."""

    REDUCED = "reduced"
    NELDER_MEAD = "nelder-mead"


class IntervalMethod(StrEnum):
    """How the intervals are found."""

    FISHER = "fisher"
    PROFILE = "profile"
    BOOTSTRAP = "bootstrap"


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Choices of an estimation, stored with its result.

    Parameters
    ----------
    method : FitMethod, or its name
    interval : IntervalMethod, or its name
    noise : str                         name in `NOISE_MODELS`: "student-t" bears gross outliers,
                                        "gaussian" is plain least squares
    poisson_range : (float, float) [-]  prior range of Poisson's ratio, within [-0.99, 0.4999]
    model_error : float [-]             standard deviation of the model's stiffness as a whole, in
                                        [0, 1); the default is what half balls of 600 to 2500
                                        vertices show against finite elements
    displacement_error : float [-]      standard deviation of the measured displacements' scale as a
                                        whole, in each direction for itself, in [0, 1); the pipeline
                                        adds that of displacements that come from pictures

    Raises
    ------
    InputError                          a choice is out of its range
    """

    method: str = FitMethod.REDUCED.value
    interval: str = IntervalMethod.PROFILE.value
    noise: str = "student-t"
    poisson_range: tuple[float, float] = (0.0, 0.4999)
    model_error: float = 0.001
    displacement_error: float = 0.0

    def __post_init__(self) -> None:
        _check_choice("method", self.method, tuple(FitMethod))
        _check_choice("interval", self.interval, tuple(IntervalMethod))
        _check_choice("noise", self.noise, tuple(NOISE_MODELS))
        low, high = self.poisson_range
        if not (np.isfinite([low, high]).all() and -0.99 <= low < high <= 0.4999):
            raise InputError(
                f"poisson_range is {self.poisson_range}; both ends must be in [-0.99, 0.4999], the"
                " lower one first; use (0, 0.4999) for common solids, (-0.99, 0.4999) for auxetics"
            )
        if not 0 <= self.model_error < 1:
            raise InputError(
                f"model_error is {self.model_error}; must be in [0, 1): 0.001 is 0.1 % of G and E"
            )
        if not 0 <= self.displacement_error < 1:
            raise InputError(
                f"displacement_error is {self.displacement_error}; must be in [0, 1): 0.01 is 1 %"
                " of every displacement"
            )


def _check_choice(name: str, value: str, allowed: tuple[str, ...]) -> None:
    """Refuse a name that is not among the allowed ones."""
    if value not in allowed:
        names = ", ".join(repr(str(choice)) for choice in allowed)
        raise InputError(f"{name} is {value!r}; must be one of {names}")

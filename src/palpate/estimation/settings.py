"""Everything that can be chosen about an estimation, with defaults that were measured."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from palpate.errors import InputError

__all__ = ["FitMethod", "FitSettings", "IntervalMethod"]


class FitMethod(str, Enum):
    """How the misfit is minimised."""

    VARIABLE_PROJECTION = "variable-projection"
    NELDER_MEAD = "nelder-mead"


class IntervalMethod(str, Enum):
    """Which interval is reported; all are computed."""

    FISHER = "fisher"
    PROFILE = "profile"
    BOOTSTRAP = "bootstrap"


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Choices of an estimation, stored with its result.

    Parameters
    ----------
    method : FitMethod
    interval : IntervalMethod           the reported one
    poisson_range : (float, float) [-]  prior range of Poisson's ratio, within [-0.99, 0.4999]
    degrees : float                     of Student's t for a point's displacement, see `student_t`
    force_degrees : float               of Student's t for a probing's force
    rejection_weight : float            a point of smaller robust weight counts as rejected;
                                        0.25 is 4.9 sigma for three components
    bootstrap_count : int               resamples, 0 = none
    map_size : int                      grid points of the likelihood along each constant, 0 = none
    seed : int                          of the bootstrap

    Raises
    ------
    InputError                          a choice is out of its range
    """

    method: FitMethod = FitMethod.VARIABLE_PROJECTION
    interval: IntervalMethod = IntervalMethod.PROFILE
    poisson_range: tuple[float, float] = (0.0, 0.4999)
    degrees: float = 8.0
    force_degrees: float = 8.0
    rejection_weight: float = 0.25
    bootstrap_count: int = 500
    map_size: int = 51
    seed: int = 0

    def __post_init__(self) -> None:
        low, high = self.poisson_range
        if not (np.isfinite([low, high]).all() and -0.99 <= low < high <= 0.4999):
            raise InputError(
                f"poisson_range is {self.poisson_range}; both ends must be in [-0.99, 0.4999], the"
                " lower one first; use (0, 0.4999) for common solids, (-0.99, 0.4999) for auxetics"
            )
        if not (self.degrees >= 1 and self.force_degrees >= 1):
            raise InputError(
                f"degrees are {self.degrees} and {self.force_degrees}; both must be >= 1 (8 fits"
                " gross outliers, 1e6 is plain least squares)"
            )
        if not 0 <= self.rejection_weight < 1:
            raise InputError(f"rejection_weight is {self.rejection_weight}; must be in [0, 1)")
        if self.bootstrap_count < 0 or self.map_size < 0:
            raise InputError(
                f"bootstrap_count is {self.bootstrap_count}, map_size {self.map_size}; both must be"
                " >= 0 (0 leaves them out)"
            )

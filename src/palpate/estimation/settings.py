"""Everything that can be chosen about an estimation, with defaults that were measured."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from palpate.errors import InputError


class FitMethod(StrEnum):
    """How the misfit is minimised: variable projection on tabulated responses, or a simplex."""

    REDUCED = "reduced"
    NELDER_MEAD = "nelder-mead"


class IntervalMethod(StrEnum):
    """Which interval is reported; all are computed."""

    FISHER = "fisher"
    PROFILE = "profile"
    BOOTSTRAP = "bootstrap"


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Choices of an estimation, stored with its result.

    Parameters
    ----------
    method : FitMethod, or its name
    interval : IntervalMethod, or its name           the reported one
    poisson_range : (float, float) [-]  prior range of Poisson's ratio, within [-0.99, 0.4999]
    degrees : float                     of Student's t for a point's displacement, see `student_t`
    force_degrees : float               of Student's t for a probing's force
    rejection_weight : float            a point of smaller robust weight counts as rejected;
                                        0.25 is 4.9 sigma for three components
    model_error : float [-]             standard deviation of the model's stiffness as a whole; the
                                        default is what half balls of 600 to 2500 vertices show
                                        against finite elements
    displacement_error : float [-]      standard deviation of the measured displacements' scale as a
                                        whole, in each direction for itself; the pipeline fills it
                                        in for displacements that come from pictures
    bootstrap_count : int               resamples, 0 = none
    map_size : int                      grid points of the likelihood along each constant, >= 2
    seed : int                          of the bootstrap

    Raises
    ------
    InputError                          a choice is out of its range
    """

    method: str = FitMethod.REDUCED
    interval: str = IntervalMethod.PROFILE
    poisson_range: tuple[float, float] = (0.0, 0.4999)
    degrees: float = 8.0
    force_degrees: float = 8.0
    rejection_weight: float = 0.25
    model_error: float = 0.001
    displacement_error: float = 0.0
    bootstrap_count: int = 500
    map_size: int = 51
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "method", _member(FitMethod, "method", self.method))
        object.__setattr__(self, "interval", _member(IntervalMethod, "interval", self.interval))
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
        if not 0 <= self.model_error < 1:
            raise InputError(
                f"model_error is {self.model_error}; must be in [0, 1): 0.001 is 0.1 % of G and E"
            )
        if not 0 <= self.displacement_error < 1:
            raise InputError(f"displacement_error is {self.displacement_error}; must be in [0, 1)")
        if self.bootstrap_count < 0 or self.map_size < 2:
            raise InputError(
                f"bootstrap_count is {self.bootstrap_count} and must be >= 0 (0 leaves it out);"
                f" map_size is {self.map_size} and must be >= 2"
            )
        if self.interval == IntervalMethod.BOOTSTRAP and not self.bootstrap_count:
            raise InputError("interval is 'bootstrap', so bootstrap_count must be > 0; try 500")


def _member(kind: type[StrEnum], name: str, value: str) -> StrEnum:
    """Member of an enumeration from its value."""
    try:
        return kind(value)
    except ValueError as error:
        allowed = ", ".join(repr(member.value) for member in kind)
        raise InputError(f"{name} is {value!r}; must be one of {allowed}") from error

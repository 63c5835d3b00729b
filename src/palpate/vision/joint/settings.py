"""How range flow is measured by the method `joint`."""

from dataclasses import dataclass
from typing import Literal

from palpate.errors import InputError


@dataclass(frozen=True, slots=True)
class JointSettings:
    """Windows and limits of the joint matching.

    Parameters
    ----------
    subset : int [px]               side of the window, odd; more is less noise and less detail
    step : int [px]                 spacing of the points in the reference camera
    shape : "shift", "affine" or "quadratic"    what a window itself says of its motion; the
                                    derivatives beyond are its neighbours' word, so that a window
                                    sees no bias where the surface stretches, turns or bends
    smoothing : float [px]          Gaussian low-pass of every picture before it is matched, against
                                    the bias of structure finer than the pixels
    turning : float                 median derivative of the motion above which pictures are matched
                                    unsmoothed: the low-pass is tied to the pixels and does not turn
                                    and stretch with the surface; 0.03 is a turn of 1.7 degrees
    tolerance : float [px]          a step shorter than this ends the iteration; far below the noise
    iterations : int                at most so many
    reach : float [px]              a window that leaves its start by more than this is lost
    least_share : float             share of the window that must show the surface at rest
    shading : bool                  whether the light on a window may vary linearly from one picture
                                    to the next, besides gain and offset: moving objects turn in the
                                    light, tools cast soft shadows
    excess : float                  a camera is dropped, then the point, where what is left after
                                    the match is more than this many times what it is elsewhere
    disagreement : float            a point is dropped where the cameras or the neighbours
                                    contradict it by more than this many standard deviations
    bias : float [px]               systematic error of one camera's match that no residual shows
                                    (interpolation, response of the pixels), part of every
                                    covariance

    Raises
    ------
    InputError                      an even or tiny subset, a step below one pixel
    """

    subset: int = 21
    step: int = 5
    shape: Literal["shift", "affine", "quadratic"] = "affine"
    smoothing: float = 1.0
    turning: float = 0.03
    tolerance: float = 1e-3
    iterations: int = 25
    reach: float = 6.0
    least_share: float = 0.6
    shading: bool = True
    excess: float = 2.0
    disagreement: float = 5.0
    bias: float = 0.005

    def __post_init__(self) -> None:
        if self.subset < 5 or self.subset % 2 == 0:
            raise InputError(f"subset is {self.subset}; must be an odd number of pixels, 5 or more")
        if self.step < 1:
            raise InputError(f"step is {self.step}; must be 1 pixel or more")

"""How range flow is measured by the method `lang-pai`."""

from dataclasses import dataclass, field

from palpate.errors import InputError
from palpate.vision.lang_pai.disparity import DisparitySettings


@dataclass(frozen=True, slots=True)
class LangPaiSettings:
    """Windows and limits of the paper's method, by its own figures where it gives them.

    Parameters
    ----------
    subset : int [px]               side of the window of the optical flow, odd; the paper's 7
    search : int [px]               side of the square that is searched at the next instant, odd;
                                    the paper's 13, for motions of up to 6 px between instants
    step : int [px]                 spacing of the points in the reference camera; the paper tracks
                                    every pixel
    least_score : float [-]         mean correlation below which nothing is matched; the paper has
                                    no such limit, 0 refuses only what looks like a negative
    surface_tolerance : float [px]  disparity by which a pixel may miss that of the mesh and still
                                    show it; matching by whole pixels errs by less than one
    travel : float [-]              share of the mesh's bounding diagonal by which the surface may
                                    be nearer or farther, for the range of disparities
    stereo : DisparitySettings
    reach : float [m]               flow no farther from a vertex speaks for it; the paper's 1 cm
    distance_unit : float [m]       unit of d in the weight 1 / (1 + d); lengths are in cm in the
                                    paper's tables
    outlier : float [-]             standard deviations beyond which flow is rejected; the paper's 3
    trials : int                    motions around a vertex that are tried as least median

    Raises
    ------
    InputError                      a size, range or tolerance that makes no sense
    """

    subset: int = 7
    search: int = 13
    step: int = 1
    least_score: float = 0.0
    surface_tolerance: float = 1.0
    travel: float = 0.5
    stereo: DisparitySettings = field(default_factory=DisparitySettings)
    reach: float = 0.01
    distance_unit: float = 0.01
    outlier: float = 3.0
    trials: int = 100

    def __post_init__(self) -> None:
        for name in ("subset", "search"):
            value = getattr(self, name)
            if value < 3 or value % 2 == 0:
                raise InputError(f"{name} is {value}; must be an odd number of pixels, 3 or more")
        for name in ("step", "trials"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}; must be 1 or more")
        for name in ("surface_tolerance", "reach", "distance_unit", "outlier", "travel"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name} is {getattr(self, name):g}; must be positive")

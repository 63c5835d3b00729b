"""Variances that combine a claimed and an observed part, and the quantiles that go with them."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

# Degrees of freedom that a claimed variance counts for in the mean with the observed scatter. Where
# the claimed uncertainty is half the true one, intervals from two to five probings hold in 93 % (by
# simulation); 2 give 91 %, 3 give 88 %.
_CLAIM_DEGREES = 1.0
_UPPER_TAIL = 0.975


@dataclass(frozen=True, slots=True)
class Variance:
    """Variance of a combination of the constants.

    Parameters
    ----------
    independent : float         from errors that differ between probings
    shared : float              from errors that all probings have in common
    degrees : float             degrees of freedom of `independent`
    """

    independent: float
    shared: float
    degrees: float

    @property
    def total(self) -> float:
        """Sum of the independent and the shared variance."""
        return self.independent + self.shared

    @property
    def quantile(self) -> float:
        """Half-width of a 95 % interval in standard deviations: that of Student's t, 1.96 where the
        variance is known.

        Source
        ------
        Satterthwaite, An approximate distribution of estimates of variance components, Biometrics
        Bulletin 2 (1946).
        """
        if self.degrees == np.inf or self.independent == 0.0:
            return float(ndtri(_UPPER_TAIL))
        degrees = self.degrees * (self.total / self.independent) ** 2
        return float(stdtrit(degrees, _UPPER_TAIL))


@dataclass(frozen=True, slots=True)
class Scatter:
    """Observed scatter of probings, or of blocks of points, relative to the claimed variance.

    Parameters
    ----------
    ratio : float [-]           observed over claimed variance, >= 0
    degrees : float             degrees of freedom; for equally informative probings one less than
                                their number
    """

    ratio: float
    degrees: float

    @property
    def factor(self) -> float:
        """Factor on the claimed variance: the mean of 1 (the claim) and `ratio` (the scatter), each
        weighted by its degrees of freedom."""
        return (_CLAIM_DEGREES + self.degrees * self.ratio) / (_CLAIM_DEGREES + self.degrees)

    @property
    def total_degrees(self) -> float:
        """Degrees of freedom of `factor`; infinite where there is only the claim."""
        return _CLAIM_DEGREES + self.degrees if self.degrees > 0.0 else np.inf


NO_SCATTER = Scatter(1.0, 0.0)

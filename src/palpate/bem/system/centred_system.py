"""A system factorised at one Poisson's ratio, from which its solutions at all ratios follow."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palpate.bem.system.factors import FactorisedSystem, factorise_with_slope, system_elimination
from palpate.bem.system.slope import SystemSlope
from palpate.bem.system.system import BoundarySystem, Precision
from palpate.parts import content_digest

# Unknowns above which factors in single precision, half the work, save time worth mentioning, and
# up to which the condition usually allows them: that of a lump of 31 000 did not.
_SMALLEST_SINGLE, _LARGEST_SINGLE = 3000, 15_000
# Reciprocal condition above which their solutions have errors below 1e-4. A beam of 24 by 24 by
# 120 mm has 5e-8 and an error of 6e-6; plates of 60 by 40 mm that are held at an end have 3e-8 and
# 4e-5 (5 mm thick), 6e-10 and 6e-4 (2 mm).
_SMALLEST_SINGLE_RCOND = 1e-8


@dataclass(frozen=True, eq=False)
class CentredSystem:
    """A dense system with its factors at one Poisson's ratio and the derivative of its matrix, both
    computed when they are first needed, or read from the system's `parts`.

    Attributes
    ----------
    system : BoundarySystem
    poisson_ratio : float       -1 < nu <= 0.5
    single : bool               True: solutions may have relative errors of 1e-4; in single
                                precision, then, where that is faster and the condition of the
                                system allows it

    Raises
    ------
    SingularSystemError         as `factorise`, when the factors are first needed
    """

    system: BoundarySystem
    poisson_ratio: float
    single: bool = False

    @property
    def factorised(self) -> FactorisedSystem:
        """The factors."""
        return self._factors_and_slope[0]

    @property
    def slope(self) -> SystemSlope:
        """The derivative of the matrix with respect to Poisson's ratio."""
        return self._factors_and_slope[1]

    @cached_property
    def _factors_and_slope(self) -> tuple[FactorisedSystem, SystemSlope]:
        name = content_digest(("factors", self.poisson_ratio, self.single))
        factorised, slope = self.system.parts.load_or_make(name, self._compute)
        return replace(factorised, elimination=system_elimination(self.system)), slope

    def _compute(self) -> tuple[FactorisedSystem, SystemSlope]:
        """Both, without the elimination, which holds sparse matrices and is made in no time."""
        if self.single and _SMALLEST_SINGLE < self.system.size <= _LARGEST_SINGLE:
            found = self._compute_in(np.float32)
            if found[0].reciprocal_condition > _SMALLEST_SINGLE_RCOND:
                return found
            del found
        return self._compute_in(np.float64)

    def _compute_in(self, precision: Precision) -> tuple[FactorisedSystem, SystemSlope]:
        found, slope = factorise_with_slope(self.system, self.poisson_ratio, precision=precision)
        return replace(found, elimination=None), slope

"""A system factorised at one Poisson's ratio, from which its solutions at all ratios follow."""

from dataclasses import dataclass

import numpy as np

from palpate.bem.system.large_lu import LARGEST_WHOLE
from palpate.bem.system.slope import SystemSlope, system_slope
from palpate.bem.system.system import BoundarySystem, FactorisedSystem, factorise

# Unknowns above which factors in single precision, half the work, save time worth mentioning.
_SMALLEST_SINGLE = 3000
# Reciprocal condition above which their solutions have errors below 1e-4. A beam of 24 by 24 by
# 120 mm has 5e-8 and an error of 6e-6; plates of 60 by 40 mm that are held at an end have 3e-8 and
# 4e-5 (5 mm thick), 6e-10 and 6e-4 (2 mm).
_SMALLEST_SINGLE_RCOND = 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class CentredSystem:
    """A dense system factorised at one Poisson's ratio, with the derivative of its matrix.

    Attributes
    ----------
    factorised : FactorisedSystem
    slope : SystemSlope
    """

    factorised: FactorisedSystem
    slope: SystemSlope


def centred_system(
    system: BoundarySystem, poisson_ratio: float, *, single: bool = False
) -> CentredSystem:
    """Factorise a system at one Poisson's ratio, and derive it there.

    Parameters
    ----------
    system : BoundarySystem
    poisson_ratio : float     -1 < nu <= 0.5
    single : bool             True: solutions may have relative errors of 1e-4; in single precision,
                              then, where that is faster and the condition of the system allows it

    Returns
    -------
    CentredSystem

    Raises
    ------
    SingularSystemError       as `factorise`
    """
    if single and _SMALLEST_SINGLE < system.size <= LARGEST_WHOLE:
        factorised = factorise(system, poisson_ratio, precision=np.float32)
        if factorised.reciprocal_condition > _SMALLEST_SINGLE_RCOND:
            return CentredSystem(factorised, system_slope(system, precision=np.float32))
        del factorised
    return CentredSystem(factorise(system, poisson_ratio), system_slope(system))

"""Elastic constants of an estimate, with the covariance implied by its standard deviations."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.arrays import fixed_array
from palpate.errors import InputError
from palpate.records import Estimate


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """Elastic constants with their covariance.

    Parameters
    ----------
    shear_modulus : float [Pa]          > 0
    poisson_ratio : float [-]           -1 < nu <= 0.5
    covariance : (2, 2) float           of shear modulus [Pa] and Poisson's ratio; zero: exact

    Raises
    ------
    InputError                          constants out of range, an invalid covariance
    """

    shear_modulus: float
    poisson_ratio: float
    covariance: Float[np.ndarray, "2 2"]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.shear_modulus) and self.shear_modulus > 0.0):
            raise InputError(f"shear_modulus is {self.shear_modulus}; must be positive, in pascals")
        if not -1.0 < self.poisson_ratio <= 0.5:
            raise InputError(f"poisson_ratio is {self.poisson_ratio}; must be in (-1, 0.5]")
        fixed = fixed_array(self.covariance, name="covariance", shape=(2, 2))
        (a, b), (c, d) = fixed
        if b != c or min(a, d) < 0.0 or a * d - b * c < -1e-9 * a * d:
            raise InputError(
                "covariance must be that of shear modulus and Poisson's ratio: symmetric, without"
                f" negative variances; got {fixed.tolist()}"
            )
        object.__setattr__(self, "covariance", fixed)

    @property
    def young_modulus(self) -> float:
        """E = 2 G (1 + nu) [Pa]."""
        return 2.0 * self.shear_modulus * (1.0 + self.poisson_ratio)


def exact_material(shear_modulus: float, poisson_ratio: float) -> Material:
    """Elastic constants without uncertainty.

    Parameters
    ----------
    shear_modulus : float [Pa]
    poisson_ratio : float [-]

    Returns
    -------
    Material
    """
    return Material(shear_modulus, poisson_ratio, np.zeros((2, 2)))


def estimated_material(estimate: Estimate) -> Material:
    """The constants of an estimate.

    The covariance of G and nu follows from the three standard deviations, since
    dE = 2 (1 + nu) dG + 2 G dnu. The standard deviation of a constant that the data do not
    determine is NaN; that of a uniform distribution over its interval is used instead, without
    correlation.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    Material

    Raises
    ------
    InputError                          the estimate has no value, or no finite interval, for a
                                        constant
    """
    shear, ratio, young = estimate.shear_modulus, estimate.poisson_ratio, estimate.young_modulus
    if not np.isfinite([shear.value, ratio.value]).all():
        raise InputError(
            "the estimate has no value of the shear modulus or of Poisson's ratio; give a material"
        )
    stds = []
    for name, one in (("shear modulus", shear), ("Poisson's ratio", ratio)):
        std = one.std if np.isfinite(one.std) else (one.ci95[1] - one.ci95[0]) / np.sqrt(12.0)
        if not np.isfinite(std):
            raise InputError(
                f"the data do not bound the {name}: a prediction would have no uncertainty; measure"
                " more, or give a material"
            )
        stds.append(float(std))
    by_shear, by_ratio = 2 * (1 + ratio.value) * stds[0], 2 * shear.value * stds[1]
    correlation = 0.0
    if by_shear > 0.0 and by_ratio > 0.0 and np.isfinite(young.std):
        left = young.std**2 - by_shear**2 - by_ratio**2
        correlation = float(np.clip(left / (2 * by_shear * by_ratio), -1.0, 1.0))
    cross = correlation * stds[0] * stds[1]
    covariance = np.array([[stds[0] ** 2, cross], [cross, stds[1] ** 2]])
    return Material(shear.value, ratio.value, covariance)

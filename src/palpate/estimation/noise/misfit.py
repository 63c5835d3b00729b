"""Misfit between measured and predicted displacement, over all probings together.

A measured force is an observation like any other: F_measured = F + noise, with the true force F
unknown. For given constants the true forces are eliminated probing by probing (profile likelihood
of a functional errors-in-variables model). No normaliser of an integral over F enters: it would
favour large moduli by three force variances over the squared force for every probing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.errors import NotConvergedError
from palpate.estimation.noise.student_t import loss_of, weight_of
from palpate.estimation.observations import ObservedRows

_FORCE_ITERATIONS = 200
_FORCE_TOLERANCE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class ScaledRows:
    """Response and measurement of one probing in units of the noise.

    Parameters
    ----------
    measured : (r,) float [-]
    base : (r, 4) float [Pa/N]      response at a reference Poisson's ratio, column 3 [Pa]
    slope : (r, 4) float            its derivative with respect to Poisson's ratio, zero where not
                                    asked for
    """

    measured: Float[np.ndarray, " r"]
    base: Float[np.ndarray, "r 4"]
    slope: Float[np.ndarray, "r 4"]


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """Minus twice the log likelihood of the constants, true forces eliminated.

    Parameters
    ----------
    probes : tuple of ObservedRows
    level : (8,) float                      noise level of each group, see `noise_levels`
    sigma : tuple of (r,) float [m]         1 sigma of every row
    degrees : float                         of Student's t for a point's displacement
    force_degrees : float                   of Student's t for a probing's force
    """

    probes: tuple[ObservedRows, ...]
    level: Float[np.ndarray, " 8"]
    sigma: tuple[Float[np.ndarray, " _"], ...]
    degrees: float
    force_degrees: float

    def __call__(self, poisson_ratio: float, shear_modulus: float) -> float:
        """Misfit at given constants, the best true force taken for every probing.

        Parameters
        ----------
        poisson_ratio : float [-]
        shear_modulus : float [Pa]

        Returns
        -------
        float [-]

        Raises
        ------
        NotConvergedError                   the force of a probing did not settle
        """
        total = 0.0
        for probe, sigma in zip(self.probes, self.sigma, strict=True):
            rows = scaled_rows(probe, sigma, poisson_ratio)
            total += self._eliminated(probe, rows, shear_modulus)
        return total

    def _eliminated(self, probe: ObservedRows, rows: ScaledRows, shear_modulus: float) -> float:
        """Loss of one probing at its best true force, by reweighted least squares."""
        base = rows.base / shear_modulus
        plain = rows.measured - base[:, :3] @ probe.force - base[:, 3]
        push = base[:, :3] * probe.force_std
        count = force_components(probe)
        shift = np.zeros(3)
        for _ in range(_FORCE_ITERATIONS):
            residual = plain - push @ shift
            squared = np.add.reduceat(residual**2, probe.start)
            if not count:
                return loss_of(squared, probe.components, degrees=self.degrees)
            weight = weight_of(squared, probe.components, degrees=self.degrees)
            force_weight = (self.force_degrees + count) / (self.force_degrees + shift @ shift)
            weighted = push * np.repeat(weight, probe.components.astype(np.int64))[:, None]
            normal = weighted.T @ push + force_weight * np.eye(3)
            step = np.linalg.solve(normal, weighted.T @ residual - force_weight * shift)
            shift = shift + step
            if np.abs(step).max() < _FORCE_TOLERANCE * (1 + np.abs(shift).max()):
                residual = plain - push @ shift
                squared = np.add.reduceat(residual**2, probe.start)
                force = np.log1p(shift @ shift / self.force_degrees)
                points = loss_of(squared, probe.components, degrees=self.degrees)
                return points + (self.force_degrees + count) * float(force)
        raise NotConvergedError(
            f"probing {probe.name!r}: the true force did not settle in {_FORCE_ITERATIONS} steps;"
            " check force_std against the force"
        )


def with_levels(
    probes: Sequence[ObservedRows],
    level: Float[np.ndarray, " 8"],
    *,
    degrees: float,
    force_degrees: float,
) -> Misfit:
    """Misfit for given noise levels.

    Parameters
    ----------
    probes : sequence of ObservedRows
    level : (8,) float                      see `noise_levels`
    degrees, force_degrees : float          of Student's t for displacements and forces
    """
    sigma = tuple(probe.unit * level[probe.group] for probe in probes)
    return Misfit(tuple(probes), level, sigma, degrees, force_degrees)


def scaled_rows(
    probe: ObservedRows,
    sigma: Float[np.ndarray, " r"],
    poisson_ratio: float,
    *,
    with_slope: bool = False,
) -> ScaledRows:
    """Rows of a probing in units of the noise, the response taken at one Poisson's ratio."""
    base = probe.value(poisson_ratio) / sigma[:, None]
    slope = probe.slope(poisson_ratio) / sigma[:, None] if with_slope else np.zeros_like(base)
    return ScaledRows(probe.measured / sigma, base, slope)


def force_components(probe: ObservedRows) -> int:
    """How many components of the force are uncertain."""
    return int(np.count_nonzero(probe.force_std))

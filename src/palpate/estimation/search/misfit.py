"""Misfit between measured and predicted displacement, over all probings together.

A measured force is an observation like any other: F_measured = F + noise, with the true force F
unknown. For given constants the true forces are eliminated probing by probing (profile likelihood
of a functional errors-in-variables model), and with them the motions of supports that are not
known. No normaliser of an integral over F enters: it would favour large moduli by three force
variances over the squared force for every probing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.errors import NotConvergedError
from palpate.estimation.noise import NoiseModel
from palpate.estimation.observations import ObservedRows

_MAX_FORCE_STEPS = 200
_FORCE_TOLERANCE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class ScaledRows:
    """Response and measurement of one probing in units of the noise.

    Parameters
    ----------
    probe : ObservedRows
    measured : (r,) float [-]
    base : (r, c) float             response at a reference Poisson's ratio, over the noise
    slope : (r, c) float            its derivative with respect to Poisson's ratio, zero where not
                                    asked for
    """

    probe: ObservedRows
    measured: Float[np.ndarray, " r"]
    base: Float[np.ndarray, "r c"]
    slope: Float[np.ndarray, "r c"]


@dataclass(frozen=True, slots=True, eq=False)
class LocalProbe:
    """One probing linearised at given constants, true force and motions, in units of the noise.

    Parameters
    ----------
    rows : ObservedRows
    table : (r, 3 + n) float        slope of the prediction in nu, log G and the n shifts, and last
                                    the residual, measured minus predicted
    squared : (p,) float            squared residual of every point
    weight : (p,) float             robust weight of every point
    shift : (n,) float              true minus measured force, then the same of the motions of
                                    supports, in sigmas
    force_weight : float            robust weight of the measured force
    loss : float                    contribution to the misfit
    """

    rows: ObservedRows
    table: Float[np.ndarray, "r t"]
    squared: Float[np.ndarray, " p"]
    weight: Float[np.ndarray, " p"]
    shift: Float[np.ndarray, " n"]
    force_weight: float
    loss: float

    @property
    def design(self) -> Float[np.ndarray, "r d"]:
        """Slope of the prediction."""
        return self.table[:, :-1]

    @property
    def residual(self) -> Float[np.ndarray, " r"]:
        """Measured minus predicted."""
        return self.table[:, -1]

    @property
    def prior(self) -> Float[np.ndarray, " n"]:
        """Weight of what was known before about each shift."""
        return self.rows.prior(self.force_weight)

    def weighted_products(self) -> Float[np.ndarray, "t t"]:
        """Products of the table's columns under the robust weights, table' W table."""
        # One small product: a product with a vector would be threaded, at ten times the cost.
        return (self.table * self.rows.per_row(self.weight)[:, None]).T @ self.table


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """Minus twice the log likelihood of the constants, true forces eliminated.

    Parameters
    ----------
    probes : tuple of ObservedRows
    level : (8,) float                      noise level of each group, see `noise_levels`
    noise : NoiseModel                      of a point's displacement and of a probing's force
    """

    probes: tuple[ObservedRows, ...]
    level: Float[np.ndarray, " 8"]
    noise: NoiseModel

    def __call__(self, poisson_ratio: float, shear_modulus: float) -> float:
        """Misfit at given constants, the best true force taken for every probing.

        Parameters
        ----------
        poisson_ratio : float [-]
        shear_modulus : float [Pa]      > 0

        Returns
        -------
        float [-]

        Raises
        ------
        NotConvergedError                   the force of a probing did not settle
        """
        return sum(
            _at_best_force(self.noise, rows, shear_modulus).loss
            for rows in self.scaled(poisson_ratio, with_slope=False)
        )

    def at_best_forces(self, poisson_ratio: float, shear_modulus: float) -> tuple[LocalProbe, ...]:
        """Every probing linearised at given constants and its best true force.

        Parameters
        ----------
        poisson_ratio : float [-]
        shear_modulus : float [Pa]      > 0

        Raises
        ------
        NotConvergedError                   the force of a probing did not settle
        """
        return tuple(
            _at_best_force(self.noise, rows, shear_modulus) for rows in self.scaled(poisson_ratio)
        )

    def scaled(self, poisson_ratio: float, *, with_slope: bool = True) -> list[ScaledRows]:
        """Rows of every probing in units of the noise, the response taken at one Poisson's ratio.

        Parameters
        ----------
        poisson_ratio : float [-]
        with_slope : bool               False: the derivative is left at zero

        Returns
        -------
        list of ScaledRows              one for each probing
        """
        scaled = []
        for probe in self.probes:
            sigma = probe.sigma(self.level)
            base = probe.value(poisson_ratio) / sigma[:, None]
            slope = np.zeros_like(base)
            if with_slope:
                slope = probe.slope(poisson_ratio) / sigma[:, None]
            scaled.append(ScaledRows(probe, probe.measured / sigma, base, slope))
        return scaled

    def linearised(
        self,
        rows: Sequence[ScaledRows],
        offset: float,
        shear_modulus: float,
        shifts: Sequence[Float[np.ndarray, " n"]],
    ) -> tuple[LocalProbe, ...]:
        """Every probing at nu = reference + offset, a shear modulus, true forces and motions.

        Parameters
        ----------
        rows : sequence of ScaledRows   response and slope at the reference
        offset : float [-]              in Poisson's ratio
        shear_modulus : float [Pa]      > 0
        shifts : one (n,) float for each probing    see `LocalProbe.shift`
        """
        return tuple(
            _linearised(self.noise, row, offset, shear_modulus, shift)
            for row, shift in zip(rows, shifts, strict=True)
        )


def _linearised(
    noise: NoiseModel,
    rows: ScaledRows,
    offset: float,
    shear_modulus: float,
    shift: Float[np.ndarray, " n"],
) -> LocalProbe:
    probe = rows.probe
    response = rows.base if offset == 0 else rows.base + offset * rows.slope
    load = probe.load(shear_modulus, shift)
    pushed = response[:, :4] @ load[:4]
    table = np.empty((len(pushed), 3 + len(shift)))
    table[:, 0] = rows.slope @ load
    np.negative(pushed, out=table[:, 1])
    table[:, 2:-1] = probe.per_shift(response, shear_modulus)
    np.subtract(rows.measured, pushed + response[:, 4:] @ load[4:], out=table[:, -1])
    squared = probe.squared_length(table[:, -1])
    length = np.array([shift[:3] @ shift[:3]])
    count = np.array([float(probe.force_components)])
    loss = noise.loss(squared, probe.components).sum() + noise.loss(length, count).sum()
    loss += shift[3:] @ shift[3:]
    return LocalProbe(
        rows=probe,
        table=table,
        squared=squared,
        weight=noise.weight(squared, probe.components),
        shift=shift,
        force_weight=float(noise.weight(length, count)[0]),
        loss=float(loss),
    )


def _at_best_force(noise: NoiseModel, rows: ScaledRows, shear_modulus: float) -> LocalProbe:
    """One probing at its best true force and motions, by reweighted least squares."""
    shift = np.zeros(3 + len(rows.probe.motion))
    for _ in range(_MAX_FORCE_STEPS):
        local = _linearised(noise, rows, 0.0, shear_modulus, shift)
        products = local.weighted_products()
        normal = products[2:-1, 2:-1] + np.diag(local.prior)
        step = np.linalg.solve(normal, products[2:-1, -1] - local.prior * shift)
        shift = shift + step
        if np.abs(step).max() < _FORCE_TOLERANCE * (1 + np.abs(shift).max()):
            return _linearised(noise, rows, 0.0, shear_modulus, shift)
    raise NotConvergedError(
        f"probing {rows.probe.name!r}: the true force did not settle in {_MAX_FORCE_STEPS} steps;"
        " check force_std against the force"
    )

"""The measured components of a probing as one stack of rows, ready for the misfit."""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array

from palpate.errors import InputError
from palpate.estimation.observations import NuisanceParameter, ProbeObservations
from palpate.records import INDEPENDENT

# Noise groups: x, y, z of the field and the tip without a claimed std, then the same with one.
GROUP_COUNT = 8
FIRST_CLAIMED = 4
TIP_GROUP = 3
GROUP_NAMES = ("x", "y", "z", "the tip")


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredComponents:
    """The measured components of one probing as one stack of rows, ready for the misfit.

    A point has up to three rows, which share one robust weight: a wrong match spoils all of them.
    Where a point's covariance is known, its three rows are whitened: combined so that their errors
    are independent and of equal variance.

    Parameters
    ----------
    observations : ProbeObservations
    rows : (r,) int                         rows of the response that were measured
    measured : (r,) float [m]               whitened, as are the rows that its methods return
    unit : (r,) float [m]                   claimed 1 sigma, or 1 where the level is estimated
    group : (r,) int                        noise group, see GROUP_COUNT
    start : (p,) int                        first row of each point
    components : (p,) float                 measured components of each point, 1 to 3
    point : (p,) int                        index of the point in the probing; n = the tip
    position : (p, 3) float [m]             NaN for the tip
    whitening : (k, 3, 3) float [-]         matrices of the first k points, which have three rows
                                            each: covariance^(-1/2) times `unit`; none of the others
    neighbours : (r, r) sparse or None      error correlation of the rows of neighbouring points,
                                            zero on the diagonal; None: errors are independent
    """

    observations: ProbeObservations
    rows: Int[np.ndarray, " r"]
    measured: Float[np.ndarray, " r"]
    unit: Float[np.ndarray, " r"]
    group: Int[np.ndarray, " r"]
    start: Int[np.ndarray, " p"]
    components: Float[np.ndarray, " p"]
    point: Int[np.ndarray, " p"]
    position: Float[np.ndarray, "p 3"]
    whitening: Float[np.ndarray, "k 3 3"]
    neighbours: csr_array | None

    @property
    def name(self) -> str:
        """Name of the probing."""
        return self.observations.name

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """Nuisance parameters of the probing, in the order of its nuisances."""
        nuisances = self.observations.nuisances
        return tuple(parameter for nuisance in nuisances for parameter in nuisance.parameters)

    @property
    def has_claims(self) -> bool:
        """Whether every measured row came with a standard deviation of its own."""
        return bool((self.group >= FIRST_CLAIMED).all())

    def everywhere(self) -> "MeasuredComponents":
        """All rows of the probing, as if every point had been measured, with nothing moved."""
        seen, tip = self.observations, self.observations.tip_displacement
        return observed_rows_of(replace(
            seen, displacement=np.zeros_like(seen.position), std=None, covariance=None,
            tip_displacement=None if tip is None else np.zeros(3), tip_displacement_std=None,
            correlation=INDEPENDENT,
        ))  # fmt: skip

    @property
    def point_of_row(self) -> Int[np.ndarray, " r"]:
        """Number of the point that each row belongs to, among the measured ones."""
        return np.repeat(np.arange(len(self.start)), self.components.astype(np.int64))

    @property
    def component_of_row(self) -> Int[np.ndarray, " r"]:
        """0, 1 or 2: along x, y or z."""
        return self.rows % 3

    def component_products(self, weight: Float[np.ndarray, " r"]) -> Float[np.ndarray, "p 3 3"]:
        """Weight of each pair of a point's components as measured, from weights of its rows."""
        products = np.zeros((len(self.start), 3, 3))
        products[self.point_of_row, self.component_of_row, self.component_of_row] = weight
        k = len(self.whitening)
        products[:k] = self.whitening @ products[:k] @ self.whitening
        return products

    def sigma(self, level: Float[np.ndarray, " 8"]) -> Float[np.ndarray, " r"]:
        """1 sigma of every row, (r,) [m], at the noise level of each group, (8,)."""
        return self.unit * level[self.group]

    def whitened(self, rows: Float[np.ndarray, "r ..."]) -> Float[np.ndarray, "r ..."]:
        """Rows with the components of each point combined so that their errors are independent."""
        return _pointwise(self.whitening, rows)

    def unwhitened(self, rows: Float[np.ndarray, "r ..."]) -> Float[np.ndarray, "r ..."]:
        """The reverse of `whitened`."""
        return _pointwise(np.linalg.inv(self.whitening), rows)

    def whitening_power(self) -> Float[np.ndarray, " r"]:
        """Variance of every row for components as measured of variance 1, (r,) [-]."""
        power = np.ones(len(self.measured))
        power[: 3 * len(self.whitening)] = (self.whitening**2).sum(axis=2).ravel()
        return power

    def component_variance(self, variance: Float[np.ndarray, " r"]) -> Float[np.ndarray, " r"]:
        """Variance of the x, y and z components as measured, from that of the rows, (r,) [m^2]."""
        k, inverse = len(self.whitening), np.linalg.inv(self.whitening)
        blocks = np.einsum("kab,kb->ka", inverse**2, variance[: 3 * k].reshape(k, 3))
        return np.append(blocks.ravel(), variance[3 * k :])

    def correlated(
        self, columns: Float[np.ndarray, "r c"], sharing: float
    ) -> Float[np.ndarray, "r c"]:
        """Product of the rows' error correlation matrix and some columns.

        Parameters
        ----------
        columns : (r, c) float
        sharing : float [-]     factor on the correlation of `neighbours`, 0 to 1
        """
        if self.neighbours is None or sharing == 0.0:
            return columns
        return np.asarray(columns + sharing * (self.neighbours @ columns))

    def squared_length(self, residual: Float[np.ndarray, " r"]) -> Float[np.ndarray, " p"]:
        """Squared length of each point's residual vector, (p,), in the residuals' unit squared."""
        return np.add.reduceat(residual**2, self.start)


def _pointwise(
    matrices: Float[np.ndarray, "k 3 3"], rows: Float[np.ndarray, "r ..."]
) -> Float[np.ndarray, "r ..."]:
    """Rows with the three of each of the first k points multiplied by that point's matrix."""
    if not len(matrices):
        return rows
    k = 3 * len(matrices)
    first = matrices @ rows[:k].reshape(len(matrices), 3, math.prod(rows.shape[1:]))
    return np.concatenate([first.reshape(rows[:k].shape), rows[k:]])


def observed_rows_of(probe: ProbeObservations) -> MeasuredComponents:
    """Measured components of a probing, in the order of the response's rows.

    Parameters
    ----------
    probe : ProbeObservations

    Returns
    -------
    MeasuredComponents

    Raises
    ------
    InputError                              nothing was measured, or there is no load
    """
    displacement, unit, group = _stacked(probe)
    is_measured = np.isfinite(displacement)
    if not is_measured.any():
        raise InputError(
            f"probing {probe.name!r} has no measured displacement among {len(probe.position)}"
            " points; leave the probing out, or check why every row is NaN"
        )
    if not np.any(probe.force) and not np.any(probe.response.value(0.25)[:, 3]):
        raise InputError(
            f"probing {probe.name!r} has zero force and no other load, so it says nothing about"
            " the constants; give the force on the object in newton, or leave the probing out"
        )
    rows = np.flatnonzero(is_measured)
    point, start, count = np.unique(rows // 3, return_index=True, return_counts=True)
    position = np.vstack([probe.position, np.full((1, 3), np.nan)])[point]
    whitening = _whitening(probe)
    return MeasuredComponents(
        observations=probe,
        rows=rows,
        measured=_pointwise(whitening, displacement[rows]),
        unit=unit[rows],
        group=group[rows],
        start=start.astype(np.int64),
        components=count.astype(np.float64),
        point=point.astype(np.int64),
        position=position,
        whitening=whitening,
        neighbours=_neighbours(probe, point, start, count),
    )


def _neighbours(
    probe: ProbeObservations,
    point: Int[np.ndarray, " p"],
    start: Int[np.ndarray, " p"],
    count: Int[np.ndarray, " p"],
) -> csr_array | None:
    """`MeasuredComponents.neighbours` of the points with all three components measured."""
    complete = np.flatnonzero(count == 3)
    complete = complete[point[complete] < len(probe.position)]
    correlation = probe.correlation.subset(point[complete], len(probe.position))
    if not len(correlation.value):
        return None
    first, second = (
        (start[complete][side, None] + np.arange(3)).ravel() for side in correlation.pair.T
    )
    rows = int(start[-1] + count[-1])
    upper = coo_array(
        (np.repeat(correlation.value, 3), (first, second)), shape=(rows, rows)
    ).tocsr()
    return csr_array(upper + upper.T)


def _whitening(probe: ProbeObservations) -> Float[np.ndarray, "k 3 3"]:
    """`MeasuredComponents.whitening` of the measured points."""
    if probe.covariance is None:
        return np.zeros((0, 3, 3))
    covariance = probe.covariance[np.isfinite(probe.displacement).all(axis=1)]
    value, vector = np.linalg.eigh(covariance)
    size = np.sqrt(value.mean(axis=1, keepdims=True) / value)
    return (vector * size[:, None, :]) @ vector.swapaxes(1, 2)


def _stacked(probe: ProbeObservations) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Displacement, claimed 1 sigma (1 where none) and noise group of every row."""
    n = len(probe.position)
    claimed = probe.std is not None
    unit = np.ones((n, 3)) if probe.std is None else probe.std
    if probe.covariance is not None:
        square = np.trace(probe.covariance, axis1=1, axis2=2) / 3.0
        unit = np.tile(np.sqrt(square)[:, None], 3)
    group = np.tile(np.arange(3), n) + (FIRST_CLAIMED if claimed else 0)
    displacement, unit = probe.displacement.ravel(), unit.ravel()
    if probe.tip_displacement is not None:
        claimed = probe.tip_displacement_std is not None
        tip_unit = probe.tip_displacement_std if claimed else np.ones(3)
        tip_group = TIP_GROUP + (FIRST_CLAIMED if claimed else 0)
        displacement = np.concatenate([displacement, probe.tip_displacement])
        unit = np.concatenate([unit, tip_unit])
        group = np.concatenate([group, np.full(3, tip_group)])
    return displacement, unit, group.astype(np.int64)

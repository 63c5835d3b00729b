"""The measured components of a probing as one stack of rows, ready for the misfit."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array

from palpate.errors import InputError
from palpate.estimation.nuisance import (
    CurvedNuisance,
    LoadedResponse,
    Nuisance,
    NuisanceParameter,
)
from palpate.estimation.observations import ProbeObservations

# Noise groups: x, y, z of the field and the tip without a claimed std, then the same with one.
GROUP_COUNT = 8
FIRST_CLAIMED = 4
TIP_GROUP = 3
# Number of multiplications below which OpenBLAS uses a single thread.
_UNTHREADED = 2**18


@dataclass(frozen=True, slots=True, eq=False)
class ObservedRows:
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
    whitening : (k, 3, 3) float [-] or None    matrices of the first k points, which have three rows
                                            each: covariance^(-1/2) times `unit`
    neighbours : (r, r) sparse or None      error correlation of the rows of neighbouring points,
                                            zero on the diagonal; None: errors are independent

    Attributes
    ----------
    inverse_whitening : (k, 3, 3) float [-] or None
    curved_nuisances : tuple of CurvedNuisance      of the probing
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
    whitening: Float[np.ndarray, "k 3 3"] | None
    neighbours: csr_array | None
    inverse_whitening: Float[np.ndarray, "k 3 3"] | None = field(init=False)
    curved_nuisances: tuple[CurvedNuisance, ...] = field(init=False)

    def __post_init__(self) -> None:
        # Once, as the misfit asks for them in its inner loop.
        inverse = None if self.whitening is None else np.linalg.inv(self.whitening)
        nuisances = self.observations.nuisances
        curved = tuple(kind for kind in nuisances if isinstance(kind, CurvedNuisance))
        object.__setattr__(self, "inverse_whitening", inverse)
        object.__setattr__(self, "curved_nuisances", curved)

    @property
    def name(self) -> str:
        """Name of the probing."""
        return self.observations.name

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """Nuisance parameters of the probing, in the order of its nuisances."""
        nuisances = self.observations.nuisances
        return tuple(parameter for nuisance in nuisances for parameter in nuisance.parameters)

    def loaded(
        self,
        response: Float[np.ndarray, "r c"],
        load: Float[np.ndarray, " c"],
        poisson_ratio: float,
    ) -> LoadedResponse:
        """Response of the measured rows, as `value` gives it, under a load: what `columns` and
        `curvature` take."""
        unwhitened = _pointwise(self.inverse_whitening, response)
        return LoadedResponse(self.rows, unwhitened, load, poisson_ratio)

    def columns(
        self, nuisances: tuple[Nuisance, ...], at: LoadedResponse
    ) -> Float[np.ndarray, "r p"]:
        """Change in displacement per prior sigma of each parameter of some errors, (r, p) [m]."""
        if not nuisances:
            return np.zeros((len(self.measured), 0))
        columns = np.concatenate([nuisance.columns(at) for nuisance in nuisances], axis=1)
        return _pointwise(self.whitening, columns)

    def curvature(
        self, at: LoadedResponse
    ) -> list[tuple[tuple[NuisanceParameter, ...], Float[np.ndarray, "r p p"]]]:
        """Parameters in which displacement is not linear, with its second derivatives,
        (r, p, p) [m]."""
        curvatures = []
        for nuisance in self.curved_nuisances:
            curvature = nuisance.curvature(at)
            whitened = _pointwise(self.whitening, curvature.reshape(len(curvature), -1))
            curvatures.append((nuisance.parameters, whitened.reshape(curvature.shape)))
        return curvatures

    @property
    def load_shifts(self) -> int:
        """Number of shifts of force and motions, 3 + q, which come before the probing's errors."""
        return 3 + len(self.observations.motion)

    @property
    def force_components(self) -> int:
        """Number of uncertain components of the force."""
        return int(np.count_nonzero(self.observations.force_std))

    def load(self, shear_modulus: float, shift: Float[np.ndarray, " n"]) -> Float[np.ndarray, " c"]:
        """Vector that multiplies the response: force and 1 (known loads), both over the shear
        modulus, then motions. Force and motions are offset by `shift` standard deviations; entries
        of `shift` beyond them (nuisance parameters) do not enter."""
        seen = self.observations
        force = seen.force + seen.force_std * shift[:3]
        motion = seen.motion + seen.motion_std * shift[3 : self.load_shifts]
        return np.concatenate([np.append(force, 1.0) / shear_modulus, motion])

    def per_shift(
        self, response: Float[np.ndarray, "r c"], shear_modulus: float
    ) -> Float[np.ndarray, "r n"]:
        """Displacement per standard deviation of each force component and motion, (r, n) [m]."""
        forces = response[:, :3] * (self.observations.force_std / shear_modulus)
        return np.concatenate([forces, response[:, 4:] * self.observations.motion_std], axis=1)

    def prior(self, force_weight: float) -> Float[np.ndarray, " n"]:
        """Prior weight, (n,), of each shift of force and motions, in inverse prior variances."""
        return np.append(np.full(3, force_weight), np.ones(self.load_shifts - 3))

    @property
    def has_claims(self) -> bool:
        """Whether every measured row came with a standard deviation of its own."""
        return bool((self.group >= FIRST_CLAIMED).all())

    def sigma(self, level: Float[np.ndarray, " 8"]) -> Float[np.ndarray, " r"]:
        """1 sigma of every row, (r,) [m], at the noise level of each group, (8,)."""
        return self.unit * level[self.group]

    def component_sigma(self, level: Float[np.ndarray, " 8"]) -> Float[np.ndarray, " r"]:
        """1 sigma of the x, y and z components as measured, before whitening, (r,) [m]."""
        sigma = self.sigma(level)
        if self.inverse_whitening is None:
            return sigma
        k = len(self.inverse_whitening)
        variance = np.einsum(
            "kab,kb->ka", self.inverse_whitening**2, sigma[: 3 * k].reshape(k, 3) ** 2
        )
        return np.append(np.sqrt(variance).ravel(), sigma[3 * k :])

    def per_row(self, values: Float[np.ndarray, " p"]) -> Float[np.ndarray, " r"]:
        """Values of points, (p,), repeated for each row of the point, (r,)."""
        return np.repeat(values, self.components.astype(np.int64))

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

    def value(self, poisson_ratio: float) -> Float[np.ndarray, "r c"]:
        """Response of the measured rows, (r, c), in the units of `ResponseModel`.

        Raises
        ------
        InputError              it has another shape, or is not finite
        """
        return self._measured_rows(self.observations.response.value(poisson_ratio), poisson_ratio)

    def slope(self, poisson_ratio: float) -> Float[np.ndarray, "r c"]:
        """Derivative of `value` with respect to Poisson's ratio; same shape, units, errors."""
        return self._measured_rows(self.observations.response.slope(poisson_ratio), poisson_ratio)

    def settling(
        self, poisson_ratio: float, shear_modulus: float
    ) -> Float[np.ndarray, "r c"] | None:
        """Derivative of the measured rows' response with respect to log G, (r, c), at a shear
        modulus [Pa]; None: the response does not depend on G."""
        settlement = self.observations.settlement
        if settlement is None:
            return None
        derivative = self._measured_rows(settlement.derivative(poisson_ratio), poisson_ratio)
        return derivative * (shear_modulus / settlement.shear_modulus)

    def _measured_rows(self, response: np.ndarray, poisson_ratio: float) -> np.ndarray:
        # No copy where every row was measured: it would cost more than the fit itself.
        complete = len(self.rows) == len(response)
        chosen = response if complete else response[self.rows[self.rows < len(response)]]
        shape = (len(self.measured), 1 + self.load_shifts)
        if chosen.shape != shape or not np.isfinite(chosen.sum()):
            raise InputError(
                f"probing {self.name!r}: the response at poisson_ratio {poisson_ratio:g} has shape"
                f" {response.shape} and must be finite with three rows a point (and three for a"
                f" measured tip) and {shape[1]} columns; check support, contact and mesh"
            )
        return _pointwise(self.whitening, chosen)


def _pointwise(
    matrices: Float[np.ndarray, "k 3 3"] | None, rows: Float[np.ndarray, "r c"]
) -> Float[np.ndarray, "r c"]:
    """Rows with the three of each of the first k points multiplied by that point's matrix;
    unchanged without matrices."""
    if matrices is None:
        return rows
    k = 3 * len(matrices)
    first = matrices @ rows[:k].reshape(len(matrices), 3, -1)
    return np.concatenate([first.reshape(k, -1), rows[k:]])


def observed_rows_of(probe: ProbeObservations) -> ObservedRows:
    """Measured components of a probing, in the order of the response's rows.

    Parameters
    ----------
    probe : ProbeObservations

    Returns
    -------
    ObservedRows

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
    return ObservedRows(
        observations=probe,
        rows=rows,
        measured=_pointwise(whitening, displacement[rows, None])[:, 0],
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
    """`ObservedRows.neighbours` of the points with all three components measured."""
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


def _whitening(probe: ProbeObservations) -> Float[np.ndarray, "k 3 3"] | None:
    """`ObservedRows.whitening` of the measured points."""
    if probe.covariance is None:
        return None
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


def weighted_square(
    columns: Float[np.ndarray, "s r"], weight: Float[np.ndarray, " r"]
) -> Float[np.ndarray, "s s"]:
    """Weighted Gram matrix, columns W columns', computed in pieces too small for BLAS to use
    threads.

    With other work running, waiting threads cost ten times as much as the product itself.

    Parameters
    ----------
    columns : (s, r) float          few rows, many columns
    weight : (r,) float

    Returns
    -------
    (s, s) float
    """
    size, rows = columns.shape
    piece = max(1, _UNTHREADED // size**2)
    weighted = columns * weight
    total = np.zeros((size, size))
    for first in range(0, rows, piece):
        chosen = slice(first, first + piece)
        total += weighted[:, chosen] @ columns[:, chosen].T
    return total

"""Young's modulus from pressing a cylinder between two plates: E = F l / (A delta).

Source: the classical test, e.g. Timoshenko & Goodier, Theory of Elasticity, section 1; ends free
to slip. Ends that stick make the cylinder appear stiffer by `gent_lindley_factor`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri, stdtrit

from palpate.errors import InputError
from palpate.records import HIGHEST_PRESSURE, MODULUS_RANGE
from palpate.shapes import PointScalars

SLOW_POLYNOMIALS = 3  # departures from the line that set the interval: second to fourth degree
MAX_FALL = 0.01  # of the used range: above the noise of a gauge, below any unloading
MAX_TOE_SLOPE = 0.75  # slope of the first fifth of the range over that of the whole: below, a toe
MIN_READINGS = 5
# Own weight of water [Pa per metre of height]: a cylinder much softer would sink into itself.
WATER_WEIGHT = 9810.0
MAX_OFF_LINE = 0.2  # of the stress span: no soft cylinder is so nonlinear within 10 % strain

Kept = Float[np.ndarray, " kept"]


@dataclass(frozen=True, slots=True)
class CompressionResult:
    """Young's modulus of one cylinder, with the departures from a straight line.

    Attributes
    ----------
    young_modulus : float [Pa]      slope of stress (force over first area) against strain
    std : float [Pa]                its standard deviation, slow departures from the line included
    ci95 : (float, float) [Pa]      95 percent interval
    strain_range : (float, float)   the strains that were used
    readings : int                  readings inside that range
    intercept : float [Pa]          stress of the line at zero strain
    nonlinearity : float            largest departure from the line over the stress span, 0 = line
    stiffening : float              slope of the upper half of the readings over that of the lower
    secant_modulus : float [Pa]     slope between the first and the last reading of the range
    diameter, height : float [m]    of the specimen
    source : str                    the file, where there is one
    notes : tuple of str            toe, curvature, sticking ends: in full sentences
    """

    young_modulus: float
    std: float
    ci95: tuple[float, float]
    strain_range: tuple[float, float]
    readings: int
    intercept: float
    nonlinearity: float
    stiffening: float
    secant_modulus: float
    diameter: float
    height: float
    source: str = ""
    notes: tuple[str, ...] = ()

    @property
    def area(self) -> float:
        """Area of the cylinder's ends before loading [m^2]."""
        return float(np.pi * self.diameter**2 / 4.0)


@dataclass(frozen=True, slots=True)
class CompressionSeries:
    """Young's modulus over several specimens: mean, spread and Student's interval of the mean.

    Attributes
    ----------
    young_modulus : float [Pa]            mean over specimens
    spread : float [Pa]                   standard deviation from specimen to specimen; NaN for one
    ci95 : (float, float) [Pa]            of the mean; for one specimen, of its widest fit
    results : tuple of CompressionResult  one per test
    """

    young_modulus: float
    spread: float
    ci95: tuple[float, float]
    results: tuple[CompressionResult, ...]


def compression_test(
    displacement: PointScalars,
    force: Float[np.ndarray, " k"],
    *,
    diameter: float,
    height: float,
    strain_range: tuple[float, float] = (0.0, 0.1),
    preload: float | None = None,
    dimension_std: tuple[float, float] = (0.0, 0.0),
    source: str = "",
) -> CompressionResult:
    """Young's modulus of a cylinder from its shortening under a growing force.

    A straight line with a free intercept is fitted to stress against strain inside `strain_range`.
    Its interval does not assume independent readings (see `slope_std`).

    Parameters
    ----------
    displacement : (n,) float [m]    shortening, growing; 0 at first contact
    force : (n,) float [N]           compression positive
    diameter, height : float [m]     > 0, before loading
    strain_range : (low, high) [-]   0 <= low < high < 1; must lie inside the record
    preload : float [N], optional    contact begins where the force last rises through this value;
                                     strain is counted from there (machine travel in air is cut)
    dimension_std : (float, float) [m]   1 sigma of diameter and of height, both >= 0
    source : str                     goes into messages and the result

    Returns
    -------
    CompressionResult                the modulus [Pa] with its 95 % interval

    Raises
    ------
    InputError   sizes not positive; record too short, going back, or outside the range; no rise of
                 force

    Source
    ------
    E = F l / (A delta), small strains, ends that slip; stress is force over the first area.
    """
    where = f"{source}: " if source else ""
    _check_sizes(diameter, height, strain_range, dimension_std, where)
    displacement, force = _checked_record(displacement, force, where)
    if preload is not None:
        displacement, force = _from_contact(displacement, force, preload, where)
    strain, stress = displacement / height, force / (np.pi * diameter**2 / 4)
    _refuse_impossible(strain, stress, height, where)
    strain, stress = _inside(strain, stress, strain_range, height, where)
    slope, intercept = _line(strain, stress)
    _check_slope(slope, where)
    fitted_std, degrees_of_freedom = slope_std(strain, stress)
    half_width = float(stdtrit(degrees_of_freedom, 0.975)) * fitted_std
    dimension_part = slope * np.hypot(2 * dimension_std[0] / diameter, dimension_std[1] / height)
    half_width = float(np.hypot(half_width, ndtri(0.975) * dimension_part))
    residual = stress - (intercept + slope * strain)
    half = len(strain) // 2
    lower, _ = _line(strain[: half + 1], stress[: half + 1])
    upper, _ = _line(strain[half:], stress[half:])
    return CompressionResult(
        young_modulus=slope,
        std=float(np.hypot(fitted_std, dimension_part)),
        ci95=(slope - half_width, slope + half_width),
        strain_range=(float(strain_range[0]), float(strain_range[1])),
        readings=len(strain),
        intercept=intercept,
        nonlinearity=float(np.abs(residual).max() / np.ptp(stress)),
        stiffening=float(upper / lower) if lower > 0 else float("inf"),
        secant_modulus=float((stress[-1] - stress[0]) / (strain[-1] - strain[0])),
        diameter=float(diameter),
        height=float(height),
        source=source,
        notes=_notes(strain, stress, slope, diameter, height),
    )


def compression_series(
    results: Sequence[CompressionResult], specimens: Sequence[str] | None = None
) -> CompressionSeries:
    """Mean Young's modulus over specimens with Student's 95 percent interval of that mean.

    The spread between specimens contains everything that differs from one to the next. It is
    smaller than the intervals of the single fits suggest only by chance, so these are not used.

    Parameters
    ----------
    results : one or more CompressionResult
    specimens : sequence of str or None     which specimen each is a test of; None: of its own

    Raises
    ------
    InputError   no result given
    """
    if not results:
        raise InputError("no compression result given; give at least one")
    tests: dict[str, list[float]] = {}
    names = [str(k) for k in range(len(results))] if specimens is None else specimens
    for name, result in zip(names, results, strict=True):
        tests.setdefault(name, []).append(result.young_modulus)
    values = np.array([np.mean(moduli) for moduli in tests.values()])
    mean = float(values.mean())
    if len(values) == 1:
        half = max(result.ci95[1] - result.young_modulus for result in results)
        return CompressionSeries(mean, float("nan"), (mean - half, mean + half), tuple(results))
    spread = float(values.std(ddof=1))
    half_width = float(stdtrit(len(values) - 1, 0.975)) * spread / np.sqrt(len(values))
    return CompressionSeries(
        mean, spread, (float(mean - half_width), float(mean + half_width)), tuple(results)
    )


def gent_lindley_factor(diameter: float, height: float) -> float:
    """Apparent stiffening of a rubber cylinder when both ends stick to the plates.

    1 + 2 S^2 with the shape factor S = diameter / (4 height), loaded over free area. Holds for
    incompressible rubber (nu near 0.5) and small strains; at nu = 0.3 the effect is about a quarter
    as large (`docs/howto/compression.md` has finite element results).

    Parameters
    ----------
    diameter, height : float [m]   > 0

    Raises
    ------
    InputError   a size that is not positive

    Source
    ------
    Gent & Lindley, Proc. Inst. Mech. Eng. 173 (1959) 111-122.
    """
    if not (diameter > 0 and height > 0):
        raise InputError(f"diameter {diameter} m and height {height} m must both be positive")
    return 1.0 + 2.0 * (diameter / (4.0 * height)) ** 2


def slope_std(strain: PointScalars, stress: PointScalars) -> tuple[float, int]:
    """Standard deviation of a fitted slope when the errors of neighbouring readings are correlated.

    Departures from the line are slow (curvature, drift, stick-slip), so n readings are not n
    independent ones. The uncertainty of the slope depends on the strength of the *slow* departures,
    which is measured by their projections on polynomials of degree 2 to 4, orthogonal to the line
    and to each other. The mean square of these replaces the residual variance, with as many degrees
    of freedom as polynomials.

    Parameters
    ----------
    strain : (n,) float [-]   n >= 3, not all equal
    stress : (n,) float [Pa]

    Returns
    -------
    (float [Pa], int)   standard deviation of the slope; degrees of freedom for Student's t

    Source
    ------
    Series estimators of a long-run variance: Mueller, J. Econometrics 141 (2007) 1331-1352;
    Sun, J. Econometrics 178 (2014) 659-677; here with polynomials in place of cosines because
    these stay orthogonal to a fitted line.
    """
    n_polynomials = min(SLOW_POLYNOMIALS, len(strain) - 2)
    centred = strain - strain.mean()
    scaled = centred / np.abs(centred).max()
    columns: Float[np.ndarray, "n d"] = np.polynomial.legendre.legvander(scaled, n_polynomials + 1)
    orthonormal, _ = np.linalg.qr(columns)
    squared_projections = (orthonormal[:, 2:].T @ (stress - stress.mean())) ** 2
    return float(np.sqrt(squared_projections.mean() / (centred @ centred))), n_polynomials


def _line(strain: PointScalars, stress: PointScalars) -> tuple[float, float]:
    """Slope and intercept of the straight line through stress against strain."""
    centred = strain - strain.mean()
    slope = float(centred @ stress / (centred @ centred))
    return slope, float(stress.mean() - slope * strain.mean())


def _check_sizes(
    diameter: float,
    height: float,
    strain_range: tuple[float, float],
    dimension_std: tuple[float, float],
    where: str,
) -> None:
    """Refuse sizes and strain ranges that are impossible."""
    for name, value in (("diameter", diameter), ("height", height)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{where}{name} is {value} m; must be positive")
    low, high = strain_range
    if not 0 <= low < high < 1:
        raise InputError(
            f"{where}strain_range is ({low}, {high}); must be 0 <= low < high < 1, "
            "where 0.1 is ten percent of the height"
        )
    if not all(np.isfinite(s) and s >= 0 for s in dimension_std):
        raise InputError(f"{where}dimension_std is {dimension_std} m; both must be 0 or more")


def _checked_record(
    displacement: PointScalars, force: Float[np.ndarray, " k"], where: str
) -> tuple[PointScalars, PointScalars]:
    """The record as float64 arrays; refuse unequal lengths and readings that are no numbers."""
    if len(displacement) != len(force):
        raise InputError(
            f"{where}{len(displacement)} displacements but {len(force)} forces; "
            "give one force for each displacement"
        )
    bad = np.flatnonzero(~(np.isfinite(displacement) & np.isfinite(force)))
    if len(bad):
        raise InputError(
            f"{where}{len(bad)} readings are not finite numbers, the first is number {bad[0]} "
            "(from 0); leave them out"
        )
    return np.asarray(displacement, dtype=float), np.asarray(force, dtype=float)


def _from_contact(
    displacement: PointScalars, force: PointScalars, preload: float, where: str
) -> tuple[Kept, Kept]:
    """Drop readings before the force last rises through `preload`; count shortening from there."""
    if not 0.0 <= preload < np.inf:
        raise InputError(f"{where}preload is {preload:g} N; must be a force of 0 N or more")
    below = np.flatnonzero(force < preload)
    first = int(below[-1]) + 1 if len(below) else 0
    if first >= len(force) - MIN_READINGS:
        raise InputError(
            f"{where}preload is {preload:g} N but the force never stays above it (largest "
            f"{force.max(initial=-np.inf):g} N); give a smaller preload"
        )
    return displacement[first:] - displacement[first], force[first:]


def _inside(
    strain: PointScalars,
    stress: PointScalars,
    strain_range: tuple[float, float],
    height: float,
    where: str,
) -> tuple[Kept, Kept]:
    """The readings within the range, going up; refuse a record that ends before or goes back."""
    low, high = strain_range
    largest = float(strain.max(initial=0.0))
    if largest < high * (1 - 1e-9):
        raise InputError(
            f"{where}strain_range ends at {high:.4g} but the record reaches a strain of only "
            f"{largest:.4g} ({largest * height * 1e3:.4g} mm of {height * 1e3:.4g} mm); "
            "choose a lower range, or check the height and the unit of the displacement"
        )
    end = int(np.argmax(strain >= high * (1 - 1e-9))) + 1
    later = int(((strain[end:] >= low) & (strain[end:] < high)).sum())
    strain, stress = strain[:end], stress[:end]
    _refuse_return(strain, high, height, where)
    within = (strain >= low - 1e-12) & (strain <= high * (1 + 1e-9))
    if within.sum() < MIN_READINGS:
        cure = "widen the range or sample faster"
        if later:
            cure = (
                f"{later} more follow after the displacement has passed it; it must grow: put the"
                " rows in the order of time"
            )
        raise InputError(
            f"{where}only {within.sum()} readings lie in the strain range {low:g} to {high:g}; "
            f"at least {MIN_READINGS} are needed: {cure}"
        )
    return strain[within], stress[within]


def _refuse_impossible(
    strain: PointScalars, stress: PointScalars, height: float, where: str
) -> None:
    """Refuse a shortening beyond the height, or a pressure beyond the strength of steel."""
    if strain.max(initial=0.0) >= 1.0:
        raise InputError(
            f"{where}the displacement reaches {strain.max() * height:.4g} m, the cylinder is"
            f" {height:.4g} m high; check the height, the unit of the displacement, and that the"
            " columns are not exchanged"
        )
    if stress.max(initial=0.0) > HIGHEST_PRESSURE:
        raise InputError(
            f"{where}the force reaches a pressure of {stress.max() / 1e9:.3g} GPa, more than any"
            f" steel bears ({HIGHEST_PRESSURE / 1e9:g} GPa); check the unit of the force and the"
            " diameter"
        )


def _check_slope(slope: float, where: str) -> None:
    """Refuse a force that does not rise, and a modulus that no material has."""
    if not slope > 0:
        raise InputError(
            f"{where}the force does not rise while the cylinder is pressed (slope {slope:.4g} Pa); "
            "compression and its force must both be positive: check the signs of the columns"
        )
    softest, stiffest = MODULUS_RANGE
    if not softest <= slope <= stiffest:
        raise InputError(
            f"{where}Young's modulus comes out as {slope:.3g} Pa; must be {softest:g} to"
            f" {stiffest:g} Pa, from the softest gel to diamond: check the units of force and"
            " displacement, and the diameter"
        )


def _refuse_return(strain: PointScalars, high: float, height: float, where: str) -> None:
    """Refuse displacement that starts far from zero, or goes back by more than noise."""
    if strain.min() < -MAX_FALL * high:
        raise InputError(
            f"{where}the displacement is negative (down to {strain.min() * height * 1e3:.4g} mm); "
            "shortening must be positive and start at zero: subtract its first value or flip signs"
        )
    fall = np.maximum.accumulate(strain) - strain
    worst = int(np.argmax(fall))
    if fall[worst] > MAX_FALL * high:
        raise InputError(
            f"{where}the displacement goes back by {fall[worst] * height * 1e3:.4g} mm before "
            f"reading {worst} (from 0); it must grow: keep one loading branch in the file"
        )


def _notes(
    strain: PointScalars, stress: PointScalars, slope: float, diameter: float, height: float
) -> tuple[str, ...]:
    """Notes on the toe, on the straightness of the curve and on sticking ends."""
    notes = []
    early = strain <= strain[0] + 0.2 * (strain[-1] - strain[0])
    if early.sum() >= MIN_READINGS and stress[0] < 0.1 * stress.max():
        first = _line(strain[early], stress[early])[0]
        if first < MAX_TOE_SLOPE * slope:
            notes.append(
                f"Toe: the first fifth of the strain range is {100 * (1 - first / slope):.0f} % "
                f"softer than the whole (ends not yet in full contact?); start the range at "
                f"{strain[early][-1]:.2g} or above, or use a preload."
            )
    residual = stress - stress.mean() - slope * (strain - strain.mean())
    off = float(np.abs(residual).max() / np.ptp(stress))
    if off > MAX_OFF_LINE:
        notes.append(
            f"The readings lie up to {100 * off:.0f} % of the stress off a straight line: look at"
            " the record (jumps, changes of sign), or choose a range in which it is straight."
        )
    if slope < WATER_WEIGHT * height:
        notes.append(
            f"A modulus of {slope:.3g} Pa is so low that a cylinder as heavy as water would sink"
            " into itself: check the unit of the force, the diameter"
            f" ({1e3 * diameter:.4g} mm) and the height ({1e3 * height:.4g} mm)."
        )
    factor = gent_lindley_factor(diameter, height)
    if factor > 1.02:
        notes.append(
            f"Ends that stick instead of slipping raise the modulus of nearly incompressible "
            f"material by about {100 * (factor - 1):.0f} % at diameter/height "
            f"{diameter / height:.2f}; lubricate the ends or use a taller cylinder."
        )
    return tuple(notes)

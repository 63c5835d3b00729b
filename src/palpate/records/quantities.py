"""Numbers with units: read from text such as "50 kPa", "3mm" or "0.3 psi", and written for readers
with no more digits than are significant.
"""

import math
import re
from collections.abc import Mapping, Sequence, Sized
from numbers import Real

import numpy as np

from palpate.errors import InputError
from palpate.records.estimate import (
    BIASED,
    BudgetEntry,
    Constant,
    ErrorEstimate,
    Estimate,
    LoadDependence,
    RegionEstimate,
    RelaxationEstimate,
    Status,
)
from palpate.shapes import Vector3

# SI unit of an error -> factor to the unit in which it is shown, and name of that unit.
_ERROR_UNITS = {
    "": (100.0, "%"),
    "m": (1e3, "mm"),
    "rad": (180.0 / math.pi, "degrees"),
    "m/Pa": (1e9, "mm/MPa"),
    "m/N": (1e3, "mm/N"),
}
# Range of elastic moduli [Pa], from the softest gel to diamond.
MODULUS_RANGE = (1.0, 1.2e12)
# Yield strength of the strongest steels [Pa].
HIGHEST_PRESSURE = 3e9
# Relative standard deviations below this are rounding errors.
_RELATIVE_ROUNDING = 1e-9
# Shown in place of a value that the data do not determine.
NOT_DETERMINED = "not determined"
# Shown in place of an interval of a model that the data contradict.
_NO_INTERVAL = "none"
# Symbols of the constants, in the order in which they are shown.
_SYMBOLS = {"young_modulus": "E", "shear_modulus": "G", "poisson_ratio": "nu"}
# Simple shear at which stiffening is told; range of the factor there that is no knowledge.
_SHEAR, _UNKNOWN = 0.2, 0.5
_RISES = {True: "rises", False: "falls"}
_INCH, _POUND = 0.0254, 4.4482216152605
# Value of each unit in SI units.
LENGTH_UNITS = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": _INCH}
# Length units of Palpate's own files and of calibrations, in which micrometres make no sense.
FILE_LENGTH_UNITS = {unit: LENGTH_UNITS[unit] for unit in ("m", "cm", "mm", "in")}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ANGLE_UNITS = {"deg": math.pi / 180.0, "rad": 1.0}
FORCE_UNITS = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": _POUND}
MODULUS_UNITS = {
    "Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "psi": _POUND / _INCH**2, "N/mm^2": 1e6
}  # fmt: skip
# Modulus of an elastic foundation, traction over displacement [N/m^3]; compliance is its inverse.
STIFFNESS_UNITS = {"N/m^3": 1.0, "Pa/m": 1.0, "N/mm^3": 1e9, "kPa/mm": 1e6, "MPa/mm": 1e9}
COMPLIANCE_UNITS = {"m/Pa": 1.0, "m^3/N": 1.0, "mm/kPa": 1e-6, "um/kPa": 1e-9, "mm/MPa": 1e-9}
_MICROMETRE = dict.fromkeys(("\N{MICRO SIGN}m", "\N{GREEK SMALL LETTER MU}m"), "um")
_ALIASES = _MICROMETRE | {"N/mm2": "N/mm^2"}
# Spellings of lengths in files of programs, in lower case.
_SPELLINGS = {"micron": "um", "meter": "m", "metre": "m", "inch": "in", "inches": "in"}
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(\S*)\s*")
Quantity = float | int | str


def modulus_unit(modulus: float) -> tuple[float, str]:
    """Unit in which a modulus has one to three digits before the decimal point.

    Parameters
    ----------
    modulus : float [Pa]            NaN counts as zero

    Returns
    -------
    (float [Pa], str)               value and name of the unit: GPa, MPa, kPa or Pa
    """
    size = abs(modulus) if math.isfinite(modulus) else 0.0
    for factor, name in ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa")):
        if size >= factor:
            return factor, name
    return 1.0, "Pa"


def length_unit(length: float) -> tuple[float, str]:
    """Unit in which a small length is shown.

    Parameters
    ----------
    length : float [m]              NaN counts as zero

    Returns
    -------
    (float [m], str)                value and name of the unit: µm below 0.1 mm, else mm
    """
    size = abs(length) if math.isfinite(length) else 0.0
    return (1e-6, "µm") if size < 0.1e-3 else (1e-3, "mm")


def constant_text(constant: Constant, *, factor: float = 1.0) -> str:
    """Value and standard deviation to the same decimal, with two digits of the deviation.

    Parameters
    ----------
    constant : Constant
    factor : float                  value of the display unit in SI units, > 0

    Returns
    -------
    str                             'unknown' if the value is not finite
    """
    value, std = constant.value / factor, constant.std / factor
    shown = value_text(constant, factor=factor)
    if not (math.isfinite(value) and math.isfinite(std)):
        return shown
    return f"{shown} ± {std:.{_decimals(std, value)}f}"


def value_text(constant: Constant, *, factor: float = 1.0) -> str:
    """Value alone, to two digits of its standard deviation.

    Parameters
    ----------
    constant : Constant
    factor : float                  value of the display unit in SI units, > 0

    Returns
    -------
    str                             'unknown' if the value is not finite
    """
    value, std = constant.value / factor, constant.std / factor
    return f"{value:.{_decimals(std, value)}f}" if math.isfinite(value) else "unknown"


def interval_text(constant: Constant, *, factor: float = 1.0) -> str:
    """Both ends of the 95 % interval, to two digits of the standard deviation.

    Parameters
    ----------
    constant : Constant
    factor : float                  value of the display unit in SI units, > 0

    Returns
    -------
    str                             e.g. '20.70 to 21.30'; 'none' where there is none
    """
    decimals = _decimals(constant.std / factor, constant.value / factor)
    low, high = (end / factor for end in constant.ci95)
    if math.isnan(low):
        return _NO_INTERVAL
    return f"{low:.{decimals}f} to {high:.{decimals}f}"


def constant_row(estimate: Estimate, name: str) -> tuple[str, str, str]:
    """Value, interval and unit of a constant for a table.

    A constant that the data do not determine has no value; its interval, in brackets, is the range
    of possible values.

    Parameters
    ----------
    estimate : Estimate
    name : str                      one of `CONSTANT_NAMES`

    Returns
    -------
    three str                       `60.35 ± 0.73`, `58.91 to 61.87`, `kPa`; or `not determined`,
                                    `(0.00 to 0.50)`
    """
    constant: Constant = getattr(estimate, name)
    factor, unit = _constant_unit(estimate, name)
    interval = interval_text(constant, factor=factor)
    if not estimate.identifiable[name]:
        return NOT_DETERMINED, f"({interval})", unit
    return constant_text(constant, factor=factor), interval, unit


def region_row(region: RegionEstimate) -> tuple[str, str, str, str, str]:
    """A region in a table.

    Parameters
    ----------
    region : RegionEstimate

    Returns
    -------
    five str                        name; shear and Young's modulus, with their unit, or
                                    `not determined`; interval of the latter, in brackets where it
                                    is not determined; ratio of moduli to the rest, its interval
    """
    factor, unit = modulus_unit(region.young_modulus.value)
    interval = f"{interval_text(region.young_modulus, factor=factor)} {unit}"
    if not region.identifiable:
        what = NOT_DETERMINED if region.is_seen else "not seen"
        return region.name, what, what, f"({interval})", f"({interval_text(region.ratio)})"
    shear, young = (
        f"{constant_text(modulus, factor=factor)} {unit}"
        for modulus in (region.shear_modulus, region.young_modulus)
    )
    return region.name, shear, young, interval, interval_text(region.ratio)


def relaxation_rows(relaxation: RelaxationEstimate) -> list[tuple[str, str, str, str]]:
    """The modulus over time in a table: at whole decades, at its ends, and its time constants.

    Parameters
    ----------
    relaxation : RelaxationEstimate

    Returns
    -------
    list of four str                what; value; 95 % interval; unit
    """
    symbol = _SYMBOLS[relaxation.constant]
    factor, unit = modulus_unit(relaxation.unrelaxed)
    rows = []

    def add(label: str, constant: Constant | None, factor: float, unit: str) -> None:
        texts = (NOT_DETERMINED, "-")
        if constant is not None:
            texts = constant_text(constant, factor=factor), interval_text(constant, factor=factor)
        rows.append((label, *texts, unit))

    add(f"{symbol} at once", relaxation.instantaneous, factor, unit)
    for point in relaxation.curve:
        if abs(math.log10(point.time) - round(math.log10(point.time))) < 1e-6:
            add(f"{symbol} at {point.time:g} s", point.modulus, factor, unit)
    add(f"{symbol} in the long term", relaxation.long_term, factor, unit)
    for loss in relaxation.loss:
        add(f"loss angle at {loss.frequency:g} Hz", loss.angle, math.pi / 180.0, "degrees")
    for term in relaxation.terms:
        add(f"time constant, {100 * term.share:.0f} % of {symbol}", term.time, 1.0, "s")
    return rows


def law_rows(estimate: Estimate) -> list[tuple[str, str, str, str]]:
    """Rows of a table of constants on what one modulus does not say, where the data show it: the
    stiffening of the material, and how the modulus changes with the load.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    list of four str                what; value; 95 % interval; unit
    """
    rows, load = [], estimate.load
    if (stiffening := estimate.stiffening) is not None:
        rows.append(
            ("stiffening C2 / C1", constant_text(stiffening), interval_text(stiffening), "-")
        )
    if load is not None:
        symbol, values, unit = _at_loads(estimate, load)
        for value, force in zip(values, load.force, strict=True):
            rows.append((f"{symbol} at {force:.2g} N", value, "-", unit))
        what = f"{symbol} {_RISES[load.exponent.value > 0.0]} with load, as force to the"
        rows.append((what, constant_text(load.exponent), interval_text(load.exponent), "-"))
    return rows


def load_text(estimate: Estimate) -> str:
    """A sentence that stiffness changes with the load; empty where the data do not show it.

    Parameters
    ----------
    estimate : Estimate
    """
    load = estimate.load
    if load is None:
        return ""
    symbol, values, unit = _at_loads(estimate, load)
    at = ", ".join(
        f"{value} {unit} at {force:.2g} N" for value, force in zip(values, load.force, strict=True)
    )
    rises, sigmas = _RISES[load.exponent.value > 0.0], abs(load.exponent.value) / load.exponent.std
    return f"Stiffness {rises} with load: {symbol} is {at} ({sigmas:.2g} sigma)."


def _at_loads(estimate: Estimate, load: LoadDependence) -> tuple[str, list[str], str]:
    """Symbol of the modulus that is determined, its values at both loads, and their unit."""
    known = estimate.identifiable["young_modulus"]
    symbol, modulus = ("E", estimate.young_modulus) if known else ("G", estimate.shear_modulus)
    factor, unit = _constant_unit(estimate, "young_modulus")
    return symbol, [f"{modulus.value * ratio / factor:.3g}" for ratio in load.factor], unit


def stiffening_text(stiffening: Constant, *, shown: bool) -> str:
    """What the stiffening of a material means, or that the data do not show one.

    Parameters
    ----------
    stiffening : Constant [-]       C2 / C1 of Yeoh's law
    shown : bool                    whether the data show it
    """

    def times(value: float) -> str:
        return f"{1.0 + 2.0 * value * _SHEAR**2:.3g}"

    where = f"in simple shear by {100 * _SHEAR:.0f} %"
    low, high = stiffening.ci95
    if shown:
        return (
            f"The material stiffens: {where} it is {times(stiffening.value)} times as stiff as at"
            f" small strain (95 %: {times(low)} to {times(high)}), by Yeoh's law with C2 / C1 ="
            f" {stiffening.value:.3g}; G, nu and E are those at small strain."
        )
    if 2.0 * _SHEAR**2 * (high - low) > _UNKNOWN:
        return (
            f"Whether the material stiffens is not determined: {where} it may be {times(low)} to"
            f" {times(high)} times as stiff as at small strain (95 %); press deeper, and to several"
            " depths."
        )
    return (
        f"No stiffening is shown: {where} the material is at most {times(high)} times as stiff as"
        " at small strain (95 %)."
    )


def verdict_text(estimate: Estimate) -> str:
    """Summary of an estimate in a few sentences.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    str                             the meaning of the status; then the identifiable constants with
                                    their intervals; then how they change with the load, and the
                                    first note that calls it biased
    """
    sentence = estimate.status.sentence
    known = []
    for name, symbol in _SYMBOLS.items():
        if estimate.identifiable[name]:
            _, interval, unit = constant_row(estimate, name)
            factor, _ = _constant_unit(estimate, name)
            value = value_text(getattr(estimate, name), factor=factor)
            brackets = "" if interval == _NO_INTERVAL else f" ({interval})"
            known.append(f"{symbol} = {value}{unit and ' ' + unit}{brackets}")
    sentences = [f"{sentence[0].upper()}{sentence[1:]}."]
    contradicted = estimate.status is Status.MODEL_CONTRADICTED
    remark = (
        "best fit of a model that does not fit" if contradicted else "95 % intervals in brackets"
    )
    if known:
        sentences.append(f"{', '.join(known)} ({remark}).")
    if estimate.load is not None:
        sentences.append(load_text(estimate))
    biased = [note for note in (*estimate.notes, *estimate.details) if BIASED in note]
    sentences += biased[:1]
    if len(biased) > 1:
        sentences.append(f"{len(biased)} notes say so.")
    return " ".join(sentences)


def _constant_unit(estimate: Estimate, name: str) -> tuple[float, str]:
    """Unit in which a constant is shown; that of Young's modulus is also that of the shear modulus.

    Parameters
    ----------
    estimate : Estimate
    name : str                      one of `CONSTANT_NAMES`

    Returns
    -------
    (float, str)                    value of the unit in SI units, and its name; 1 and an empty name
                                    for Poisson's ratio
    """
    moduli = (estimate.young_modulus.value, estimate.shear_modulus.value)
    return (1.0, "") if name == "poisson_ratio" else modulus_unit(np.fmax(*moduli))


def _decimals(std: float, value: float) -> int:
    """Number of decimals for two digits of the standard deviation, or three to four of the value
    if the deviation is not known."""
    known = math.isfinite(std) and std > _RELATIVE_ROUNDING * abs(value)
    shown = std if known else abs(value) * 1e-2
    if not (math.isfinite(shown) and shown > 0.0):
        return 3
    return min(max(1 - math.floor(math.log10(shown)), 0), 12)


def budget_text(budget: Sequence[BudgetEntry], name: str) -> str:
    """The largest contributions to a constant's standard deviation, as text.

    Parameters
    ----------
    budget : sequence of BudgetEntry
    name : str                      of the constant

    Returns
    -------
    str                             up to three sources, each more than a third of the largest:
                                    "gain of the force sensor 1 %, measured forces 0.59 %"; empty
                                    if nothing is known
    """
    parts = [(getattr(entry, name), entry.source) for entry in budget]
    parts = sorted((part for part in parts if not math.isnan(part[0])), reverse=True)
    largest = [(std, source) for std, source in parts[:3] if std > parts[0][0] / 3.0]
    ratio = name == "poisson_ratio"
    return ", ".join(f"{source} {_deviation(std, ratio=ratio)}" for std, source in largest)


def _deviation(std: float, *, ratio: bool) -> str:
    return f"{std:.2g}" if ratio else f"{100.0 * std:.2g} %"


def error_texts(error: ErrorEstimate) -> tuple[str, str, str]:
    """Value, posterior and prior standard deviation of an error, as texts with units.

    Parameters
    ----------
    error : ErrorEstimate

    Returns
    -------
    (str, str, str)                 relative errors in per cent, lengths in mm, angles in degrees,
                                    compliances in mm/MPa
    """
    # A later version may know more units.
    factor, unit = _ERROR_UNITS.get(error.unit, (1.0, error.unit))
    value, std, prior = (factor * x for x in (error.value, error.std, error.prior_std))
    decimals = _decimals(std, value)
    # Two digits, never as a power of ten.
    assumed = f"{float(f'{prior:.2g}'):g}"
    return f"{value:z.{decimals}f} {unit}", f"{std:.{decimals}f} {unit}", f"{assumed} {unit}"


def quantity(value: Quantity, units: Mapping[str, float], name: str = "the number") -> float:
    """Value in SI units of a text with its unit, or of a plain number in SI units.

    Parameters
    ----------
    value : float or str
    units : mapping                 unit -> its value in SI units: `LENGTH_UNITS`, `FORCE_UNITS`
                                    or `MODULUS_UNITS`
    name : str                      of the number, for messages

    Returns
    -------
    float                           in SI units

    Raises
    ------
    InputError                      not a number, an unknown unit, not finite
    """
    match = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
    if match:
        unit = _ALIASES.get(match[2], match[2]) or next(u for u in units if units[u] == 1.0)
        if unit in units and math.isfinite(number := float(match[1]) * units[unit]):
            return number
    elif isinstance(value, Real) and math.isfinite(float(value)):
        return float(value)
    known = ", ".join(units)
    raise InputError(
        f"{name} is {value!r}; must be a finite number, with one of these units: {known}"
    )


def unit_name(word: str) -> str:
    """Name in `LENGTH_UNITS` of a unit as programs spell it; an unknown unit in lower case.

    Parameters
    ----------
    word : str                      e.g. "MM", "micron", "inches"

    Returns
    -------
    str
    """
    return (_MICROMETRE | _SPELLINGS).get(word.lower(), word.lower())


def quantities(value: Sequence[Quantity], units: Mapping[str, float], name: str) -> Vector3:
    """Vector in SI units, from three numbers or texts as in `quantity`.

    Parameters
    ----------
    value : three float or str
    units : mapping                 unit -> its value in SI units
    name : str                      of the vector, for messages

    Returns
    -------
    (3,) float                      in SI units

    Raises
    ------
    InputError                      not three, or as in `quantity`
    """
    if isinstance(value, str) or not isinstance(value, Sized) or len(value) != 3:
        raise InputError(f"{name} is {value!r}; must be three numbers: x, y, z")
    return np.array([quantity(component, units, name) for component in value])

"""Formatting of numbers for readers, with no more digits than are significant."""

import math
from collections.abc import Sequence

from palpate.records.estimate import BIASED, BudgetEntry, Constant, ErrorEstimate, Estimate, Status

# SI unit of an error -> factor to the unit in which it is shown, and name of that unit.
_ERROR_UNITS = {
    "": (100.0, "%"),
    "m": (1e3, "mm"),
    "rad": (180.0 / math.pi, "degrees"),
    "m/Pa": (1e9, "mm/MPa"),
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
NO_INTERVAL = "none"
# Symbols of the constants, in the order in which they are shown.
SYMBOLS = {"young_modulus": "E", "shear_modulus": "G", "poisson_ratio": "nu"}


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
        return NO_INTERVAL
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
    factor, unit = constant_unit(name, constant.value)
    interval = interval_text(constant, factor=factor)
    if not estimate.identifiable[name]:
        return NOT_DETERMINED, f"({interval})", unit
    return constant_text(constant, factor=factor), interval, unit


def verdict_text(estimate: Estimate) -> str:
    """Summary of an estimate in a few sentences.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    str                             the meaning of the status; then the identifiable constants with
                                    their intervals; then the first note that calls it biased
    """
    sentence = estimate.status.sentence
    known = []
    for name, symbol in SYMBOLS.items():
        if estimate.identifiable[name]:
            _, interval, unit = constant_row(estimate, name)
            factor, _ = constant_unit(name, getattr(estimate, name).value)
            value = value_text(getattr(estimate, name), factor=factor)
            brackets = "" if interval == NO_INTERVAL else f" ({interval})"
            known.append(f"{symbol} = {value}{unit and ' ' + unit}{brackets}")
    sentences = [f"{sentence[0].upper()}{sentence[1:]}."]
    contradicted = estimate.status is Status.MODEL_CONTRADICTED
    remark = (
        "best fit of a model that does not fit" if contradicted else "95 % intervals in brackets"
    )
    if known:
        sentences.append(f"{', '.join(known)} ({remark}).")
    biased = [note for note in (*estimate.notes, *estimate.details) if BIASED in note]
    sentences += biased[:1]
    if len(biased) > 1:
        sentences.append(f"{len(biased)} notes say so.")
    return " ".join(sentences)


def constant_unit(name: str, value: float) -> tuple[float, str]:
    """Unit in which a constant is shown.

    Parameters
    ----------
    name : str                      one of `CONSTANT_NAMES`
    value : float                   [Pa] for moduli

    Returns
    -------
    (float, str)                    value of the unit in SI units, and its name; 1 and an empty name
                                    for Poisson's ratio
    """
    return (1.0, "") if name == "poisson_ratio" else modulus_unit(value)


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
    factor, unit = _ERROR_UNITS[error.unit]
    value, std, prior = (factor * x for x in (error.value, error.std, error.prior_std))
    return f"{value:.2g} {unit}", f"{std:.2g} {unit}", f"{prior:.2g} {unit}"

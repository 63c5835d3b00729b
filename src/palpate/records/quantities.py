"""Numbers as a person reads them: a unit of fitting size, no more digits than are known."""

import math

from palpate.records.estimate import Constant


def modulus_unit(modulus: float) -> tuple[float, str]:
    """Unit in which a modulus has one to three digits before the point: (pascals a unit, name)."""
    size = abs(modulus) if math.isfinite(modulus) else 0.0
    for factor, name in ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa")):
        if size >= factor:
            return factor, name
    return 1.0, "Pa"


def length_unit(length: float) -> tuple[float, str]:
    """Unit in which a length has one to three digits before the point: (metres a unit, name)."""
    size = abs(length) if math.isfinite(length) else 0.0
    return (1e-6, "µm") if size < 0.1e-3 else (1e-3, "mm")


def constant_text(constant: Constant, *, factor: float = 1.0) -> str:
    """Value and standard deviation to the same decimal, two digits of the deviation."""
    value, std = constant.value / factor, constant.std / factor
    if not math.isfinite(value):
        return "unknown"
    places = _places(std, value)
    if not math.isfinite(std):
        return f"{value:.{places}f}"
    return f"{value:.{places}f} ± {std:.{places}f}"


def value_text(constant: Constant, *, factor: float = 1.0) -> str:
    """Value alone, to two digits of its standard deviation."""
    value, std = constant.value / factor, constant.std / factor
    return f"{value:.{_places(std, value)}f}" if math.isfinite(value) else "unknown"


def interval_text(constant: Constant, *, factor: float = 1.0) -> str:
    """Both ends of the 95 % interval, to the decimal of the standard deviation."""
    places = _places(constant.std / factor, constant.value / factor)
    low, high = (end / factor for end in constant.ci95)
    return f"{low:.{places}f} to {high:.{places}f}"


def _places(std: float, value: float) -> int:
    """Decimals that show two digits of the standard deviation, or four of the value."""
    shown = std if math.isfinite(std) and std > 0.0 else abs(value) * 1e-2
    if not (math.isfinite(shown) and shown > 0.0):
        return 3
    return min(max(1 - math.floor(math.log10(shown)), 0), 12)

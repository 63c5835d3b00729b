"""Numbers with units as text: "50 kPa", "3mm", "0.3 psi"."""

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from palpate.errors import InputError
from palpate.shapes import Vector3

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
    found = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
    if found:
        unit = _ALIASES.get(found[2], found[2]) or next(u for u in units if units[u] == 1.0)
        if unit in units and math.isfinite(number := float(found[1]) * units[unit]):
            return number
    elif not isinstance(value, str) and math.isfinite(float(value)):
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
    if isinstance(value, str) or len(value) != 3:
        raise InputError(f"{name} is {value!r}; must be three numbers: x, y, z")
    return np.array([quantity(component, units, name) for component in value])

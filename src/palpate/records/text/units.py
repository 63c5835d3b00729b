"""Numbers with units as text: "50 kPa", "3mm", "0.3 psi"."""

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from palpate.errors import InputError
from palpate.shapes import Vector3

# Value of each unit in SI units; a plain number is in the first.
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
FORCES = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216152605}
MODULI = {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "psi": 6894.757293168361, "N/mm^2": 1e6}
_ALIASES = {"\N{MICRO SIGN}m": "um", "\N{GREEK SMALL LETTER MU}m": "um", "N/mm2": "N/mm^2"}
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(\S*)\s*")

Quantity = float | int | str


def quantity(value: Quantity, units: Mapping[str, float], name: str = "the number") -> float:
    """Value in SI units of a text with its unit, or of a plain number in SI units.

    Parameters
    ----------
    value : float or str
    units : mapping                 unit -> its value in SI units: `LENGTHS`, `FORCES` or `MODULI`
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
        unit = _ALIASES.get(found[2], found[2]) or next(iter(units))
        if unit in units and math.isfinite(number := float(found[1]) * units[unit]):
            return number
    elif not isinstance(value, str) and math.isfinite(float(value)):
        return float(value)
    known = ", ".join(units)
    raise InputError(
        f"{name} is {value!r}; must be a finite number, with one of these units: {known}"
    )


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

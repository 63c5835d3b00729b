"""What `--until` wants: a constant with an interval, and what that asks of lengths."""

import re
from dataclasses import dataclass

import numpy as np

from palpate.bench.calibrating import PRECISE
from palpate.errors import InputError
from palpate.records import HALF_95, MODULUS_UNITS, Constant, Estimate

_CONSTANTS = {"E": "young_modulus", "G": "shear_modulus", "nu": "poisson_ratio"}
_WANTED = re.compile(r"(E|G|nu)\s+(\d+\.?\d*|\.\d+)\s*(\S*)")
# Share by which lengths may widen the interval.
_WIDER = 0.02


@dataclass(frozen=True, slots=True)
class Wanted:
    """A constant, and half the 95 % interval that it is to have: relative, or in SI units."""

    constant: str
    half: float
    relative: bool

    def share(self, estimate: Estimate) -> float:
        """Half the interval over the wanted one; 1 or less: reached; infinite: not determined."""
        if not estimate.identifiable[self.constant]:
            return np.inf
        constant: Constant = getattr(estimate, self.constant)
        half = 0.5 * (constant.ci95[1] - constant.ci95[0])
        share = half / (self.half * (constant.value if self.relative else 1.0))
        return float(share) if np.isfinite(share) else np.inf


def wanted_precision(text: str) -> Wanted:
    """What `--until` says: "E 3 %", "nu 0.02", "G 2 kPa".

    Parameters
    ----------
    text : str

    Returns
    -------
    Wanted

    Raises
    ------
    InputError                      something else
    """
    match = _WANTED.fullmatch(text.strip())
    units = {"%": 0.01, **({"": 1.0} if match and match[1] == "nu" else MODULUS_UNITS)}
    if match is None or match[3] not in units or not float(match[2]) > 0.0:
        raise InputError(
            f'--until is "{text}"; must be a constant and half the width of its 95 % interval: "E 3'
            ' %", "G 2 kPa", "nu 0.02"'
        )
    return Wanted(_CONSTANTS[match[1]], float(match[2]) * units[match[3]], match[3] == "%")


def wanted_lengths(until: Wanted | None) -> float:
    """Relative standard deviation to which lengths are to be known: a modulus goes with their
    square, and its interval, or that of nu, may become 2 % wider by them.

    Parameters
    ----------
    until : Wanted or None

    Returns
    -------
    float [-]
    """
    if until is None or not (until.relative or until.constant == "poisson_ratio"):
        return PRECISE
    sigma = until.half / HALF_95
    return max(PRECISE, 0.5 * np.sqrt((1.0 + _WIDER) ** 2 - 1.0) * sigma)

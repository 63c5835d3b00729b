"""Tractions under tools, as tests want them."""

import numpy as np

from palpate.records import SPREAD, ToolTraction
from palpate.records.contact import PRESSURES


def traction_of(profile: str, lever: float) -> ToolTraction:
    """A pressure of a known profile, and in proportion to it and to the distance from the centre an
    outward traction with a lever."""
    within = np.minimum(SPREAD, 1.0 - 1e-9)
    pressure = PRESSURES[profile](np.maximum(within, 1e-6)) * np.sqrt(1.0 - within**2)
    unit = ToolTraction(pressure, pressure * SPREAD)
    return ToolTraction(pressure, unit.outward * (lever / unit.lever))

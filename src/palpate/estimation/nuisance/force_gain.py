"""A force sensor whose readings are all too large or too small by the same factor."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.errors import quoted
from palpate.estimation.nuisance.nuisance import LoadedResponse, NuisanceParameter

# Source in the uncertainty budget, whichever the sensor.
_SOURCE = "gain of the force sensor"


@dataclass(frozen=True, slots=True)
class ForceGain:
    """Gain of the force sensor (`Nuisance`).

    Parameters
    ----------
    std : float [-]                 relative standard deviation, > 0
    sensor : str                    its name; empty where a session has one only
    """

    std: float
    sensor: str = ""

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """One, shared by all probings that this sensor measured."""
        return (NuisanceParameter(of_sensor(_SOURCE, self.sensor), self.std, of=_SOURCE),)

    def columns(self, at: LoadedResponse) -> Float[np.ndarray, "r p"]:
        """Displacement due to the force, times `std` (`Nuisance.columns`)."""
        return self.std * (at.response[:, :3] @ at.load[:3])[:, None]


def of_sensor(source: str, sensor: str) -> str:
    """Name of an error of a force sensor, such as "gain of the force sensor 'weights'".

    Parameters
    ----------
    source : str
    sensor : str                    its name; empty where a session has one only
    """
    return f"{source} {quoted(sensor)}" if sensor else source

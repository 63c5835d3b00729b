"""A force sensor whose axes are rotated relative to the object's frame."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.nuisance.force_gain import of_sensor
from palpate.estimation.nuisance.nuisance import LoadedResponse, NuisanceParameter


@dataclass(frozen=True, slots=True)
class ForceDirection:
    """Misalignment of the force sensor's axes (`Nuisance`).

    Parameters
    ----------
    std : float [rad]               rotation about each axis of the object's frame, > 0
    measured : (3,) bool            components that the sensor measured; the others are free
                                    unknowns, which a rotation of the sensor does not change
    sensor : str                    its name; empty where a session has one only
    """

    std: float
    measured: tuple[bool, bool, bool] = (True, True, True)
    sensor: str = ""

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """Three, shared by all probings that this sensor measured."""
        source = "turn of the force sensor"
        names = (f"{of_sensor(source, self.sensor)} about {axis}" for axis in "xyz")
        return tuple(NuisanceParameter(name, self.std, "rad", source) for name in names)

    def columns(self, at: LoadedResponse) -> Float[np.ndarray, "r p"]:
        """Displacement due to a small rotation of the force (`Nuisance.columns`)."""
        change = self.std * np.cross(np.eye(3), at.load[:3]) * np.array(self.measured)
        return at.response[:, :3] @ change.T

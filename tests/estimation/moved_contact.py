"""A contact of a half space that lies beside its stated place, and its error."""

from dataclasses import dataclass

import numpy as np
from estimation.half_space import HalfSpace

from palpate.estimation import Nuisance, NuisanceParameter, ProbeObservations
from palpate.pipeline.model.shared_errors import contact_error

__all__ = ["STEPS", "MovedContact", "contact_error_of"]

# Where else a contact is tried: in standard deviations along x and y.
STEPS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 1.0]])


@dataclass(frozen=True)
class MovedContact:
    """Displacement under contacts at `STEPS` beside the stated one, less that under it."""

    probe: ProbeObservations
    std: float

    def at(self, steps: np.ndarray, poisson_ratio: float) -> np.ndarray:
        offset = self.probe.response.offset - self.std * np.append(steps, 0.0)
        return HalfSpace(offset).value(poisson_ratio)[:, :3] @ self.probe.force

    def __call__(self, poisson_ratio: float) -> np.ndarray:
        stated = self.at(np.zeros(2), poisson_ratio)
        return np.stack([self.at(step, poisson_ratio) - stated for step in STEPS], axis=1)


def contact_error_of(probe: ProbeObservations, std: float = 5e-4) -> Nuisance:
    names = (f"contact point of {probe.name} toward +{axis}" for axis in "xy")
    parameters = tuple(NuisanceParameter(name, std, "m") for name in names)
    return contact_error(parameters, STEPS, MovedContact(probe, std), len(probe.position))

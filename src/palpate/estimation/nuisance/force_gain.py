"""A force sensor whose readings are all too large or too small by the same factor."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.estimation.nuisance.nuisance import NuisanceParameter


@dataclass(frozen=True, slots=True)
class ForceGain:
    """Gain of the force sensor (`Nuisance`).

    Parameters
    ----------
    std : float [-]                 relative standard deviation, > 0
    """

    std: float

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """One, shared by all probings."""
        return (NuisanceParameter("gain of the force sensor", self.std),)

    def columns(
        self,
        rows: Int[np.ndarray, " r"],
        response: Float[np.ndarray, "r c"],
        load: Float[np.ndarray, " c"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "r p"]:
        """Displacement due to the force, times `std` (`Nuisance.columns`)."""
        return self.std * (response[:, :3] @ load[:3])[:, None]

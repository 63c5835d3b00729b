"""Scale error of the measured displacements, independent along each axis."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.estimation.nuisance.nuisance import NuisanceParameter


@dataclass(frozen=True, slots=True)
class LengthScale:
    """Scale of the measured displacements along x, y and z (`Nuisance`).

    Parameters
    ----------
    std : float [-]                 relative standard deviation along each axis, > 0
    """

    std: float

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """Three, shared by all probings."""
        names = (f"scale of measured displacements along {axis}" for axis in "xyz")
        return tuple(NuisanceParameter(name, self.std, of="scale of lengths") for name in names)

    def columns(
        self,
        rows: Int[np.ndarray, " r"],
        response: Float[np.ndarray, "r c"],
        load: Float[np.ndarray, " c"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "r p"]:
        """Displacement times `std`, in the column of its axis (`Nuisance.columns`)."""
        along = rows[:, None] % 3 == np.arange(3)
        return np.where(along, self.std * (response @ load)[:, None], 0.0)

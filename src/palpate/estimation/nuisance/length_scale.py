"""Scale error of the measured displacements, independent along each axis."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.nuisance.nuisance import LoadedResponse, NuisanceParameter


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

    def columns(self, at: LoadedResponse) -> Float[np.ndarray, "r p"]:
        """Displacement times `std`, in the column of its axis (`Nuisance.columns`)."""
        along = at.rows[:, None] % 3 == np.arange(3)
        return np.where(along, self.std * at.displacement[:, None], 0.0)

"""What a material other than the assumed one adds at finite strain."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.estimation.nuisance.nuisance import NuisanceParameter


@dataclass(frozen=True, slots=True, eq=False)
class MaterialLaw:
    """Materials of the same constants differ at finite strain (`Nuisance`).

    Parameters
    ----------
    std : float [-]                 standard deviation of the difference, over what the assumed
                                    material differs by from a linear one, > 0
    correction : (n_rows,) float [m]    this
    """

    std: float
    correction: Float[np.ndarray, " n_rows"]

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """One for all probings."""
        return (NuisanceParameter("finite strain, in steps from linear to neo-Hookean,", self.std),)

    def columns(
        self,
        rows: Int[np.ndarray, " r"],
        response: Float[np.ndarray, "r c"],
        load: Float[np.ndarray, " c"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "r p"]:
        """Some more of the same correction (`Nuisance.columns`)."""
        return self.std * self.correction[rows, None]

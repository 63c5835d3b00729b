"""What a correction of the measurements may itself be off by."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.estimation.nuisance.nuisance import NuisanceParameter


@dataclass(frozen=True, slots=True, eq=False)
class CorrectionError:
    """Steps by which a correction may differ, whatever the constants (`Nuisance`).

    Parameters
    ----------
    parameters : tuple of p NuisanceParameter
    steps : (n_rows, p) float [m]   what one standard deviation of each adds to the correction
    """

    parameters: tuple[NuisanceParameter, ...]
    steps: Float[np.ndarray, "n_rows p"]

    def columns(
        self,
        rows: Int[np.ndarray, " r"],
        response: Float[np.ndarray, "r c"],
        load: Float[np.ndarray, " c"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "r p"]:
        """The steps themselves (`Nuisance.columns`)."""
        return self.steps[rows]

"""Error of a correction that was applied to the measurements."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.nuisance.nuisance import LoadedResponse, NuisanceParameter


@dataclass(frozen=True, slots=True, eq=False)
class CorrectionError:
    """Error of a correction, independent of the constants (`Nuisance`).

    Parameters
    ----------
    parameters : tuple of p NuisanceParameter
    steps : (n_rows, p) float [m]   change of the correction per standard deviation of each
    """

    parameters: tuple[NuisanceParameter, ...]
    steps: Float[np.ndarray, "n_rows p"]

    def columns(self, at: LoadedResponse) -> Float[np.ndarray, "r p"]:
        """The measured rows of `steps` (`Nuisance.columns`)."""
        return self.steps[at.rows]

"""Model error, estimated from a second model of the same body."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.nuisance.nuisance import LoadedResponse, NuisanceParameter


@dataclass(frozen=True, slots=True, eq=False)
class ModelStep:
    """An error with the difference of two models as its standard deviation (`Nuisance`).

    Parameters
    ----------
    name : str                      of the error, worded so that it can end a sentence
    model, alternative : function   Poisson's ratio, shear modulus [Pa] -> (n_rows, c) float:
                                    responses of both (`ResponseModel`)
    """

    name: str
    model: Callable[[float, float], Float[np.ndarray, "n_rows c"]]
    alternative: Callable[[float, float], Float[np.ndarray, "n_rows c"]]

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """One, shared by all probings."""
        return (NuisanceParameter(self.name, 1.0, of="mesh"),)

    def columns(self, at: LoadedResponse) -> Float[np.ndarray, "r p"]:
        """Displacement under `alternative` minus that under `model` (`Nuisance.columns`)."""
        constants = at.poisson_ratio, at.shear_modulus
        step = self.alternative(*constants)[at.rows] - self.model(*constants)[at.rows]
        return (step @ at.load)[:, None]

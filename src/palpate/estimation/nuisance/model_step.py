"""Model error, estimated from a second model of the same body."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.estimation.nuisance.nuisance import NuisanceParameter


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

    def columns(
        self,
        rows: Int[np.ndarray, " r"],
        response: Float[np.ndarray, "r c"],
        load: Float[np.ndarray, " c"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "r p"]:
        """Displacement under `alternative` minus that under `model` (`Nuisance.columns`)."""
        constants = poisson_ratio, 1.0 / load[3]
        step = self.alternative(*constants)[rows] - self.model(*constants)[rows]
        return (step @ load)[:, None]

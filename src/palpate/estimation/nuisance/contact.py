"""A tool that pressed beside the point that the session names, on a smaller or larger patch."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.estimation.nuisance.nuisance import NuisanceParameter


@dataclass(frozen=True, slots=True, eq=False)
class ContactError:
    """Place and radius of one probing's contact (`Nuisance`).

    Parameters
    ----------
    parameters : tuple of p NuisanceParameter
    derivative : function           Poisson's ratio -> (n_rows, p) float [m Pa]: displacement times
                                    shear modulus for one standard deviation of each parameter,
                                    under the measured force
    """

    parameters: tuple[NuisanceParameter, ...]
    derivative: Callable[[float], Float[np.ndarray, "n_rows p"]]

    def columns(
        self,
        rows: Int[np.ndarray, " r"],
        response: Float[np.ndarray, "r c"],
        load: Float[np.ndarray, " c"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "r p"]:
        """The model's own derivative, over the shear modulus (`Nuisance.columns`)."""
        return self.derivative(poisson_ratio)[rows] * load[3]

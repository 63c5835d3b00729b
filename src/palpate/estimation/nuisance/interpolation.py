"""What the fields between a mesh's vertices may be off by."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.estimation.nuisance.nuisance import NuisanceParameter


@dataclass(frozen=True, slots=True, eq=False)
class Interpolation:
    """Error of quadratics that are fitted to the vertices around, measured by fitting them to more
    of these (`Nuisance`).

    Parameters
    ----------
    fitted, wider : function        Poisson's ratio, shear modulus [Pa] -> (n_rows, c) float:
                                    response with the one and with the other (`ResponseModel`)
    """

    fitted: Callable[[float, float], Float[np.ndarray, "n_rows c"]]
    wider: Callable[[float, float], Float[np.ndarray, "n_rows c"]]

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """One for all probings."""
        name = "fields between the vertices (in steps to wider fits)"
        return (NuisanceParameter(name, 1.0, of="mesh"),)

    def columns(
        self,
        rows: Int[np.ndarray, " r"],
        response: Float[np.ndarray, "r c"],
        load: Float[np.ndarray, " c"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "r p"]:
        """The step from one to the other (`Nuisance.columns`)."""
        constants = poisson_ratio, 1.0 / load[3]
        step = self.wider(*constants)[rows] - self.fitted(*constants)[rows]
        return (step @ load)[:, None]

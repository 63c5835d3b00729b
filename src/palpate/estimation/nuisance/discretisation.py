"""Discretisation error that is left after refining the mesh at support rims and re-entrant
(hollow) edges."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.nuisance.nuisance import LoadedResponse, NuisanceParameter


@dataclass(frozen=True, slots=True, eq=False)
class Discretisation:
    """Discretisation error, from the change on a coarser mesh of the same object (`Nuisance`).

    Parameters
    ----------
    std : float [-]                 standard deviation of the remaining error as a fraction of the
                                    change from the coarser mesh to the finer one, > 0
    coarser : function              Poisson's ratio, shear modulus [Pa] -> (n_rows, c) float:
                                    response on the coarser mesh (`ResponseModel`)
    """

    std: float
    coarser: Callable[[float, float], Float[np.ndarray, "n_rows c"]]

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """One, shared by all probings."""
        name = "mesh (in steps from the given to the graded one)"
        return (NuisanceParameter(name, self.std, of="mesh"),)

    def columns(self, at: LoadedResponse) -> Float[np.ndarray, "r p"]:
        """`std` times the change from the coarser mesh to the finer one (`Nuisance.columns`)."""
        step = at.response - self.coarser(at.poisson_ratio, at.shear_modulus)[at.rows]
        return self.std * (step @ at.load)[:, None]

"""Elastic compliance of a support in excess of the model's: a bed of springs (Winkler)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.nuisance.nuisance import LoadedResponse, NuisanceParameter


@dataclass(frozen=True, slots=True, eq=False)
class SupportCompliance:
    """Compliance of some supports in excess of the model's (`Nuisance`).

    Negative compliance is unphysical, but a symmetric prior keeps noise alone from biasing the
    estimate towards soft supports.

    Parameters
    ----------
    supports : tuple of s int       numbers of the supports, from 1
    std : float [m/Pa]              of each: displacement over traction, > 0
    derivative : function           Poisson's ratio, index in `supports` -> (n_rows, c) float [unit
                                    of the response, per m]: derivative of the response with respect
                                    to shear modulus times compliance
    """

    supports: tuple[int, ...]
    std: float
    derivative: Callable[[float, int], Float[np.ndarray, "n_rows c"]]

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """One for each support, shared by all probings."""
        return tuple(
            NuisanceParameter(
                f"compliance of support {number}", self.std, "m/Pa", "compliance of supports"
            )
            for number in self.supports
        )

    def columns(self, at: LoadedResponse) -> Float[np.ndarray, "r p"]:
        """Displacement due to springs under each support (`Nuisance.columns`)."""
        moved = [
            self.derivative(at.poisson_ratio, k)[at.rows] @ at.load
            for k in range(len(self.supports))
        ]
        return self.std * at.shear_modulus * np.stack(moved, axis=1)

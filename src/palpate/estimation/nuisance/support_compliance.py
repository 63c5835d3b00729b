"""A support that gives under the object as a bed of springs would, where the model has it rigid."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.estimation.nuisance.nuisance import NuisanceParameter


@dataclass(frozen=True, slots=True, eq=False)
class SupportCompliance:
    """How much further than the model says some supports give (`Nuisance`).

    Less than nothing is no compliance, but a prior that is as wide on that side keeps the estimate
    from being drawn to soft supports by noise alone.

    Parameters
    ----------
    supports : tuple of s int       their numbers, from 1
    std : float [m/Pa]              of each: displacement over traction, > 0
    derivative : function           Poisson's ratio, place of a support -> (n_rows, c) float [1/m
                                    times the response's]: of the response with respect to shear
                                    modulus times compliance
    """

    supports: tuple[int, ...]
    std: float
    derivative: Callable[[float, int], Float[np.ndarray, "n_rows c"]]

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """One for each support."""
        return tuple(
            NuisanceParameter(
                f"compliance of support {number}", self.std, "m/Pa", "compliance of supports"
            )
            for number in self.supports
        )

    def columns(
        self,
        rows: Int[np.ndarray, " r"],
        response: Float[np.ndarray, "r c"],
        load: Float[np.ndarray, " c"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "r p"]:
        """What springs under the support let the points move (`Nuisance.columns`)."""
        modulus = 1.0 / load[3]
        moved = [self.derivative(poisson_ratio, k)[rows] @ load for k in range(len(self.supports))]
        return self.std * modulus * np.stack(moved, axis=1)

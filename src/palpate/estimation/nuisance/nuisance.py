"""Errors of a measurement that are parameters with a prior: what every kind of them gives.

A force gauge that reads 1 % too much, a tool that pressed half a millimetre beside the point that
the session names, an object that lies a little turned: such errors move all points of a probing
together, or all probings. No number of points averages them away. Each is a parameter b with a
prior of mean 0, eliminated along with the true forces. The prediction is linear in b but for the
kinds that say otherwise (`CurvedNuisance`): about the estimate it is linear in these as well.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, slots=True)
class NuisanceParameter:
    """One such error; parameters of the same name in several probings are one and the same.

    Parameters
    ----------
    name : str                      in words that end a sentence: "force gain of the sensor"
    std : float                     of the prior, > 0
    unit : str                      of `std`: "m", "rad", or empty for a share
    of : str                        what the uncertainty budget counts it to, such as "pose of the
                                    object"; empty: it is a source of its own
    """

    name: str
    std: float
    unit: str = ""
    of: str = ""

    @property
    def source(self) -> str:
        """What the uncertainty budget counts it to."""
        return self.of or self.name


@runtime_checkable
class Nuisance(Protocol):
    """A kind of error, as it shows in one probing."""

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """The p parameters of this kind in this probing."""
        ...

    def columns(
        self,
        rows: Int[np.ndarray, " r"],
        response: Float[np.ndarray, "r c"],
        load: Float[np.ndarray, " c"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "r p"]:
        """Change of the displacements for one prior standard deviation of each parameter.

        Parameters
        ----------
        rows : (r,) int             measured rows of the probing (`ResponseModel`)
        response : (r, c) float     of these rows
        load : (c,) float           what the response is multiplied with: force [N] and 1, over the
                                    shear modulus [Pa], then motions
        poisson_ratio : float [-]   of the response

        Returns
        -------
        (r, p) float [m]
        """
        ...


@runtime_checkable
class CurvedNuisance(Nuisance, Protocol):
    """A kind of error that may be so large that its square counts; it belongs to one probing."""

    def curvature(
        self,
        rows: Int[np.ndarray, " r"],
        load: Float[np.ndarray, " c"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "r p p"]:
        """Second derivative of the displacements, per prior standard deviation of each parameter.

        Parameters
        ----------
        rows, load, poisson_ratio   as `Nuisance.columns`

        Returns
        -------
        (r, p, p) float [m]
        """
        ...

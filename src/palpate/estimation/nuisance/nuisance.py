"""Systematic errors as nuisance parameters with a prior: the interface of every kind.

A force gauge that reads 1 % too much, a tool that pressed half a millimetre off the stated point,
an object that lies slightly rotated: such errors affect all points of a probing, or all probings,
together. No number of points averages them out. Each is a parameter b with a prior of zero mean,
eliminated together with the true forces. The prediction is linear in b except for kinds of
`CurvedNuisance`, which are linearised about the estimate.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, slots=True)
class NuisanceParameter:
    """One nuisance parameter; those of the same name in several probings are one parameter.

    Parameters
    ----------
    name : str                      worded so that it can end a sentence: "gain of the force sensor"
    std : float                     of the prior, > 0
    unit : str                      of `std`: "m", "rad", "m/Pa", or empty for a relative error
    of : str                        source in the uncertainty budget that it is part of, such as
                                    "pose of the object"; empty: it is a source of its own
    """

    name: str
    std: float
    unit: str = ""
    of: str = ""

    @property
    def source(self) -> str:
        """Source in the uncertainty budget that it is part of."""
        return self.of or self.name


@dataclass(frozen=True, slots=True, eq=False)
class LoadedResponse:
    """Response of one probing under its load: what the effect of an error depends on.

    Parameters
    ----------
    rows : (r,) int                 measured rows of the probing (`ResponseModel`)
    response : (r, c) float         of these rows
    load : (c,) float               vector that multiplies the response: force [N] and 1, both over
                                    the shear modulus [Pa], then motions
    poisson_ratio : float [-]       at which the response was taken
    """

    rows: Int[np.ndarray, " r"]
    response: Float[np.ndarray, "r c"]
    load: Float[np.ndarray, " c"]
    poisson_ratio: float

    @property
    def displacement(self) -> Float[np.ndarray, " r"]:
        """Displacement of the rows, (r,) [m]."""
        return self.response @ self.load

    @property
    def shear_modulus(self) -> float:
        """Shear modulus [Pa] in the load."""
        return float(1.0 / self.load[3])


@runtime_checkable
class Nuisance(Protocol):
    """A kind of error and its effect on one probing."""

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """The p parameters of this kind in this probing."""
        ...

    def columns(self, at: LoadedResponse) -> Float[np.ndarray, "r p"]:
        """Change in displacement per prior standard deviation of each parameter, (r, p) [m].

        Parameters
        ----------
        at : LoadedResponse         of the probing
        """
        ...


@runtime_checkable
class CurvedNuisance(Nuisance, Protocol):
    """A kind of error so large that second order matters; it belongs to one probing."""

    def curvature(self, at: LoadedResponse) -> Float[np.ndarray, "r p p"]:
        """Second derivative of the displacements, per prior standard deviation of each parameter,
        (r, p, p) [m].

        Parameters
        ----------
        at : LoadedResponse         of the probing
        """
        ...

"""Errors that points or probings share, as parameters with a prior.

A force gauge that reads 1 % too much, a tool that pressed half a millimetre off the stated point,
an object that lies slightly rotated: such errors affect all points of a probing, or all probings,
together. No number of points averages them out. Each is a parameter b with a Gaussian prior of
zero mean, fitted along with the constants.
"""

from collections.abc import Callable
from dataclasses import dataclass

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
    is_model_error : bool           an error of the model, whose shape is known only roughly: what
                                    it moves shows how large the model's own error is there
    """

    name: str
    std: float
    unit: str = ""
    of: str = ""
    is_model_error: bool = False

    @property
    def source(self) -> str:
        """Source in the uncertainty budget that it is part of."""
        return self.of or self.name


@dataclass(frozen=True, slots=True, eq=False)
class ResponseTerms:
    """Response of some rows of a probing at one Poisson's ratio: what effects of errors depend on.

    The load on a body of shear modulus G is l = (force / G, 1 / G, motions), one entry for each
    column of `ResponseModel`. Term 0 multiplies l, so most of it scales with 1 / G; term 1, where
    there is one, multiplies G l.

    Parameters
    ----------
    rows : (r,) int                 rows of the probing (`ResponseModel`)
    value : (r, t, c) float         displacement per unit of each load, in t = 1 or 2 terms
    poisson_ratio : float [-]
    """

    rows: Int[np.ndarray, " r"]
    value: Float[np.ndarray, "r t c"]
    poisson_ratio: float


@dataclass(frozen=True, slots=True, eq=False)
class Nuisance:
    """An error that points or probings share, with its effect on one probing.

    Parameters
    ----------
    parameters : tuple of p NuisanceParameter
    effects : function              `ResponseTerms` of the probing -> (r, s, c, p) float: change of
                                    the response per prior standard deviation of each parameter, in
                                    s = 1 or 2 terms
    curvature : function or None    `ResponseTerms` -> (r, p, p) float [m Pa]: second derivative of
                                    displacement times shear modulus, per prior standard deviation
                                    of each; for errors so large that second order matters, which
                                    belong to one probing
    """

    parameters: tuple[NuisanceParameter, ...]
    effects: Callable[[ResponseTerms], Float[np.ndarray, "r s c p"]]
    curvature: Callable[[ResponseTerms], Float[np.ndarray, "r p p"]] | None = None


def padded(effects: Float[np.ndarray, "r s c p"], terms: int) -> Float[np.ndarray, "r t c p"]:
    """Effects with as many terms as asked for; those that are missing are zero.

    Parameters
    ----------
    effects : (r, s, c, p) float
    terms : int                     at least s

    Returns
    -------
    (r, terms, c, p) float
    """
    missing = terms - effects.shape[1]
    return effects if not missing else np.pad(effects, [(0, 0), (0, missing), (0, 0), (0, 0)])


def fixed_displacement(
    columns: Float[np.ndarray, "r p"], at: ResponseTerms
) -> Float[np.ndarray, "r 2 c p"]:
    """Effects that move points by given amounts, whatever the load and the material.

    Parameters
    ----------
    columns : (r, p) float [m]      per prior standard deviation of each parameter
    at : ResponseTerms

    Returns
    -------
    (r, 2, c, p) float
    """
    effects = np.zeros((len(columns), 2, at.value.shape[2], columns.shape[1]))
    # Entry 3 of G l is 1.
    effects[:, 1, 3] = columns
    return effects

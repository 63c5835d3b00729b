"""A tool that pressed beside the point that the session names, on a smaller or larger patch."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Float, Int

from palpate.estimation.nuisance.nuisance import NuisanceParameter


@dataclass(frozen=True, slots=True, eq=False)
class ContactError:
    """Place and radius of one probing's contact (`CurvedNuisance`).

    A place is known to a tenth of the tool or less, and two or three standard deviations happen:
    what a tool does to the points beside it is then as much its square as itself.

    Parameters
    ----------
    parameters : tuple of p NuisanceParameter
    change : function               Poisson's ratio -> (n_rows, m) float [m Pa]: displacement times
                                    shear modulus under each of m other contacts, less that under
                                    the stated one, under the measured force
    first : (m, p) float            which combinations of these are the derivatives by one standard
                                    deviation of each parameter
    second : (m, p, p) float        and which are the second derivatives
    count : int                     of the points; rows behind theirs are of the tool, which the
                                    contact moves along with
    """

    parameters: tuple[NuisanceParameter, ...]
    change: Callable[[float], Float[np.ndarray, "n_rows m"]]
    first: Float[np.ndarray, "m p"]
    second: Float[np.ndarray, "m p p"]
    count: int

    def columns(
        self,
        rows: Int[np.ndarray, " r"],
        response: Float[np.ndarray, "r c"],
        load: Float[np.ndarray, " c"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "r p"]:
        """The model's own derivative, over the shear modulus (`Nuisance.columns`)."""
        return self.change(poisson_ratio)[rows] @ (load[3] * self.first)

    def curvature(
        self,
        rows: Int[np.ndarray, " r"],
        load: Float[np.ndarray, " c"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "r p p"]:
        """The model's own second derivative, over the shear modulus (`CurvedNuisance.curvature`);
        none where the contacts show none."""
        found = np.tensordot(self.change(poisson_ratio)[rows], load[3] * self.second, axes=1)
        found[rows >= 3 * self.count] = 0.0
        return found


def contact_error(
    parameters: tuple[NuisanceParameter, ...],
    steps: Float[np.ndarray, "m p"],
    change: Callable[[float], Float[np.ndarray, "n_rows m"]],
    count: int,
) -> ContactError:
    """The error of a contact, from what other contacts than the stated one change.

    Its derivatives are those of the polynomial that goes through all of them, with as many terms as
    there are changes.

    Parameters
    ----------
    parameters : tuple of p NuisanceParameter
    steps : (m, p) float            how many standard deviations of each parameter the m other
                                    contacts differ from the stated one
    change, count                   as `ContactError`

    Returns
    -------
    ContactError
    """
    p = len(parameters)
    pairs = [x for x in combinations_with_replacement(range(p), 2) if _shown(steps, *x)]
    products = [steps[:, i] * steps[:, j] / (1 + (i == j)) for i, j in pairs]
    weights = np.linalg.inv(np.column_stack([steps, *products])).T
    second = np.zeros((len(steps), p, p))
    for weight, (i, j) in zip(weights[:, p:].T, pairs, strict=True):
        second[:, i, j] = second[:, j, i] = weight
    return ContactError(parameters, change, weights[:, :p], second, count)


def _shown(steps: Float[np.ndarray, "m p"], i: int, j: int) -> bool:
    """Whether the contacts lie so that the product of two parameters can be told apart."""
    if i == j:
        return bool(np.unique(steps[np.flatnonzero(steps[:, i]), i]).size > 1)
    return bool((steps[:, i] * steps[:, j]).any())

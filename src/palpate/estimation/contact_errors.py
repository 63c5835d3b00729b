"""Contact errors: the tool pressed off the stated point, or on a smaller or larger patch; it slid
along the surface."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Float

from palpate.estimation.nuisance import NuisanceParameter, ResponseTerms, fixed_displacement


@dataclass(frozen=True, slots=True, eq=False)
class ContactError:
    """Error in position and radius of one probing's contact (`CurvedNuisance`).

    Its standard deviation is about a tenth of the tool's size, and errors of two or three standard
    deviations occur: at points close to the tool the second-order effect is then as large as the
    first-order one.

    Parameters
    ----------
    parameters : tuple of p NuisanceParameter
    change : function               Poisson's ratio -> (n_rows, m) float [m Pa]: displacement times
                                    shear modulus for each of m perturbed contacts, minus that for
                                    the stated one, under the measured force
    first : (m, p) float            combinations of these changes that give the derivative per
                                    standard deviation of each parameter
    second : (m, p, p) float        combinations that give the second derivatives
    count : int                     number of points; rows after theirs belong to the tip, which
                                    moves with the contact
    """

    parameters: tuple[NuisanceParameter, ...]
    change: Callable[[float], Float[np.ndarray, "n_rows m"]]
    first: Float[np.ndarray, "m p"]
    second: Float[np.ndarray, "m p p"]
    count: int

    def effects(self, at: ResponseTerms) -> Float[np.ndarray, "r 1 c p"]:
        """First derivatives from the perturbed contacts (`Nuisance.effects`)."""
        effects = np.zeros((len(at.rows), 1, at.value.shape[2], len(self.parameters)))
        # Entry 3 of the load is 1 / G.
        effects[:, 0, 3] = self.change(at.poisson_ratio)[at.rows] @ self.first
        return effects

    def curvature(self, at: ResponseTerms) -> Float[np.ndarray, "r p p"]:
        """Second derivatives from the perturbed contacts (`CurvedNuisance.curvature`); zero in the
        rows of the tip."""
        curvature = np.tensordot(self.change(at.poisson_ratio)[at.rows], self.second, axes=1)
        curvature[at.rows >= 3 * self.count] = 0.0
        return curvature


@dataclass(frozen=True, slots=True, eq=False)
class ToolSlip:
    """Sliding of the tool of one probing along the surface (`Nuisance`): the tool's displacement,
    which the arm measures, is that of the surface along the normal only.

    Parameters
    ----------
    parameters : tuple of 2 NuisanceParameter       one along each tangent
    tangents : (2, 3) float [-]                     unit tangents of the surface under the tool
    count : int                                     as `ContactError`
    """

    parameters: tuple[NuisanceParameter, NuisanceParameter]
    tangents: Float[np.ndarray, "2 3"]
    count: int

    def effects(self, at: ResponseTerms) -> Float[np.ndarray, "r 2 c 2"]:
        """Displacement of the tip along the tangents, zero elsewhere (`Nuisance.effects`)."""
        component = at.rows - 3 * self.count
        columns = np.zeros((len(at.rows), 2))
        columns[component >= 0] = self.tangents.T[component[component >= 0]]
        return fixed_displacement(columns * [each.std for each in self.parameters], at)


def contact_error(
    parameters: tuple[NuisanceParameter, ...],
    steps: Float[np.ndarray, "m p"],
    change: Callable[[float], Float[np.ndarray, "n_rows m"]],
    count: int,
) -> ContactError:
    """Make the error of a contact from the changes that perturbed contacts cause.

    Its derivatives are those of the interpolating polynomial, which has as many terms as there are
    perturbed contacts.

    Parameters
    ----------
    parameters : tuple of p NuisanceParameter
    steps : (m, p) float            offset of each of m perturbed contacts from the stated one, in
                                    standard deviations of each parameter
    change, count                   as `ContactError`

    Returns
    -------
    ContactError
    """
    p = len(parameters)
    pairs = [
        pair for pair in combinations_with_replacement(range(p), 2) if _is_determined(steps, *pair)
    ]
    products = [steps[:, i] * steps[:, j] / (1 + (i == j)) for i, j in pairs]
    weights = np.linalg.inv(np.column_stack([steps, *products])).T
    second = np.zeros((len(steps), p, p))
    for weight, (i, j) in zip(weights[:, p:].T, pairs, strict=True):
        second[:, i, j] = second[:, j, i] = weight
    return ContactError(parameters, change, weights[:, :p], second, count)


def _is_determined(steps: Float[np.ndarray, "m p"], i: int, j: int) -> bool:
    """Whether the perturbed contacts determine the second-order term of two parameters."""
    if i == j:
        return bool(np.unique(steps[np.flatnonzero(steps[:, i]), i]).size > 1)
    return bool((steps[:, i] * steps[:, j]).any())

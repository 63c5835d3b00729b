"""Contact errors: the tool pressed off the stated point, or on a smaller or larger patch; it slid
along the surface."""

from collections.abc import Callable
from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Float

from palpate.estimation import Nuisance, NuisanceParameter, ResponseTerms, fixed_displacement


def contact_error(
    parameters: tuple[NuisanceParameter, ...],
    steps: Float[np.ndarray, "m p"],
    change: Callable[[float], Float[np.ndarray, "n_rows m"]],
    count: int,
) -> Nuisance:
    """Error in position and radius of one probing's contact, from the changes that perturbed
    contacts cause.

    Its standard deviation is about a tenth of the tool's size, and errors of two or three standard
    deviations occur: at points close to the tool the second-order effect is then as large as the
    first-order one. Derivatives are those of the interpolating polynomial, which has as many terms
    as there are perturbed contacts.

    Parameters
    ----------
    parameters : tuple of p NuisanceParameter
    steps : (m, p) float            offset of each of m perturbed contacts from the stated one, in
                                    standard deviations of each parameter
    change : function               Poisson's ratio -> (n_rows, m) float [m Pa]: displacement times
                                    shear modulus for each of these, minus that for the stated one,
                                    under the measured force
    count : int                     number of points; rows after theirs belong to the tip, which
                                    moves with the contact: to first order only

    Returns
    -------
    Nuisance
    """
    p = len(parameters)
    pairs = [
        pair for pair in combinations_with_replacement(range(p), 2) if _is_determined(steps, *pair)
    ]
    products = [steps[:, i] * steps[:, j] / (1 + (i == j)) for i, j in pairs]
    weights = np.linalg.inv(np.column_stack([steps, *products])).T
    first, second = weights[:, :p], np.zeros((len(steps), p, p))
    for weight, (i, j) in zip(weights[:, p:].T, pairs, strict=True):
        second[:, i, j] = second[:, j, i] = weight

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r 1 c p"]:
        moved = np.zeros((len(at.rows), 1, at.value.shape[2], p))
        # Entry 3 of the load is 1 / G.
        moved[:, 0, 3] = change(at.poisson_ratio)[at.rows] @ first
        return moved

    def curvature(at: ResponseTerms) -> Float[np.ndarray, "r p p"]:
        bent = np.tensordot(change(at.poisson_ratio)[at.rows], second, axes=1)
        bent[at.rows >= 3 * count] = 0.0
        return np.asarray(bent)

    return Nuisance(parameters, effects, curvature)


def tool_slip(
    parameters: tuple[NuisanceParameter, NuisanceParameter],
    tangents: Float[np.ndarray, "2 3"],
    count: int,
) -> Nuisance:
    """Sliding of the tool of one probing along the surface: the tool's displacement, which the arm
    measures, is that of the surface along the normal only.

    Parameters
    ----------
    parameters : tuple of 2 NuisanceParameter       one along each tangent
    tangents : (2, 3) float [-]                     unit tangents of the surface under the tool
    count : int                                     as `contact_error`

    Returns
    -------
    Nuisance
    """

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r 2 c 2"]:
        component = at.rows - 3 * count
        columns = np.zeros((len(at.rows), 2))
        columns[component >= 0] = tangents.T[component[component >= 0]]
        return fixed_displacement(columns * [each.std for each in parameters], at)

    return Nuisance(parameters, effects)


def _is_determined(steps: Float[np.ndarray, "m p"], i: int, j: int) -> bool:
    """Whether the perturbed contacts determine the second-order term of two parameters."""
    if i == j:
        return bool(np.unique(steps[np.flatnonzero(steps[:, i]), i]).size > 1)
    return bool((steps[:, i] * steps[:, j]).any())

"""The same body at finite strain: what the linear model leaves out when it is pressed far."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from palpate.errors import NotConvergedError, SingularSystemError
from palpate.lab.bodies.finite_elements import Body, free_part, quadratic_basis, stiffness_matrix
from palpate.lab.bodies.sparse_cholesky import factorise
from palpate.optional_imports import late_import

_MAX_STEPS = 25
# Forces out of balance, of the load: Newton's last step leaves rounding.
_BALANCED = 1e-9
_MAX_HALVINGS = 8


def solve_finite(body: Body, load: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Displacement at finite strain under nodal forces, a dead load.

    The energy per volume at rest is mu/2 (tr C - 3) - mu ln J + lambda/2 (ln J)^2, with C = F^T F,
    J = det F, and mu and lambda of the body's shear modulus and Poisson's ratio: small strains are
    Hooke's.

    Parameters
    ----------
    body : Body
    load : (n, 3) float [N]         forces on the nodes

    Returns
    -------
    (n, 3) float [m]

    Raises
    ------
    NotConvergedError               no stable equilibrium is found: the body buckles, or the load is
                                    too large for the elements

    Source
    ------
    Bonet and Wood, Nonlinear continuum mechanics for finite element analysis (2nd ed. 2008),
    section 6.4.3; tangent by its differential. Newton with steps shortened until no element turns
    over and the energy less the load's work does not rise; where that fails the load is applied in
    smaller parts.
    """
    basis = quadratic_basis(body.solid)
    displacement = np.zeros_like(load)
    done, part = 0.0, 1.0
    while done < 1.0:
        share = min(1.0, done + part)
        found = _equilibrium(body, basis, share * load, displacement)
        if found is not None:
            displacement, done = found, share
            continue
        part *= 0.5
        if part < 0.5**_MAX_HALVINGS:
            raise NotConvergedError(
                f"no equilibrium beyond {100 * done:.1f} % of the load: the body buckles, or is"
                " pressed farther than its elements bear; press less, or use smaller elements there"
            )
    return displacement


def energy(body: Body, basis: Any, displacement: Float[np.ndarray, "n 3"]) -> float:
    """Energy that a deformed body stores.

    Parameters
    ----------
    body : Body                     its constants
    basis : skfem.Basis             of `quadratic_basis`
    displacement : (n, 3) float [m]

    Returns
    -------
    float [J]                       infinite where an element is turned over

    Source
    ------
    Bonet and Wood (2008), section 6.4.3.
    """
    mu, lame = body.lame
    gradient = deformation_gradient(basis, displacement)
    volume = _determinant(gradient)
    if (volume <= 0.0).any():
        return np.inf
    log = np.log(volume)
    squares = (gradient**2).sum(axis=(0, 1))
    density = 0.5 * mu * (squares - 3.0) - mu * log + 0.5 * lame * log**2
    return float((density * basis.dx).sum())


def inner_forces(
    body: Body, basis: Any, displacement: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Derivative of the stored energy by the nodes' displacement.

    Parameters
    ----------
    body : Body                     its constants
    basis : skfem.Basis             of `quadratic_basis`
    displacement : (n, 3) float [m]

    Returns
    -------
    (n, 3) float [N]                NaN where an element is turned over

    Raises
    ------
    InputError                      scikit-fem is not installed
    """
    mu, lame = body.lame
    gradient = deformation_gradient(basis, displacement)
    log = np.log(_determinant(gradient))
    stress = mu * gradient + (lame * log - mu) * _inverse_transposed(gradient)
    skfem = late_import("skfem", extra="fem", purpose="the finite elements of a specimen")
    forms = [skfem.LinearForm(lambda v, _, row=row: (row * v.grad).sum(axis=0)) for row in stress]
    return np.stack([form.assemble(basis) for form in forms], axis=1)


def tangent_moduli(
    body: Body, basis: Any, displacement: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "3 3 3 3 m q"]:
    """Derivative of the stress component aA by the displacement gradient bB.

    With H = F^-T: mu delta_ab delta_AB + (mu - lambda ln J) H_aB H_bA + lambda H_aA H_bB.

    Parameters
    ----------
    body : Body                     its constants
    basis : skfem.Basis             of `quadratic_basis`
    displacement : (n, 3) float [m]

    Returns
    -------
    (3, 3, 3, 3, m, q) float [Pa]   indices a, A, b, B, element, quadrature point
    """
    mu, lame = body.lame
    gradient = deformation_gradient(basis, displacement)
    inverse = _inverse_transposed(gradient)
    falling = (mu - lame * np.log(_determinant(gradient))) * inverse
    moduli = lame * np.einsum("aAmq,bBmq->aAbBmq", inverse, inverse)
    moduli += np.einsum("aBmq,bAmq->aAbBmq", falling, inverse)
    for a, i in np.ndindex(3, 3):
        moduli[a, i, a, i] += mu
    return moduli


def deformation_gradient(
    basis: Any, displacement: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "3 3 m q"]:
    """F = I + du/dX at every quadrature point.

    Parameters
    ----------
    basis : skfem.Basis             of `quadratic_basis`
    displacement : (n, 3) float [m]

    Returns
    -------
    (3, 3, m, q) float [-]          row: component of the place now; column: direction at rest
    """
    slopes = np.stack([basis.interpolate(component).grad for component in displacement.T])
    return np.eye(3)[:, :, None, None] + slopes


def _determinant(gradient: Float[np.ndarray, "3 3 m q"]) -> Float[np.ndarray, "m q"]:
    return np.linalg.det(gradient.transpose(2, 3, 0, 1))


def _inverse_transposed(gradient: Float[np.ndarray, "3 3 m q"]) -> Float[np.ndarray, "3 3 m q"]:
    return np.linalg.inv(gradient.transpose(2, 3, 0, 1)).transpose(3, 2, 0, 1)


def _equilibrium(
    body: Body, basis: Any, load: np.ndarray, displacement: np.ndarray
) -> np.ndarray | None:
    """Equilibrium near a displacement, by Newton's method; None where it does not converge."""
    free = ~body.held
    scale = np.linalg.norm(load[free])

    def potential(u: np.ndarray) -> float:
        return energy(body, basis, u) - float((load * u).sum())

    for _ in range(_MAX_STEPS):
        missing = load - inner_forces(body, basis, displacement)
        if np.linalg.norm(missing[free]) <= _BALANCED * scale:
            return displacement
        matrix = stiffness_matrix(basis, tangent_moduli(body, basis, displacement))
        try:
            factor = factorise(free_part(matrix, body.held), body.solid.nodes[free])
        except SingularSystemError:
            return None
        change = np.zeros_like(displacement)
        change[free] = factor.solve(missing[free].reshape(-1, 1)).reshape(-1, 3)
        shortened = _shortened(potential, displacement, change)
        if shortened is None:
            return None
        displacement = shortened
    return None


def _shortened(
    potential: Callable[[np.ndarray], float], displacement: np.ndarray, change: np.ndarray
) -> np.ndarray | None:
    """The end of the step, halved until the potential falls (rounding apart); None if it never
    does."""
    before = potential(displacement)
    for _ in range(_MAX_HALVINGS):
        after = potential(displacement + change)
        if after <= before + 1e-12 * abs(before):
            return displacement + change
        change = 0.5 * change
    return None

"""The same body at finite strain: what the linear model leaves out when it is pressed far."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.errors import NotConvergedError, SingularSystemError
from palpate.lab.bodies.finite_elements import (
    Body,
    free_part,
    quadratic_basis,
    solve_free,
    stiffness_matrix,
)
from palpate.lab.bodies.newton import Unknowns, find_in_parts, find_rest
from palpate.lab.bodies.sparse_cholesky import Cholesky, factorise
from palpate.optional_imports import late_import

# Forces out of balance, of the load: Newton's last step leaves rounding.
_BALANCED = 1e-9


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
    scale = float(np.linalg.norm(load[~body.held]))

    def find(share: float, at: Unknowns) -> Unknowns | None:
        loaded = _Loaded(body, basis, share * load)
        return find_rest(loaded, at, balanced=_BALANCED * share * scale)

    found, done = find_in_parts(find, np.zeros(load.size))
    if done < 1.0:
        raise NotConvergedError(
            f"no equilibrium beyond {100 * done:.1f} % of the load: the body buckles, or is"
            " pressed farther than its elements bear; press less, or use smaller elements there"
        )
    return found.reshape(-1, 3)


@dataclass(frozen=True, slots=True, eq=False)
class _Loaded:
    """A body under dead loads, in the displacement of all nodes (`Potential`)."""

    body: Body
    basis: Any
    load: Float[np.ndarray, "n 3"]

    def value(self, at: Unknowns) -> float:
        return energy(self.body, self.basis, at.reshape(-1, 3)) - float(self.load.ravel() @ at)

    def forces(self, at: Unknowns) -> Unknowns:
        missing = self.load - inner_forces(self.body, self.basis, at.reshape(-1, 3))
        missing[self.body.held] = 0.0
        return missing.ravel()

    def step(self, at: Unknowns, forces: Unknowns) -> Unknowns | None:
        moduli = tangent_moduli(self.body, self.basis, at.reshape(-1, 3))
        factor = stable_factor(self.body, stiffness_matrix(self.basis, moduli))
        return None if factor is None else solve_free(self.body.held, factor, forces[:, None])[:, 0]


def stable_factor(body: Body, tangent: csr_array) -> Cholesky | None:
    """Factor of a tangent's free part.

    Parameters
    ----------
    body : Body
    tangent : (3 n, 3 n) sparse [N/m]

    Returns
    -------
    Cholesky or None                None where the body is not stable
    """
    try:
        return factorise(free_part(tangent, body.held), body.solid.nodes[~body.held])
    except SingularSystemError:
        return None


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

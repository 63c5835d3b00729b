"""A body at finite strain: the nonlinearity that the linear model neglects."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.errors import NotConvergedError, SingularSystemError
from palpate.optional_imports import late_import
from palpate.solids.finite_elements import (
    Body,
    free_part,
    quadratic_basis,
    solve_free,
    stiffness_matrix,
)
from palpate.solids.laws import Law, NeoHookean
from palpate.solids.newton import Unknowns, find_equilibrium, find_in_increments
from palpate.solids.sparse_cholesky import Cholesky, factorise

# Tolerance on the residual forces, relative to the load: Newton's last step leaves only rounding.
_FORCE_TOLERANCE = 1e-9

LawOf = Callable[[float, float], Law]


def solve_finite(
    body: Body, load: Float[np.ndarray, "n 3"], *, law: LawOf = NeoHookean
) -> Float[np.ndarray, "n 3"]:
    """Displacement at finite strain under dead nodal loads.

    Parameters
    ----------
    body : Body                     gives mesh, fixed nodes and constants
    load : (n, 3) float [N]         forces on the nodes
    law : function                  Lame's constants mu and lambda [Pa] -> `Law`

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
    chapter 9: total Lagrangian elements. Newton's method with step halving until no element is
    inverted and the potential does not increase (`find_equilibrium`); if that fails, the
    load is applied in smaller increments.
    """
    basis = quadratic_basis(body.solid)
    scale = float(np.linalg.norm(load[~body.held]))

    def find(fraction: float, at: Unknowns) -> Unknowns | None:
        loaded = _Loaded(body, law(*body.lame), basis, fraction * load)
        return find_equilibrium(loaded, at, tolerance=_FORCE_TOLERANCE * fraction * scale)

    found, done = find_in_increments(find, np.zeros(load.size))
    if done < 1.0:
        raise NotConvergedError(
            f"no equilibrium beyond {100 * done:.1f} % of the load: the body buckles, or is"
            " pressed farther than its elements bear; press less, or use smaller elements there"
        )
    return found.reshape(-1, 3)


@dataclass(frozen=True, slots=True, eq=False)
class _Loaded:
    """Potential of a body under dead loads (`Potential`). Unknowns: displacements of all nodes."""

    body: Body
    law: Law
    basis: Any
    load: Float[np.ndarray, "n 3"]

    def value(self, at: Unknowns) -> float:
        return energy(self.law, self.basis, at.reshape(-1, 3)) - float(self.load.ravel() @ at)

    def forces(self, at: Unknowns) -> Unknowns:
        missing = self.load - internal_forces(self.law, self.basis, at.reshape(-1, 3))
        missing[self.body.held] = 0.0
        return missing.ravel()

    def step(self, at: Unknowns, forces: Unknowns) -> Unknowns | None:
        matrix = tangent(self.law, self.basis, at.reshape(-1, 3))
        factor = stable_factor(self.body, matrix)
        return None if factor is None else solve_free(self.body.held, factor, forces[:, None])[:, 0]


def stable_factor(body: Body, matrix: csr_array) -> Cholesky | None:
    """Cholesky factor of the free part of a tangent stiffness.

    Parameters
    ----------
    body : Body
    matrix : (3 n, 3 n) sparse [N/m]    tangent stiffness

    Returns
    -------
    Cholesky or None                None if it is not positive definite: no stable equilibrium
    """
    try:
        return factorise(free_part(matrix, body.held), body.solid.nodes[~body.held])
    except SingularSystemError:
        return None


def energy(law: Law, basis: Any, displacement: Float[np.ndarray, "n 3"]) -> float:
    """Strain energy of a deformed body.

    Parameters
    ----------
    law : Law
    basis : skfem.Basis             of `quadratic_basis`
    displacement : (n, 3) float [m]

    Returns
    -------
    float [J]                       infinite if an element is inverted
    """
    gradient = deformation_gradient(basis, displacement)
    if (np.linalg.det(gradient.transpose(2, 3, 0, 1)) <= 0.0).any():
        return np.inf
    return float((law.density(gradient) * basis.dx).sum())


def internal_forces(
    law: Law, basis: Any, displacement: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Internal forces: derivative of the strain energy with respect to the nodal displacements.

    Parameters
    ----------
    law : Law
    basis : skfem.Basis             of `quadratic_basis`
    displacement : (n, 3) float [m]

    Returns
    -------
    (n, 3) float [N]                NaN where an element is inverted

    Raises
    ------
    InputError                      scikit-fem is not installed
    """
    stress = law.stress(deformation_gradient(basis, displacement))
    skfem = late_import("skfem", extra="fem", purpose="the finite elements of a specimen")
    forms = [skfem.LinearForm(lambda v, _, row=row: (row * v.grad).sum(axis=0)) for row in stress]
    return np.stack([form.assemble(basis) for form in forms], axis=1)


def tangent(law: Law, basis: Any, displacement: Float[np.ndarray, "n 3"]) -> csr_array:
    """Tangent stiffness: derivative of the internal forces with respect to nodal displacements.

    Parameters
    ----------
    law : Law
    basis : skfem.Basis             of `quadratic_basis`
    displacement : (n, 3) float [m]

    Returns
    -------
    (3 n, 3 n) sparse [N/m]         as `stiffness_matrix`
    """
    return stiffness_matrix(basis, law.moduli(deformation_gradient(basis, displacement)))


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
    (3, 3, m, q) float [-]          row: component of the deformed position; column: reference
                                    direction
    """
    slopes = np.stack([basis.interpolate(component).grad for component in displacement.T])
    return np.eye(3)[:, :, None, None] + slopes

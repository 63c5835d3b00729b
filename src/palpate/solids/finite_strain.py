"""A body at finite strain: the nonlinearity that the linear model neglects.

The hyperelastic laws reduce to Hooke's law at small strain. Both are known as neo-Hookean: they
have the same constants but couple volumetric and deviatoric strain differently, by as much as real
soft materials of equal constants may differ. Either may stiffen as it is strained (`Yeoh`).

A stable equilibrium is the minimum of a potential: Newton's method with step halving, and load
increments where the full load does not converge at once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
import skfem
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.errors import NotConvergedError, SingularSystemError
from palpate.solids.finite_elements import (
    Body,
    free_part,
    quadratic_basis,
    solve_free,
    solve_load,
    stiffness_matrix,
)
from palpate.solids.sparse_cholesky import Cholesky, factorise

# Tolerance on the residual forces, relative to the load.
_FORCE_TOLERANCE = 1e-9
Gradient = Float[np.ndarray, "3 3 m q"]
Moduli = Float[np.ndarray, "3 3 3 3 m q"]
_MAX_STEPS = 60
# A tangent is kept while a step with it leaves less than this fraction of the forces.
_KEPT = 0.5
_MAX_HALVINGS = 10
# Share of a potential that rounding may be, at a strain of 2e-6.
_HIDDEN = 1e-3
# Smallest load increment, as a fraction of the load; increments that fail are halved.
_MIN_INCREMENT = 1e-3
Unknowns = Float[np.ndarray, " unknowns"]
Steps = Float[np.ndarray, "unknowns k"]
# Newton's step [m] for each column of forces [N].
Solver = Callable[[Steps], Steps]


@runtime_checkable
class Law(Protocol):
    """An isotropic hyperelastic law, in the deformation gradient F = I + du/dX (row: component of
    the deformed position, column: reference direction) at q quadrature points of m elements,
    (3, 3, m, q)."""

    def density(self, gradient: Gradient) -> Float[np.ndarray, "m q"]:
        """Strain energy per reference volume, (m, q) [Pa]; not finite unless det F > 0."""

    def stress(self, gradient: Gradient) -> Gradient:
        """First Piola-Kirchhoff stress, (3, 3, m, q) [Pa]: derivative of the energy in F."""

    def moduli(self, gradient: Gradient) -> Moduli:
        """Derivative of the stress aA in F_bB, (3, 3, 3, 3, m, q) [Pa]; indices a, A, b, B."""


LawOf = Callable[[float, float], Law]


@dataclass(frozen=True, slots=True)
class NeoHookean:
    """mu/2 (tr C - 3) - mu ln J + lambda/2 (ln J)^2, with C = F^T F and J = det F (`Law`).

    Parameters
    ----------
    mu, lame : float [Pa]           Lame's constants

    Source
    ------
    Bonet and Wood, Nonlinear continuum mechanics for finite element analysis (2nd ed. 2008),
    section 6.4.3.
    """

    mu: float
    lame: float

    def density(self, gradient: Gradient) -> Float[np.ndarray, "m q"]:
        """Of `Law`."""
        log = np.log(_determinant(gradient))
        squares = (gradient**2).sum(axis=(0, 1))
        return 0.5 * self.mu * (squares - 3.0) - self.mu * log + 0.5 * self.lame * log**2

    def stress(self, gradient: Gradient) -> Gradient:
        """Of `Law`."""
        log = np.log(_determinant(gradient))
        return self.mu * gradient + (self.lame * log - self.mu) * _inverse_transposed(gradient)

    def moduli(self, gradient: Gradient) -> Moduli:
        """mu delta_ab delta_AB + (mu - lambda ln J) H_aB H_bA + lambda H_aA H_bB, H = F^-T."""
        inverse = _inverse_transposed(gradient)
        falling = self.mu - self.lame * np.log(_determinant(gradient))
        moduli = self.lame * _outer(inverse, inverse) + falling * _crossed(inverse)
        _add_unit(moduli, self.mu)
        return moduli


@dataclass(frozen=True, slots=True)
class SplitNeoHookean:
    """mu/2 (J^(-2/3) tr C - 3) + K/2 (J - 1)^2: deviatoric and volumetric parts uncoupled (`Law`).

    Parameters
    ----------
    mu, lame : float [Pa]           Lame's constants; K = lambda + 2/3 mu

    Source
    ------
    Holzapfel, Nonlinear solid mechanics (2000), sections 6.4 and 6.5: the neo-Hookean law of
    Abaqus and CalculiX.
    """

    mu: float
    lame: float

    @property
    def bulk(self) -> float:
        """Bulk modulus [Pa]."""
        return self.lame + 2.0 / 3.0 * self.mu

    def density(self, gradient: Gradient) -> Float[np.ndarray, "m q"]:
        """Of `Law`."""
        volume = _determinant(gradient)
        shape = 0.5 * self.mu * (_shape(gradient) - 3.0)
        return shape + 0.5 * self.bulk * (volume - 1.0) ** 2

    def stress(self, gradient: Gradient) -> Gradient:
        """Of `Law`."""
        volume = _determinant(gradient)
        pressure = self.bulk * (volume - 1.0) * volume
        slope = _shape_slope(gradient)
        return 0.5 * self.mu * slope + pressure * _inverse_transposed(gradient)

    def moduli(self, gradient: Gradient) -> Moduli:
        """Derivative of the stress, with dJ = J H : dF and dH_aA = -H_aB H_bA dF_bB, H = F^-T."""
        volume, inverse = _determinant(gradient), _inverse_transposed(gradient)
        moduli = 0.5 * self.mu * _shape_curvature(gradient)
        moduli += self.bulk * (2.0 * volume - 1.0) * volume * _outer(inverse, inverse)
        moduli -= self.bulk * (volume - 1.0) * volume * _crossed(inverse)
        return moduli


@dataclass(frozen=True, slots=True)
class Yeoh:
    """A law and its stiffening: mu stiffening / 2 (J^(-2/3) tr C - 3)^2 is added (`Law`).

    It is of fourth order in strain, so that mu and lambda stay Lame's constants, and convex in its
    invariant, which is polyconvex. In simple shear by s the secant modulus is
    mu (1 + 2 stiffening s^2).

    Parameters
    ----------
    law : Law                       without it
    mu : float [Pa]                 shear modulus of that
    stiffening : float [-]          C2 / C1 of Yeoh's law; >= 0 for an energy that is convex

    Source
    ------
    Yeoh, Some forms of the strain energy function for rubber, Rubber Chemistry and Technology 66
    (1993). Hartmann and Neff, Polyconvexity of generalized polynomial-type hyperelastic strain
    energy functions for near-incompressibility, International Journal of Solids and Structures 40
    (2003).
    """

    law: Law
    mu: float
    stiffening: float

    def density(self, gradient: Gradient) -> Float[np.ndarray, "m q"]:
        """Of `Law`."""
        added = 0.5 * self.mu * self.stiffening * (_shape(gradient) - 3.0) ** 2
        return self.law.density(gradient) + added

    def stress(self, gradient: Gradient) -> Gradient:
        """Of `Law`."""
        size = self.mu * self.stiffening * (_shape(gradient) - 3.0)
        return self.law.stress(gradient) + size * _shape_slope(gradient)

    def moduli(self, gradient: Gradient) -> Moduli:
        """Of `Law`."""
        slope, size = _shape_slope(gradient), self.mu * self.stiffening
        moduli = self.law.moduli(gradient) + size * _outer(slope, slope)
        moduli += size * (_shape(gradient) - 3.0) * _shape_curvature(gradient)
        return moduli


def yeoh(stiffening: float, law: LawOf = NeoHookean) -> LawOf:
    """A law with stiffening, as a function of Lame's constants (`Yeoh`).

    Parameters
    ----------
    stiffening : float [-]          0: the law itself
    law : function                  Lame's constants mu and lambda [Pa] -> `Law`
    """
    if stiffening == 0.0:
        return law
    return lambda mu, lame: Yeoh(law(mu, lame), mu, stiffening)


def solve_finite(
    body: Body,
    load: Float[np.ndarray, "n 3"],
    *,
    law: LawOf = NeoHookean,
    start: Float[np.ndarray, "n 3"] | None = None,
) -> Float[np.ndarray, "n 3"]:
    """Displacement at finite strain under dead nodal loads.

    Parameters
    ----------
    body : Body                     gives mesh, fixed nodes and constants
    load : (n, 3) float [N]         forces on the nodes
    law : function                  Lame's constants mu and lambda [Pa] -> `Law`
    start : (n, 3) float [m] or None    of a similar body and load; None: from rest

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
        equilibrium = find_equilibrium(loaded, at, tolerance=_FORCE_TOLERANCE * fraction * scale)
        return None if equilibrium is None else equilibrium[0]

    if start is not None and (equilibrium := find(1.0, start.ravel())) is not None:
        return equilibrium.reshape(-1, 3)
    equilibrium, done = find_in_increments(find, np.zeros(load.size))
    if done < 1.0:
        raise NotConvergedError(
            f"no equilibrium beyond {100 * done:.1f} % of the load: the body buckles, or is"
            " pressed farther than its elements bear; press less, or use smaller elements there"
        )
    return equilibrium.reshape(-1, 3)


def load_slopes(
    body: Body,
    load: Float[np.ndarray, "n 3"],
    displacement: Float[np.ndarray, "n 3"],
    *,
    law: Law,
    others: Sequence[Law],
) -> Steps:
    """Derivatives of an equilibrium of `solve_finite`, by the logarithm of the load, then by the
    share of each of other laws in place of its own.

    Parameters
    ----------
    body, load, law                 of the equilibrium
    displacement : (n, 3) float [m]
    others : sequence of k - 1 Law  whose stresses are mixed with the law's

    Returns
    -------
    (3 n, k) float [m]

    Raises
    ------
    NotConvergedError               the equilibrium is not stable
    """
    basis = quadratic_basis(body.solid)
    loaded = _Loaded(body, law, basis, load)
    changes = law_changes(law, others, basis, displacement)
    return slopes(loaded, displacement.ravel(), np.column_stack([load.ravel(), changes]))


def dilation_slope(body: Body, displacement: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Derivative of a linear displacement by lambda over mu, under the same load.

    Parameters
    ----------
    body : Body
    displacement : (n, 3) float [m]    of `solve_load`

    Returns
    -------
    (n, 3) float [m]
    """
    basis = quadratic_basis(body.solid)
    gradient = deformation_gradient(basis, displacement)
    spread = body.shear_modulus * (np.trace(gradient) - 3.0)
    forms = [skfem.LinearForm(lambda v, _, a=a: spread * v.grad[a]) for a in range(3)]
    return solve_load(body, -np.stack([form.assemble(basis) for form in forms], axis=1))


def law_changes(
    law: Law, others: Sequence[Law], basis: Any, displacement: Float[np.ndarray, "n 3"]
) -> Steps:
    """Internal forces of a law minus those of others, per share of these [N].

    Parameters
    ----------
    law : Law
    others : sequence of k Law
    basis : skfem.Basis             of `quadratic_basis`
    displacement : (n, 3) float [m]
    """
    forces = internal_forces(law, basis, displacement).ravel()
    changed = [internal_forces(other, basis, displacement).ravel() for other in others]
    return np.stack([forces - other for other in changed], axis=1)


def slopes(potential: "Potential", at: Unknowns, forces: Steps) -> Steps:
    """How an equilibrium moves per unit of each of some residual forces.

    Parameters
    ----------
    potential : Potential
    at : (u,) float [m]             its equilibrium
    forces : (u, k) float [N]       added to the residual

    Raises
    ------
    NotConvergedError               the equilibrium is not stable
    """
    solver = potential.solver(at)
    if solver is None:
        raise NotConvergedError("the object is about to buckle under its load: press less")
    return solver(forces)


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

    def solver(self, at: Unknowns) -> Solver | None:
        factor = stable_factor(self.body, tangent(self.law, self.basis, at.reshape(-1, 3)))
        return None if factor is None else partial(solve_free, self.body.held, factor)


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
    if (_determinant(gradient) <= 0.0).any():
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

    """
    stress = law.stress(deformation_gradient(basis, displacement))
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


def _outer(first: Gradient, other: Gradient) -> Moduli:
    return np.einsum("aAmq,bBmq->aAbBmq", first, other)


def _crossed(inverse: Gradient) -> Moduli:
    return np.einsum("aBmq,bAmq->aAbBmq", inverse, inverse)


def _add_unit(moduli: Moduli, size: float | Float[np.ndarray, "m q"]) -> None:
    """Add `size` times delta_ab delta_AB in place."""
    for a, i in np.ndindex(3, 3):
        moduli[a, i, a, i] += size


def _determinant(gradient: Gradient) -> Float[np.ndarray, "m q"]:
    return np.linalg.det(gradient.transpose(2, 3, 0, 1))


def _inverse_transposed(gradient: Gradient) -> Gradient:
    return np.linalg.inv(gradient.transpose(2, 3, 0, 1)).transpose(3, 2, 0, 1)


def _shape(gradient: Gradient) -> Float[np.ndarray, "m q"]:
    """J^(-2/3) tr C, which volume leaves alone."""
    return _determinant(gradient) ** (-2.0 / 3.0) * (gradient**2).sum(axis=(0, 1))


def _shape_slope(gradient: Gradient) -> Gradient:
    """Derivative of `_shape`: 2 J^(-2/3) F - 2/3 J^(-2/3) tr C H."""
    scale = 2.0 * _determinant(gradient) ** (-2.0 / 3.0)
    return scale * gradient - 2.0 / 3.0 * _shape(gradient) * _inverse_transposed(gradient)


def _shape_curvature(gradient: Gradient) -> Moduli:
    """Second derivative of `_shape`."""
    inverse, shape = _inverse_transposed(gradient), _shape(gradient)
    scale = 2.0 * _determinant(gradient) ** (-2.0 / 3.0)
    mixed = _outer(inverse, gradient)
    curvature = 4.0 / 9.0 * shape * _outer(inverse, inverse)
    curvature += 2.0 / 3.0 * shape * _crossed(inverse)
    curvature -= 2.0 / 3.0 * scale * (mixed + mixed.transpose(2, 3, 0, 1, 4, 5))
    _add_unit(curvature, scale)
    return curvature


@runtime_checkable
class Potential(Protocol):
    """Total potential energy: stored energy minus the work of the loads.

    Unknowns and forces are (u,) arrays.
    """

    def value(self, at: Unknowns) -> float:
        """Potential [J]; infinite for inadmissible unknowns."""

    def forces(self, at: Unknowns) -> Unknowns:
        """Residual forces, the negative gradient [N]; zero for fixed unknowns."""

    def solver(self, at: Unknowns) -> Solver | None:
        """By the tangent there: forces to steps; None where it is not positive definite."""


def find_equilibrium(
    potential: Potential, at: Unknowns, *, tolerance: float, solver: Solver | None = None
) -> tuple[Unknowns, Solver | None] | None:
    """Equilibrium near an initial guess.

    Parameters
    ----------
    potential : Potential
    at : (u,) float [m]             initial guess
    tolerance : float [N]           on the norm of the residual forces, > 0
    solver : function or None       of a similar potential nearby

    Returns
    -------
    (u,) float [m], function or None    and the last solver; None: does not converge

    Source
    ------
    Kelley, Solving nonlinear equations with Newton's method (2003), section 2.3: tangents are kept.
    Nocedal and Wright, Numerical optimization (2nd ed. 2006), section 3.1: steps are halved. Hager
    and Zhang, SIAM Journal on Optimization 16 (2005) 170: slopes tell what rounding hides.
    """
    wanted = np.inf
    for _ in range(_MAX_STEPS):
        forces = potential.forces(at)
        size = float(np.linalg.norm(forces))
        if size <= tolerance:
            return at, solver
        reused = solver is not None and size < wanted
        solver = solver if reused else potential.solver(at)
        if solver is None:
            return None
        improved = _shortened(potential, at, forces, solver(forces[:, None])[:, 0])
        if improved is None and not reused:
            return None
        at, wanted = (at, 0.0) if improved is None else (improved, _KEPT * size)
    return None


def find_in_increments(
    find: Callable[[float, Unknowns], Unknowns | None], start: Unknowns
) -> tuple[Unknowns, float]:
    """Equilibrium under the full load, in load increments where it is not found at once.

    Parameters
    ----------
    find : function                 fraction of the load, initial guess -> equilibrium, or None
    start : (u,) float [m]          equilibrium without load

    Returns
    -------
    equilibrium : (u,) float [m]       the last equilibrium found
    done : float [-]                fraction of the load there; 1 on success
    """
    now, done, increment = start, 0.0, 1.0
    while done < 1.0 and increment >= _MIN_INCREMENT:
        target = min(1.0, done + increment)
        equilibrium = find(target, now)
        if equilibrium is None:
            increment *= 0.5
        else:
            now, done = equilibrium, target
    return now, done


def _shortened(
    potential: Potential, at: Unknowns, forces: Unknowns, step: Unknowns
) -> Unknowns | None:
    """End of a step, halved until the potential does not rise; None: fails. A change that rounding
    hides, as at strains of 1e-5, is told by the forces along the step."""
    before = potential.value(at)
    for _ in range(_MAX_HALVINGS):
        end, after = at + step, potential.value(at + step)
        if after <= before + 1e-12 * abs(before):
            return end
        near = after <= before + _HIDDEN * abs(before)
        if near and (forces + potential.forces(end)) @ step >= 0.0:
            return end
        step = 0.5 * step
    return None

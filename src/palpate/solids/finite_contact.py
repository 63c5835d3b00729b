"""A rigid tip pressed into a body at finite strain, without friction, to a given force.

The tip's shape is exact and the body hyperelastic. Contact is enforced by a penalty: stiff springs
resist the small penetration of the surface into the tip. With the force prescribed, the response of
the body hardly depends on that penetration.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq
from scipy.sparse import csr_array, diags_array

from palpate.errors import InputError, NotConvergedError
from palpate.geometry import quadratic_shapes
from palpate.shapes import Points, PointScalars
from palpate.solids.contact import facet_samples, touch
from palpate.solids.finite_elements import Body, quadratic_basis, solve_free, surface_values
from palpate.solids.finite_strain import (
    Law,
    LawOf,
    NeoHookean,
    Solver,
    Steps,
    Unknowns,
    energy,
    find_equilibrium,
    find_in_increments,
    internal_forces,
    law_changes,
    slopes,
    stable_factor,
    tangent,
)
from palpate.solids.tips import Tip

# Penalty stiffness in units of shear modulus over tip radius: a pressure equal to the shear modulus
# causes a penetration of a thousandth of the radius.
_SPRINGS = 1000.0
# Contact is considered within this many tip radii of the point of first contact.
_REACH = 1.6
# Skin is drawn in under a rim until this fraction of the force acts on what moved across it; so
# often at most.
_RIM_TOLERANCE, _MOST_DRAWS = 1e-3, 20
# Tolerance on the residual forces, relative to the tip's force.
_FORCE_TOLERANCE = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class Sag:
    """A body under its weight alone.

    Attributes
    ----------
    weight : (n, 3) float [N]       on the nodes
    displacement : (n, 3) float [m] at finite strain
    slopes : (3 n, k) float [m]     of that, as `load_slopes`
    """

    weight: Float[np.ndarray, "n 3"]
    displacement: Float[np.ndarray, "n 3"]
    slopes: Steps


@dataclass(frozen=True, slots=True, eq=False)
class FinitePress:
    """Equilibrium of a body at finite strain with a tip pressed into it.

    Attributes
    ----------
    displacement : (n, 3) float [m] nodal displacements
    travel : float [m]              of the tip along its axis, from `Tip.point`, or from where the
                                    body's weight takes that point of its surface
    """

    displacement: Float[np.ndarray, "n 3"]
    travel: float


def press_finite(
    body: Body,
    tip: Tip,
    force: float,
    *,
    law: LawOf = NeoHookean,
    start: FinitePress | None = None,
    sag: Sag | None = None,
) -> FinitePress:
    """Press a frictionless tip into a body at finite strain to a given force.

    Parameters
    ----------
    body : Body
    tip : Tip                       moves along its axis; the arm bears any lateral force
    force : float [N]               along the tip's motion, > 0
    law : function                  Lame's constants mu and lambda [Pa] -> `Law`
    start : FinitePress or None     initial guess, from a similar body and force; None: from rest
    sag : Sag or None               the body under its weight, which acts before the tip and under
                                    it: the axis goes where `Tip.point` went; None: without weight

    Returns
    -------
    FinitePress                     displacements of weight and tip together

    Raises
    ------
    InputError                      a force that is not positive, a tip that misses the body
    NotConvergedError               no stable equilibrium is found

    Source
    ------
    Wriggers, Computational contact mechanics (2nd ed. 2006), section 6.3: penalty method; material
    and tangent as in `solve_finite`. The tip's travel is an additional unknown. Newton's method
    with step halving until the potential does not increase; the tangent neglects the change of the
    contact normals, whose effect is small because the penetration is.
    """
    if not (np.isfinite(force) and force > 0.0):
        raise InputError(f"the force is {force}; must be positive, in newtons")
    potential = _make_potential(body, law(*body.lame), tip, force, sag)
    equilibrium = None
    if start is not None:
        potential = potential.drawn_in(_joined(start))
        equilibrium = potential.equilibrium(_joined(start))
    if equilibrium is None:
        equilibrium = potential.equilibrium_from_contact(sag), None
    at = potential.settled(*equilibrium)
    return FinitePress(at[:-1].reshape(-1, 3), float(at[-1]))


def press_slopes(
    body: Body,
    tip: Tip,
    force: float,
    press: FinitePress,
    *,
    law: Law,
    others: Sequence[Law],
    sag: Sag | None = None,
) -> Steps:
    """Derivatives of the displacement of `press_finite`, as `load_slopes` has those of
    `solve_finite`; the load is force and weight together.

    Parameters
    ----------
    body, tip, force, law, sag      of the equilibrium
    press : FinitePress
    others : sequence of k - 1 Law

    Returns
    -------
    (3 n, k) float [m]

    Raises
    ------
    NotConvergedError               the equilibrium is not stable
    """
    at, forces = _joined(press), np.zeros((press.displacement.size + 1, 1 + len(others)))
    potential = _make_potential(body, law, tip, force, sag).drawn_in(at)
    forces[-1, 0] = force
    forces[:-1, 1:] = law_changes(law, others, potential.basis, press.displacement)
    if sag is not None:
        forces[:-1, 0] = sag.weight.ravel()
        carried = surface_values(body.solid, tip.point[None])
        axis = np.stack([carried @ slope for slope in sag.slopes.T.reshape(-1, len(sag.weight), 3)])
        forces += potential.forces_by_shift(at, axis[:, 0].T)
    return slopes(potential, at, forces)[:-1]


@dataclass(frozen=True, slots=True, eq=False)
class _ContactPotential:
    """Potential of a body and a tip under a force (`Potential`). Unknowns: nodal displacements,
    then the tip's travel."""

    body: Body
    law: Law
    basis: Any
    tip: Tip
    # Of the nodes [N].
    weight: Float[np.ndarray, "nodes 3"]
    # Points of the surface that may touch the tip, each with a spring: their interpolation from the
    # nodes, positions at rest [m], the area they stand for [m^2], and which share of it is within
    # the tip's rim.
    at_points: csr_array
    points: Points
    area: PointScalars
    within: PointScalars
    force: float

    @property
    def stiffness(self) -> PointScalars:
        """Of the springs [N/m]."""
        return _SPRINGS * self.body.shear_modulus / self.tip.radius * self.area * self.within

    def value(self, at: Unknowns) -> float:
        """Stored energy of body and springs minus the work of weight and force on the tip [J]."""
        stored = energy(self.law, self.basis, at[:-1].reshape(-1, 3))
        stored -= float(self.weight.ravel() @ at[:-1])
        return stored + self.springs(at)[0] - self.force * float(at[-1])

    def forces(self, at: Unknowns) -> Unknowns:
        """Residual: weight and spring forces minus internal forces at the nodes; then the tip's
        force minus the push of the springs [N]."""
        _, force, push = self.springs(at)
        missing = self.weight + force
        missing -= internal_forces(self.law, self.basis, at[:-1].reshape(-1, 3))
        missing[self.body.held] = 0.0
        return np.append(missing, self.force - push)

    def solver(self, at: Unknowns) -> Solver | None:
        """Newton's steps by block elimination; the tip's travel is eliminated last."""
        penetration, normal = self.penetration(at)
        touching = (penetration > 0.0) & (self.within > 0.0)
        weight, normal = self.stiffness[touching], normal[touching]
        advance = normal @ self.tip.direction
        across = _along_normals(self.at_points[touching], normal)
        matrix = (
            tangent(self.law, self.basis, at[:-1].reshape(-1, 3))
            + across.T @ diags_array(weight) @ across
        )
        factor = stable_factor(self.body, matrix)
        if factor is None:
            return None
        coupling = across.T @ (weight * advance)
        along = solve_free(self.body.held, factor, coupling[:, None])[:, 0]
        pivot = float(weight @ advance**2) - float(coupling @ along)
        if not pivot > 0.0:
            return None

        def solve(forces: Steps) -> Steps:
            still = solve_free(self.body.held, factor, forces[:-1])
            travel = (forces[-1] + coupling @ still) / pivot
            return np.vstack([still + np.outer(along, travel), travel])

        return solve

    def springs(self, at: Unknowns) -> tuple[float, Float[np.ndarray, "n 3"], float]:
        """Energy of the penalty springs [J], their force on the nodes, (n, 3) [N], and that of the
        tip along its motion [N]."""
        penetration, normal = self.penetration(at)
        force_size = self.stiffness * penetration
        return (
            0.5 * float(force_size @ penetration),
            self.at_points.T @ (force_size[:, None] * normal),
            float(force_size @ (normal @ self.tip.direction)),
        )

    def forces_by_shift(self, at: Unknowns, shift: Float[np.ndarray, "3 k"]) -> Steps:
        """Residual forces per shift of the tip [N]."""
        penetration, normal = self.penetration(at)
        force = (self.stiffness * (penetration > 0.0))[:, None] * (normal @ shift)
        nodal = _along_normals(self.at_points, normal).T @ force
        return np.vstack([nodal, -(normal @ self.tip.direction) @ force])

    def penetration(self, at: Unknowns) -> tuple[PointScalars, Points]:
        """Penetration of the contact points [m], zero outside, and the tip's normals there."""
        positions = self.points + self.at_points @ at[:-1].reshape(-1, 3)
        distance, normal = self.tip.distance(float(at[-1]), positions)
        return np.maximum(-distance, 0.0), normal

    def drawn_in(self, at: Unknowns) -> "_ContactPotential":
        """This potential with the part of the surface that is within the rim now."""
        positions = self.points + self.at_points @ at[:-1].reshape(-1, 3)
        return replace(self, within=_within(self.tip, positions, self.area))

    def settled(self, at: Unknowns, solver: Solver | None) -> Unknowns:
        """Equilibrium with the skin that is under the rim by then, from an equilibrium with the
        skin that was there before, and its solver."""
        before = self
        for _ in range(_MOST_DRAWS):
            now = before.drawn_in(at)
            moved = np.abs(now.stiffness - before.stiffness) @ self.penetration(at)[0]
            if moved < _RIM_TOLERANCE * self.force:
                return at
            equilibrium = now.equilibrium(at, solver)
            if equilibrium is None:
                break
            before, (at, solver) = now, equilibrium
        raise NotConvergedError(
            "skin is drawn in under the rim of the tool and finds no place of rest: press less"
        )

    def equilibrium(
        self, at: Unknowns, solver: Solver | None = None
    ) -> tuple[Unknowns, Solver | None] | None:
        """Equilibrium near an initial guess, and its solver; None if it is not found."""
        tolerance = _FORCE_TOLERANCE * self.force
        return find_equilibrium(self, at, tolerance=tolerance, solver=solver)

    def equilibrium_from_contact(self, sag: Sag | None) -> Unknowns:
        """Equilibrium, in load steps from first contact with the body at rest."""
        solid = self.body.solid
        moved = np.zeros_like(solid.nodes) if sag is None else sag.displacement
        resting = replace(solid, nodes=solid.nodes + moved)
        touching = _joined(FinitePress(moved, touch(resting, self.tip)))

        def find(fraction: float, at: Unknowns) -> Unknowns | None:
            partial_load = replace(self, force=fraction * self.force)
            guess = partial_load.initial_guess(at) if at is touching else at
            equilibrium = None if guess is None else partial_load.equilibrium(guess)
            return None if equilibrium is None else equilibrium[0]

        equilibrium, done = find_in_increments(find, touching)
        if done < 1.0:
            raise NotConvergedError(
                f"no equilibrium beyond {100 * done:.1f} % of the force under the tool: the body"
                " buckles, or is pressed farther than its elements bear; press less"
            )
        return equilibrium

    def initial_guess(self, at: Unknowns) -> Unknowns | None:
        """Guess from rest: the travel at which the springs alone balance the force; None if that
        exceeds half the tip's radius."""

        def excess(depth: float) -> float:
            return self.springs(np.append(at[:-1], at[-1] + depth))[2] - self.force

        deepest = 0.5 * self.tip.radius
        if excess(deepest) < 0.0:
            return None
        return np.append(at[:-1], at[-1] + float(brentq(excess, 0.0, deepest)))


def _joined(press: FinitePress) -> Unknowns:
    """Vector of unknowns: nodal displacements, then the travel."""
    return np.append(press.displacement, press.travel)


def _along_normals(shape: csr_array, normal: Points) -> csr_array:
    """Matrix from nodal displacements to each point's displacement along its normal, (p, 3 n)."""
    entries = shape.tocoo()
    column = 3 * entries.col[:, None] + np.arange(3)
    value = entries.data[:, None] * normal[entries.row]
    row = np.repeat(entries.row, 3)
    size = shape.shape[0], 3 * shape.shape[1]
    return csr_array((value.ravel(), (row, column.ravel())), shape=size)


def _make_potential(
    body: Body, law: Law, tip: Tip, force: float, sag: Sag | None
) -> _ContactPotential:
    """Potential with contact points on the outer faces near the tip."""
    solid = body.solid
    first = tip.point + touch(solid, tip) * tip.direction
    nodes = solid.nodes[solid.facets]
    side = np.cross(nodes[:, 1] - nodes[:, 0], nodes[:, 2] - nodes[:, 0])
    near = np.linalg.norm(nodes - first, axis=2).min(axis=1) < _REACH * tip.radius
    near &= side @ tip.direction < 0.0
    shape = quadratic_shapes(facet_samples()).T
    count = len(shape)
    facets = np.repeat(solid.facets[near], count, axis=0)
    row = np.repeat(np.arange(len(facets)), 6)
    value = np.tile(shape, (int(near.sum()), 1)).ravel()
    matrix = csr_array((value, (row, facets.ravel())), shape=(len(facets), len(solid.nodes)))
    area = np.repeat(0.5 * np.linalg.norm(side[near], axis=1) / count, count)
    points, now, weight = matrix @ solid.nodes, matrix @ solid.nodes, np.zeros_like(solid.nodes)
    if sag is not None:
        weight, now = sag.weight, points + matrix @ sag.displacement
        carried = surface_values(solid, tip.point[None]) @ sag.displacement
        tip = replace(tip, point=tip.point + carried[0])
    within = _within(tip, now, area)
    return _ContactPotential(
        body, law, quadratic_basis(solid), tip, weight, matrix, points, area, within, force
    )


def _within(tip: Tip, points: Points, area: PointScalars) -> PointScalars:
    """Share of the area around each point that is within the rim of a tip."""
    width = np.sqrt(area)
    return np.clip(0.5 + (tip.radius - tip.radial_distance(points)) / width, 0.0, 1.0)

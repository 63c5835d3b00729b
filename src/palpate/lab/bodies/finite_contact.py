"""A rigid tip pressed into a body at finite strain: without friction, with a given force.

The tip's shape is exact, the body hyperelastic. The surface may enter the tip by a little, which
a stiff layer of springs resists: what a body does under a given force hardly depends on how deep
the tip that gives it has gone.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq
from scipy.sparse import csr_array, diags_array

from palpate.errors import InputError, NotConvergedError
from palpate.geometry import quadratic_shapes
from palpate.lab.bodies.contact import facet_samples, touch
from palpate.lab.bodies.finite_elements import Body, quadratic_basis, solve_free
from palpate.lab.bodies.finite_strain import (
    LawOf,
    energy,
    inner_forces,
    stable_factor,
    tangent,
)
from palpate.lab.bodies.laws import Law, NeoHookean
from palpate.lab.bodies.newton import Unknowns, find_in_parts, find_rest
from palpate.lab.bodies.tips import Tip
from palpate.shapes import Points, PointScalars

# Pressure over depth of entry, over the shear modulus and one over the tip's radius: pressures of a
# modulus enter by a hundredth of the radius.
_SPRINGS = 100.0
# The surface may meet the tip within so many of its radii.
_REACH = 1.6
# Forces out of balance, of the load; of the tip's force alike.
_BALANCED = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class FinitePress:
    """A body at finite strain with a tip pressed into it.

    Attributes
    ----------
    displacement : (n, 3) float [m]
    travel : float [m]              of the tip along its axis, from `Tip.point`
    """

    displacement: Float[np.ndarray, "n 3"]
    travel: float


@dataclass(frozen=True, slots=True, eq=False)
class _Skin:
    """Points of the surface that may meet the tip.

    Attributes
    ----------
    shape : sparse (p, n)           from nodes to points
    rest : (p, 3) float [m]
    stiffness : (p,) float [N/m]    of each point's spring
    """

    shape: csr_array
    rest: Points
    stiffness: PointScalars


@dataclass(frozen=True, slots=True, eq=False)
class _Springs:
    """What the springs of the skin do at some place of tip and body.

    Attributes
    ----------
    energy : float [J]
    force : (n, 3) float [N]        on the nodes
    push : float [N]                of the tip along its motion
    """

    energy: float
    force: Float[np.ndarray, "n 3"]
    push: float


def press_finite(
    body: Body,
    tip: Tip,
    force: float,
    *,
    law: LawOf = NeoHookean,
    start: FinitePress | None = None,
) -> FinitePress:
    """Press a freely sliding tip into a body at finite strain until it pushes with a given force.

    Parameters
    ----------
    body : Body
    tip : Tip                       goes along its axis; what is across is held by the arm
    force : float [N]               along the tip's motion, > 0
    law : function                  Lame's constants mu and lambda [Pa] -> `Law`
    start : FinitePress or None     of nearly the same body and force; None: from rest

    Returns
    -------
    FinitePress

    Raises
    ------
    InputError                      a force that is not positive, a tip beside the body
    NotConvergedError               no stable equilibrium is found

    Source
    ------
    Wriggers, Computational contact mechanics (2nd ed. 2006), section 6.3: penalty; the material and
    its tangent as in `solve_finite`. The tip's travel is one more unknown. Newton with steps
    shortened until the potential does not rise; the slope of the tip's normal is left out of the
    tangent, which the stiff springs make small.
    """
    if not (np.isfinite(force) and force > 0.0):
        raise InputError(f"the force is {force}; must be positive, in newtons")
    meeting = _Meeting(
        body, law(*body.lame), quadratic_basis(body.solid), tip, _skin(body, tip), force
    )
    found = None
    if start is not None:
        found = meeting.rest(_joined(start))
    if found is None:
        found = meeting.rest_from_touch()
    return FinitePress(found[:-1].reshape(-1, 3), float(found[-1]))


@dataclass(frozen=True, slots=True, eq=False)
class _Meeting:
    """A body and a tip under a force: the nodes' displacement, then the tip's travel
    (`Potential`)."""

    body: Body
    law: Law
    basis: Any
    tip: Tip
    skin: _Skin
    force: float

    def value(self, at: Unknowns) -> float:
        """Energy of body and springs less the work of the force on the tip."""
        stored = energy(self.law, self.basis, at[:-1].reshape(-1, 3))
        return stored + self.springs(at).energy - self.force * float(at[-1])

    def forces(self, at: Unknowns) -> Unknowns:
        """Of the springs on the nodes less the body's own; then what the springs leave to the
        tip."""
        springs = self.springs(at)
        missing = springs.force - inner_forces(self.law, self.basis, at[:-1].reshape(-1, 3))
        missing[self.body.held] = 0.0
        return np.append(missing, self.force - springs.push)

    def step(self, at: Unknowns, forces: Unknowns) -> Unknowns | None:
        """The tip's travel is eliminated last."""
        entered, normal = self.entered(at)
        weight = np.where(entered > 0.0, self.skin.stiffness, 0.0)
        ahead = normal @ self.tip.direction
        across = _along_normals(self.skin.shape, normal)
        matrix = (
            tangent(self.law, self.basis, at[:-1].reshape(-1, 3))
            + across.T @ diags_array(weight) @ across
        )
        factor = stable_factor(self.body, matrix)
        if factor is None:
            return None
        coupling = across.T @ (weight * ahead)
        both = solve_free(self.body.held, factor, np.stack([forces[:-1], coupling], axis=1))
        left = float(weight @ ahead**2) - float(coupling @ both[:, 1])
        if not left > 0.0:
            return None
        travel = (forces[-1] + float(coupling @ both[:, 0])) / left
        return np.append(both[:, 0] + travel * both[:, 1], travel)

    def springs(self, at: Unknowns) -> _Springs:
        """Energy and forces of the skin's springs."""
        entered, normal = self.entered(at)
        size = self.skin.stiffness * entered
        return _Springs(
            0.5 * float(size @ entered),
            self.skin.shape.T @ (size[:, None] * normal),
            float(size @ (normal @ self.tip.direction)),
        )

    def entered(self, at: Unknowns) -> tuple[PointScalars, Points]:
        """How deep the skin's points are in the tip, and the tip's normals there."""
        places = self.skin.rest + self.skin.shape @ at[:-1].reshape(-1, 3)
        distance, normal = self.tip.distance(float(at[-1]), places)
        return np.maximum(-distance, 0.0), normal

    def rest(self, at: Unknowns) -> Unknowns | None:
        """Rest near a place; None where it is not found."""
        return find_rest(self, at, balanced=_BALANCED * self.force)

    def rest_from_touch(self) -> Unknowns:
        """Rest, by way of smaller forces, from the tip's first touch of the body at rest."""
        touching = FinitePress(
            np.zeros_like(self.body.solid.nodes), touch(self.body.solid, self.tip)
        )

        def find(share: float, at: Unknowns) -> Unknowns | None:
            part = replace(self, force=share * self.force)
            guess = at if at[:-1].any() else part.first(at)
            return None if guess is None else part.rest(guess)

        found, done = find_in_parts(find, _joined(touching))
        if done < 1.0:
            raise NotConvergedError(
                f"no equilibrium beyond {100 * done:.1f} % of the force under the tool: the body"
                " buckles, or is pressed farther than its elements bear; press less"
            )
        return found

    def first(self, at: Unknowns) -> Unknowns | None:
        """The tip as deep in the resting skin as its springs alone would bear; None: too deep."""

        def excess(depth: float) -> float:
            return self.springs(np.append(at[:-1], at[-1] + depth)).push - self.force

        deepest = 0.5 * self.tip.radius
        if excess(deepest) < 0.0:
            return None
        return np.append(at[:-1], at[-1] + float(brentq(excess, 0.0, deepest)))


def _joined(press: FinitePress) -> Unknowns:
    """Displacement of the nodes, then the travel."""
    return np.append(press.displacement, press.travel)


def _along_normals(shape: csr_array, normal: Points) -> csr_array:
    """Rows that give each point's motion along its normal from the nodes' motion, (p, 3 n)."""
    entries = shape.tocoo()
    column = 3 * entries.col[:, None] + np.arange(3)
    value = entries.data[:, None] * normal[entries.row]
    row = np.repeat(entries.row, 3)
    size = shape.shape[0], 3 * shape.shape[1]
    return csr_array((value.ravel(), (row, column.ravel())), shape=size)


def _skin(body: Body, tip: Tip) -> _Skin:
    """Points of the faces that may meet the tip."""
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
    stiffness = _SPRINGS * body.shear_modulus / tip.radius * area
    return _Skin(matrix, matrix @ solid.nodes, stiffness)

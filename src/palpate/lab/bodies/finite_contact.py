"""A rigid tip pressed into a body at finite strain: without friction, with a given force.

The tip's shape is exact, the body is neo-Hookean. The surface may enter the tip by a little, which
a stiff layer of springs resists: what a body does under a given force hardly depends on how deep
the tip that gives it has gone.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import brentq
from scipy.sparse import csr_array, diags_array

from palpate.errors import InputError, NotConvergedError, SingularSystemError
from palpate.geometry import quadratic_shapes
from palpate.lab.bodies.contact import facet_samples, touch
from palpate.lab.bodies.finite_elements import Body, free_part, quadratic_basis, stiffness_matrix
from palpate.lab.bodies.neo_hookean import energy, inner_forces, tangent_moduli
from palpate.lab.bodies.sparse_cholesky import factorise
from palpate.lab.bodies.tips import Tip
from palpate.shapes import Points, PointScalars

# Pressure over depth of entry, over the shear modulus and one over the tip's radius: pressures of a
# modulus enter by a hundredth of the radius.
_SPRINGS = 100.0
# The surface may meet the tip within so many of its radii.
_REACH = 1.6
_MAX_STEPS = 40
# Forces out of balance, of the load; of the tip's force alike.
_BALANCED = 1e-7
_MAX_HALVINGS = 10
# Steps of the force, halved where one is too large, become no smaller than this share of it.
_LEAST_STEP = 1e-3


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
    body: Body, tip: Tip, force: float, *, start: FinitePress | None = None
) -> FinitePress:
    """Press a freely sliding tip into a neo-Hookean body until it pushes with a given force.

    Parameters
    ----------
    body : Body
    tip : Tip                       goes along its axis; what is across is held by the arm
    force : float [N]               along the tip's motion, > 0
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
    meeting = _Meeting(body, quadratic_basis(body.solid), tip, _skin(body, tip))
    if start is not None:
        found = meeting.equilibrium(force, start)
        if found is not None:
            return found
    now = FinitePress(np.zeros_like(body.solid.nodes), touch(body.solid, tip))
    done, part = 0.0, 1.0
    while done < 1.0:
        share = min(1.0, done + part)
        guess = now if done else meeting.first(now, share * force)
        found = None if guess is None else meeting.equilibrium(share * force, guess)
        if found is not None:
            now, done = found, share
            continue
        part *= 0.5
        if part < _LEAST_STEP:
            raise NotConvergedError(
                f"no equilibrium beyond {100 * done:.1f} % of the force under the tool: the body"
                " buckles, or is pressed farther than its elements bear; press less"
            )
    return now


@dataclass(frozen=True, slots=True, eq=False)
class _Meeting:
    """A body and a tip, with what is needed to bring them to rest."""

    body: Body
    basis: Any
    tip: Tip
    skin: _Skin

    def springs(self, at: FinitePress) -> _Springs:
        """Energy and forces of the skin's springs."""
        entered, normal = self.entered(at)
        size = self.skin.stiffness * entered
        return _Springs(
            0.5 * float(size @ entered),
            self.skin.shape.T @ (size[:, None] * normal),
            float(size @ (normal @ self.tip.direction)),
        )

    def entered(self, at: FinitePress) -> tuple[PointScalars, Points]:
        """How deep the skin's points are in the tip, and the tip's normals there."""
        places = self.skin.rest + self.skin.shape @ at.displacement
        distance, normal = self.tip.distance(at.travel, places)
        return np.maximum(-distance, 0.0), normal

    def potential(self, at: FinitePress, force: float) -> float:
        """Energy of body and springs less the work of the force on the tip."""
        stored = energy(self.body, self.basis, at.displacement)
        return stored + self.springs(at).energy - force * at.travel

    def first(self, at: FinitePress, force: float) -> FinitePress | None:
        """The tip as deep in the resting skin as its springs alone would bear; None: too deep."""

        def excess(depth: float) -> float:
            return self.springs(FinitePress(at.displacement, at.travel + depth)).push - force

        deepest = 0.5 * self.tip.radius
        if excess(deepest) < 0.0:
            return None
        return FinitePress(at.displacement, at.travel + float(brentq(excess, 0.0, deepest)))

    def equilibrium(self, force: float, at: FinitePress) -> FinitePress | None:
        """Rest under a force, near a place; None where Newton's method does not find it."""
        free = ~self.body.held
        for _ in range(_MAX_STEPS):
            springs = self.springs(at)
            missing = springs.force - inner_forces(self.body, self.basis, at.displacement)
            lacking = force - springs.push
            if max(float(np.linalg.norm(missing[free])), abs(lacking)) <= _BALANCED * force:
                return at
            step = self.step(at, missing, lacking, free)
            moved = None if step is None else self.shortened(force, at, step)
            if moved is None:
                return None
            at = moved
        return None

    def step(
        self, at: FinitePress, missing: Points, lacking: float, free: Bool[np.ndarray, " n"]
    ) -> FinitePress | None:
        """Newton's step; None where the tangent is not stable."""
        entered, normal = self.entered(at)
        weight = np.where(entered > 0.0, self.skin.stiffness, 0.0)
        ahead = normal @ self.tip.direction
        moduli = tangent_moduli(self.body, self.basis, at.displacement)
        across = _along_normals(self.skin.shape, normal)
        matrix = stiffness_matrix(self.basis, moduli) + across.T @ diags_array(weight) @ across
        coupling = (across.T @ (weight * ahead)).reshape(-1, 3)[free].reshape(-1, 1)
        try:
            factor = factorise(free_part(csr_array(matrix), self.body.held), self.nodes[free])
        except SingularSystemError:
            return None
        both = factor.solve(np.hstack([missing[free].reshape(-1, 1), coupling]))
        left = float(weight @ ahead**2) - float(coupling[:, 0] @ both[:, 1])
        if not left > 0.0:
            return None
        travel = (lacking + float(coupling[:, 0] @ both[:, 0])) / left
        change = np.zeros_like(at.displacement)
        change[free] = (both[:, 0] + travel * both[:, 1]).reshape(-1, 3)
        return FinitePress(change, travel)

    @property
    def nodes(self) -> Points:
        """Of the body at rest."""
        return self.body.solid.nodes

    def shortened(self, force: float, at: FinitePress, step: FinitePress) -> FinitePress | None:
        """The end of a step, halved until the potential falls (rounding apart)."""
        before, share = self.potential(at, force), 1.0
        for _ in range(_MAX_HALVINGS):
            moved = FinitePress(
                at.displacement + share * step.displacement, at.travel + share * step.travel
            )
            after = self.potential(moved, force)
            if after <= before + 1e-12 * abs(before):
                return moved
            share *= 0.5
        return None


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

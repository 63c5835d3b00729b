"""A rigid tip pressed into an elastic body: unilateral contact on the factorised stiffness.

The nodes under the tip may not enter it, and it cannot pull them. With the compliance between those
nodes this is a small problem of non-negative forces; the tip's shape is exact, the body is linear.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import brentq, nnls

from palpate.arrays import fixed_array
from palpate.errors import InputError, NotConvergedError
from palpate.geometry import TriangleMesh, area_vectors, quadratic_shapes, triangle_areas
from palpate.lab.bodies.finite_elements import Body, solve_load
from palpate.lab.bodies.tetrahedra import Solid
from palpate.lab.bodies.tips import Tip
from palpate.shapes import Points, Vector3

_MAX_ROUNDS = 60
# Normals and active nodes count as settled when forces change by less than this share.
_SETTLED = 1e-10
# A round and held body is not far from a half space: where the search for a force's depth begins.
_FIRST_DEPTH = 1.2
# Nodes that would enter the tip at this many times its depth may come to touch it.
_CANDIDATE_DEPTH = 1.3
# Every outer face is sampled on this many parts a side to find where the tip touches first.
_PARTS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """A body with a tip pressed into it.

    Parameters
    ----------
    depth : float [m]               travel of the tip from its first touch
    place : (3,) float [m]          centre of the sphere, or of the punch's face
    force : (3,) float [N]          total, of the tip on the body
    radius : float [m]              of a circle as large as the touched part of the surface
    load : (n, 3) float [N]         the tip's forces on the nodes
    displacement : (n, 3) float [m]
    """

    depth: float
    place: Vector3
    force: Vector3
    radius: float
    load: Float[np.ndarray, "n 3"]
    displacement: Float[np.ndarray, "n 3"]


@dataclass(frozen=True, slots=True, eq=False)
class _Candidates:
    """Nodes that may touch, and what unit forces on them do to them."""

    node: Int[np.ndarray, " k"]
    rest: Float[np.ndarray, "k 3"]
    compliance: Float[np.ndarray, "k 3 k 3"]


def touch(solid: Solid, tip: Tip) -> float:
    """How far along its axis from `tip.point` the tip first touches the body at rest.

    Parameters
    ----------
    solid : Solid
    tip : Tip

    Returns
    -------
    float [m]                       of the sphere's centre, or of the punch's face

    Raises
    ------
    InputError                      the tip passes the body
    """
    facets = solid.facets[_facing(solid, tip)]
    shape = quadratic_shapes(facet_samples())
    points = np.einsum("vq,fva->fqa", shape, solid.nodes[facets]).reshape(-1, 3)
    travel = tip.travel(np.concatenate([points, solid.nodes[np.unique(facets)]]))
    if not np.isfinite(travel).any():
        raise InputError(
            "the tip passes the body without touching it; check its point and direction"
        )
    return float(travel.min())


def press(
    body: Body, tip: Tip, depths: Float[np.ndarray, " s"], *, sticking: bool = False
) -> tuple[Press, ...]:
    """Press a tip to given depths, one after the other.

    Parameters
    ----------
    body : Body
    tip : Tip
    depths : (s,) float [m]         increasing, > 0, from the first touch
    sticking : bool                 what touches the tip moves with it; else it slides freely.
                                    Sticking depends on the path: take small steps

    Returns
    -------
    tuple of Press                  one a depth

    Raises
    ------
    InputError                      bad depths, a tip beside the body or at its support
    NotConvergedError               the set of touching nodes does not settle
    """
    depths = fixed_array(depths, name="depths", shape=(None,))
    if not len(depths) or depths[0] <= 0.0 or np.any(np.diff(depths) <= 0.0):
        raise InputError(
            f"depths are {depths.tolist()}; must be positive and increasing, in metres"
        )
    tip.check_depth(depths[-1])
    start = touch(body.solid, tip)
    near = _candidates(body, tip, start + _CANDIDATE_DEPTH * depths[-1])
    anchor = np.full((len(near.node), 3), np.nan)
    states = []
    for depth in depths:
        if sticking:
            forces, anchor = _stuck(near, tip, start + depth, anchor)
        else:
            forces = _sliding(near, tip, start + depth)
        states.append(_state(body, tip, near, forces, start, float(depth)))
    return tuple(states)


def press_to_force(body: Body, tip: Tip, force: float) -> Press:
    """Press a freely sliding tip until its force along its motion has a given size.

    Parameters
    ----------
    body : Body
    tip : Tip
    force : float [N]               > 0

    Returns
    -------
    Press                           its depth is found to 1e-10 of itself

    Raises
    ------
    InputError                      a force that is not positive or presses a sphere in by its
                                    radius, a tip beside the body
    NotConvergedError               the set of touching nodes does not settle
    """
    if not (np.isfinite(force) and force > 0.0):
        raise InputError(f"the force is {force}; must be positive, in newtons")
    modulus = 2.0 * body.shear_modulus / (1.0 - body.poisson_ratio)
    tip.check_force(force, modulus)
    start = touch(body.solid, tip)
    reach = min(_FIRST_DEPTH * tip.half_space_depth(force, modulus), tip.max_depth)
    near = _candidates(body, tip, start + _CANDIDATE_DEPTH * reach)

    def excess(depth: float) -> float:
        if depth == 0.0:
            return -force
        return float(_sliding(near, tip, start + depth).sum(axis=0) @ tip.direction) - force

    low = 0.0
    while (short := excess(reach)) < 0.0:
        tip.check_depth(reach)
        # Force grows with the depth to the power 1 (punch) to 1.5 (sphere): a little beyond.
        grown = 1.1 * force / max(short + force, 1e-3 * force)
        low, reach = reach, min(reach * min(grown, 4.0), tip.max_depth)
        near = _candidates(body, tip, start + _CANDIDATE_DEPTH * reach)
    depth = float(brentq(excess, low, reach, xtol=_SETTLED * reach, rtol=_SETTLED))
    return _state(body, tip, near, _sliding(near, tip, start + depth), start, depth)


def facet_samples() -> Float[np.ndarray, "q 3"]:
    """Barycentric coordinates of the points of degree 2 on each of a triangle's 16 parts.

    All count alike: their mean is the integral over the area.

    Source
    ------
    Strang and Fix, An analysis of the finite element method (1973): the three-point rule.
    """
    cell = 6 * np.stack(np.meshgrid(*2 * [np.arange(_PARTS)], indexing="ij"), -1).reshape(-1, 1, 2)
    upright, inverted = [[1, 1], [4, 1], [1, 4]], [[5, 5], [2, 5], [5, 2]]
    place = np.concatenate([cell + upright, cell + inverted]).reshape(-1, 2) / (6 * _PARTS)
    place = place[place.sum(axis=1) < 1.0]
    return np.column_stack([place, 1.0 - place.sum(axis=1)])


def _facing(solid: Solid, tip: Tip) -> Bool[np.ndarray, " f"]:
    """Outer faces that look against the tip's motion."""
    return area_vectors(TriangleMesh(solid.nodes, solid.facets[:, :3])) @ tip.direction < 0.0


def _candidates(body: Body, tip: Tip, reach: float) -> _Candidates:
    """Nodes that the tip would enter, were it to go as far as `reach` through the body at rest."""
    solid = body.solid
    nodes = np.unique(solid.facets[_facing(solid, tip)])
    nodes = nodes[tip.travel(solid.nodes[nodes]) < reach]
    if not len(nodes):
        raise InputError(
            "no node of the body lies under the tip; use smaller elements there (fine places)"
        )
    if body.held[nodes].any():
        raise InputError(
            f"the tip reaches {int(body.held[nodes].sum())} nodes of the support, which cannot"
            " move; press elsewhere, or less deep"
        )
    free = np.cumsum(~body.held) - 1
    right = np.zeros((body.factor.size, 3 * len(nodes)))
    rows = (3 * free[nodes][:, None] + np.arange(3)).ravel()
    right[rows, np.arange(len(rows))] = 1.0
    half = body.factor.half_solve(right)
    compliance = (half.T @ half).reshape(len(nodes), 3, len(nodes), 3)
    return _Candidates(nodes, solid.nodes[nodes], compliance)


def _sliding(near: _Candidates, tip: Tip, travel: float) -> Points:
    """Forces on the candidates without friction, (k, 3) [N].

    Source
    ------
    Signorini's problem in its dual form: minimise l C l / 2 - l p over l >= 0, where p is how deep
    the nodes at rest are in the tip; by a Cholesky factor of C it is one of non-negative least
    squares. The tip's normals are taken where the nodes are, by repetition.
    """
    moved = np.zeros_like(near.rest)
    forces = np.zeros_like(near.rest)
    for _ in range(_MAX_ROUNDS):
        distance, normal = tip.distance(travel, near.rest + moved)
        entered = np.einsum("ka,ka->k", normal, moved) - distance
        square = np.einsum("ka,kalb,lb->kl", normal, near.compliance, normal)
        root = np.linalg.cholesky(square)
        size, _ = nnls(root.T, np.linalg.solve(root, entered))
        before, forces = forces, size[:, None] * normal
        moved = np.einsum("kalb,lb->ka", near.compliance, forces)
        if np.abs(forces - before).max() <= _SETTLED * np.abs(forces).max():
            return forces
    raise NotConvergedError(
        f"the contact does not settle in {_MAX_ROUNDS} rounds; press less deep or in smaller steps"
    )


def _stuck(
    near: _Candidates, tip: Tip, travel: float, anchor: Float[np.ndarray, "k 3"]
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    """Forces on the candidates when touched nodes stay where they are on the tip.

    `anchor` is each node's place on the tip (NaN: not touching), relative to its axis point.
    """
    anchor = anchor.copy()
    place = tip.point + travel * tip.direction
    count = len(near.node)
    for _ in range(_MAX_ROUNDS):
        forces = np.zeros((count, 3))
        held = np.flatnonzero(np.isfinite(anchor[:, 0]))
        if len(held):
            wanted = place + anchor[held] - near.rest[held]
            block = near.compliance[held][:, :, held].reshape(3 * len(held), -1)
            forces[held] = np.linalg.solve(block, wanted.ravel()).reshape(-1, 3)
        moved = near.rest + np.einsum("kalb,lb->ka", near.compliance, forces)
        distance, normal = tip.distance(travel, moved)
        pulled = np.einsum("ka,ka->k", normal, forces) < 0.0
        entered = (distance < -1e-9 * tip.radius) & np.isnan(anchor[:, 0])
        if not (pulled | entered).any():
            return forces, anchor
        anchor[pulled] = np.nan
        entered &= ~pulled
        anchor[entered] = (moved - distance[:, None] * normal - place)[entered]
    raise NotConvergedError(
        f"the sticking contact does not settle in {_MAX_ROUNDS} rounds; press in smaller steps"
    )


def _state(
    body: Body, tip: Tip, near: _Candidates, forces: Points, start: float, depth: float
) -> Press:
    """Displacement of the whole body under the forces on the candidates."""
    load = np.zeros_like(body.solid.nodes)
    load[near.node] = forces
    touched = np.zeros(len(load), dtype=bool)
    touched[near.node] = (forces != 0.0).any(axis=1)
    return Press(
        depth=depth,
        place=tip.point + (start + depth) * tip.direction,
        force=load.sum(axis=0),
        radius=float(np.sqrt(_node_areas(body.solid)[touched].sum() / np.pi)),
        load=load,
        displacement=solve_load(body, load),
    )


def _node_areas(solid: Solid) -> Float[np.ndarray, " n"]:
    """Share of the surface that belongs to each node [m^2]: corners 1/12 of a facet, middles 1/4.

    These are the areas nearest to the nodes when the four parts of a facet are split in thirds.
    """
    area = triangle_areas(TriangleMesh(solid.nodes, solid.facets[:, :3]))
    share = area[:, None] * np.array([1, 1, 1, 3, 3, 3]) / 12.0
    return np.bincount(solid.facets.ravel(), share.ravel(), minlength=len(solid.nodes))

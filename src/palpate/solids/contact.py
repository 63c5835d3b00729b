"""A rigid tip pressed into a linear elastic body: unilateral contact on the factorised stiffness.

`contact` finds the forces from the compliance of the nodes that the tip may reach.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import brentq

from palpate.arrays import components_of, fixed_array
from palpate.contact import ContactState, move_tools, untouched
from palpate.errors import InputError
from palpate.geometry import TriangleMesh, area_vectors, quadratic_shapes, triangle_areas
from palpate.shapes import Vector3
from palpate.solids.finite_elements import Body, solve_load
from palpate.solids.tetrahedra import Solid
from palpate.solids.tips import Tip

# Relative accuracy of the depth at a force.
_TOLERANCE = 1e-10
# The search for the depth of a force begins at this many times the depth in a half space.
_FIRST_DEPTH = 1.2
# Candidate contact nodes are those that the tip would reach at this many times its depth.
_CANDIDATE_DEPTH = 1.3
# Each side of an outer face is divided into this many parts to find the first contact.
_SUBDIVISIONS = 4
# Nodes that may touch, their positions at rest [m], and their compliance [m/N].
_Candidates = tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 3"], Float[np.ndarray, "c c"]]


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """Equilibrium of a body with a tip pressed into it.

    Parameters
    ----------
    depth : float [m]               travel of the tip from first contact
    tip_position : (3,) float [m]   centre of the sphere, or of the punch's face
    force : (3,) float [N]          total force of the tip on the body
    radius : float [m]              radius of the circle with the area of the contact
    load : (n, 3) float [N]         nodal forces of the tip on the body
    displacement : (n, 3) float [m] nodal displacements
    """

    depth: float
    tip_position: Vector3
    force: Vector3
    radius: float
    load: Float[np.ndarray, "n 3"]
    displacement: Float[np.ndarray, "n 3"]


def touch(solid: Solid, tip: Tip) -> float:
    """Travel of the tip, along its axis from `tip.point`, to first contact with the body at rest.

    Parameters
    ----------
    solid : Solid
    tip : Tip

    Returns
    -------
    float [m]                       of the sphere's centre, or of the punch's face

    Raises
    ------
    InputError                      the tip misses the body
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


def press(body: Body, tip: Tip, depths: Float[np.ndarray, " s"]) -> tuple[Press, ...]:
    """Press a tip to given depths, one after the other.

    Parameters
    ----------
    body : Body
    tip : Tip                       under friction contact depends on the path: take small steps
    depths : (s,) float [m]         increasing, > 0, from first contact

    Returns
    -------
    tuple of Press                  one per depth

    Raises
    ------
    InputError                      invalid depths; a tip that misses the body or reaches its
                                    support
    NotConvergedError               the set of contact nodes does not converge
    """
    depths = fixed_array(depths, name="depths", shape=(None,))
    if not len(depths) or depths[0] <= 0.0 or np.any(np.diff(depths) <= 0.0):
        raise InputError(
            f"depths are {depths.tolist()}; must be positive and increasing, in metres"
        )
    tip.check_depth(depths[-1])
    start = touch(body.solid, tip)
    nodes, rest, compliance = _candidates(body, tip, start + _CANDIDATE_DEPTH * depths[-1])
    state, states = untouched(len(rest), [tip.moved(start)]), []
    for depth in depths:
        state = move_tools(rest, compliance, [tip.moved(start + depth)], state)
        states.append(_press(body, nodes, state, float(depth)))
    return tuple(states)


def press_to_force(body: Body, tip: Tip, force: float) -> Press:
    """Press a frictionless tip until its force along its motion reaches a given value.

    Parameters
    ----------
    body : Body
    tip : Tip
    force : float [N]               > 0

    Returns
    -------
    Press                           depth to a relative accuracy of 1e-10

    Raises
    ------
    InputError                      a force that is not positive, or that presses a sphere in by
                                    its radius; a tip that has friction, or misses the body
    NotConvergedError               the set of contact nodes does not converge
    """
    if not (np.isfinite(force) and force > 0.0):
        raise InputError(f"the force is {force}; must be positive, in newtons")
    if tip.tool.friction:
        raise InputError("a tip that sticks is pressed to a depth, not to a force; give a depth")
    modulus = 2.0 * body.shear_modulus / (1.0 - body.poisson_ratio)
    tip.check_force(force, modulus)
    start = touch(body.solid, tip)
    reach = min(_FIRST_DEPTH * tip.tool.dent(force / modulus), tip.max_depth)
    nodes, rest, compliance = _candidates(body, tip, start + _CANDIDATE_DEPTH * reach)

    def at(depth: float) -> ContactState:
        before = untouched(len(rest), [tip.moved(start)])
        return move_tools(rest, compliance, [tip.moved(start + depth)], before)

    def excess(depth: float) -> float:
        return -force - (float(at(depth).tool_force[0] @ tip.direction) if depth > 0.0 else 0.0)

    low = 0.0
    while (shortfall := excess(reach)) < 0.0:
        tip.check_depth(reach)
        # The force grows as the depth to the power 1 (punch) to 1.5 (sphere): go slightly beyond.
        growth = 1.1 * force / max(shortfall + force, 1e-3 * force)
        low, reach = reach, min(reach * min(growth, 4.0), tip.max_depth)
        nodes, rest, compliance = _candidates(body, tip, start + _CANDIDATE_DEPTH * reach)
    depth = float(brentq(excess, low, reach, xtol=_TOLERANCE * reach, rtol=_TOLERANCE))
    return _press(body, nodes, at(depth), depth)


def facet_samples() -> Float[np.ndarray, "q 3"]:
    """Barycentric coordinates of the three-point quadrature rule on each of a triangle's 16 parts.

    The rule is of degree 2 with equal weights: the mean over the points is the integral over the
    area, divided by the area.

    Returns
    -------
    (48, 3) float [-]

    Source
    ------
    Strang and Fix, An analysis of the finite element method (1973): the three-point rule.
    """
    cell = 6 * np.stack(np.meshgrid(*2 * [np.arange(_SUBDIVISIONS)], indexing="ij"), -1).reshape(
        -1, 1, 2
    )
    upright, inverted = [[1, 1], [4, 1], [1, 4]], [[5, 5], [2, 5], [5, 2]]
    coordinates = np.concatenate([cell + upright, cell + inverted]).reshape(-1, 2) / (
        6 * _SUBDIVISIONS
    )
    coordinates = coordinates[coordinates.sum(axis=1) < 1.0]
    return np.column_stack([coordinates, 1.0 - coordinates.sum(axis=1)])


def _facing(solid: Solid, tip: Tip) -> Bool[np.ndarray, " f"]:
    """Outer faces whose normals oppose the tip's motion."""
    return area_vectors(TriangleMesh(solid.nodes, solid.facets[:, :3])) @ tip.direction < 0.0


def _candidates(body: Body, tip: Tip, reach: float) -> _Candidates:
    """Nodes of the body at rest that the tip would reach within a travel of `reach`."""
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
    rows = components_of(free[nodes])
    right[rows, np.arange(len(rows))] = 1.0
    half = body.factor.half_solve(right)
    return nodes, solid.nodes[nodes], half.T @ half


def _press(body: Body, nodes: Int[np.ndarray, " k"], state: ContactState, depth: float) -> Press:
    """Equilibrium of the whole body under the forces on the candidate nodes."""
    load = np.zeros_like(body.solid.nodes)
    load[nodes] = state.force
    touched = np.zeros(len(load), dtype=bool)
    touched[nodes] = (state.force != 0.0).any(axis=1)
    return Press(
        depth=depth,
        tip_position=state.tools[0].position,
        force=load.sum(axis=0),
        radius=float(np.sqrt(_node_areas(body.solid)[touched].sum() / np.pi)),
        load=load,
        displacement=solve_load(body, load),
    )


def _node_areas(solid: Solid) -> Float[np.ndarray, " n"]:
    """Surface area of each node [m^2]: corners get 1/12 of a facet, midside nodes 1/4.

    Each of the four subtriangles of a facet gives a third of its area to each of its corners.
    """
    area = triangle_areas(TriangleMesh(solid.nodes, solid.facets[:, :3]))
    share = area[:, None] * np.array([1, 1, 1, 3, 3, 3]) / 12.0
    return np.bincount(solid.facets.ravel(), share.ravel(), minlength=len(solid.nodes))

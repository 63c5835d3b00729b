"""A tick: rounds of contact search and solution until nothing moves any more."""

import numba
import numpy as np

from palpate.simulation.kernels.friction import at_rest, solve_together, sweep
from palpate.simulation.kernels.linear import add_displacement, displace, dot, gather, set_frame
from palpate.simulation.kernels.nodes import (
    begin_tick,
    find_contacts,
    near_nodes,
    release_nodes,
    touching,
)
from palpate.simulation.kernels.response import updated_response

# Sweeps before a solution, where nodes came in or the last solution did not settle.
_SWEEPS = 8


@numba.njit(cache=True, error_model="numpy")
def contact_equations(tools, rest, nodes, nodal, frames, friction, residual, force, status):
    """What the equations of the touching nodes start from."""
    y = np.empty(3)
    for j in range(nodes.size):
        i = nodes[j]
        t = nodal.tool_of[i]
        friction[j], status[j] = tools.friction[t], nodal.status[i]
        set_frame(nodal.normal[i], frames[j])
        for a in range(3):
            force[j, a] = nodal.force[i, a]
            y[a] = rest[i, a] + nodal.displacement[i, a] - tools.position[t, a]
            for b in range(3):
                y[a] -= tools.rotation[t, a, b] * nodal.anchor[i, b]
        lift = nodal.gap[i] - dot(y, nodal.normal[i])
        for a in range(3):
            residual[j, a] = y[a] + lift * nodal.normal[i, a]


@numba.njit(cache=True, error_model="numpy")
def store_solution(nodes, nodal, force, status, slide):
    """Write forces and states of the touching nodes; returns the largest change and force."""
    change, largest_force = 0.0, 0.0
    for j in range(nodes.size):
        i = nodes[j]
        nodal.status[i] = status[j]
        for a in range(3):
            change = max(change, abs(force[j, a] - nodal.force[i, a]))
            largest_force = max(largest_force, abs(force[j, a]))
            nodal.force[i, a], nodal.slide[i, a] = force[j, a], slide[j, a]
    return change, largest_force


@numba.njit(cache=True, error_model="numpy")
def largest_displacement(nodes, nodal):
    """How far the touching nodes have moved at most."""
    largest = 0.0
    for i in nodes:
        for a in range(3):
            largest = max(largest, abs(nodal.displacement[i, a]))
    return largest


@numba.njit(cache=True, error_model="numpy")
def solve_round(tools, rest, nodes, compliance, response, nodal, sweeps):
    """One round of all touching nodes; returns whether they settled, the change and the force."""
    k = nodes.size
    frames, residual, force = np.empty((k, 3, 3)), np.empty((k, 3)), np.empty((k, 3))
    friction, status, slide = np.empty(k), np.empty(k, dtype=np.int64), np.empty((k, 3))
    contact_equations(tools, rest, nodes, nodal, frames, friction, residual, force, status)
    if not sweeps and at_rest(
        frames, friction, residual, force, status, slide, largest_displacement(nodes, nodal)
    ):
        store_solution(nodes, nodal, force, status, slide)
        return True, 0.0, 0.0
    free = residual - nodal.displacement[nodes]
    if sweeps:
        block = gather(compliance, nodes, nodes)
        sweep(block, frames, friction, residual, force, status, sweeps)
    given = nodal.given[nodes]
    settled = solve_together(
        response, given, frames, friction, free, residual, force, status, slide
    )
    change, largest_force = store_solution(nodes, nodal, force, status, slide)
    return settled, change, largest_force


@numba.njit(cache=True, error_model="numpy")
def negligible_force(tools, compliance):
    """A force whose displacement is lost in the rounding of the places."""
    size, softest = 0.0, 0.0
    for t in range(tools.kind.size):
        for a in range(3):
            size = max(size, abs(tools.position[t, a]) + tools.bounding_radius[t])
    for i in range(len(compliance)):
        softest = max(softest, compliance[i, i])
    return 8.0 * np.finfo(np.float64).eps * size / softest


@numba.njit(cache=True, error_model="numpy")
def settle(tools, rest, compliance, response, changes, nodal, tolerance, max_rounds):
    """Bring all touching nodes to rest after the tools have moved; `nodal` changes in place.

    Returns the rounds it took, zero where it did not settle, the response of the nodes that touched
    in the last, and the changes of nodes since that was built anew.
    """
    previous_displacement = nodal.displacement.copy()
    begin_tick(tools, rest, nodal)
    near = near_nodes(tools, rest, nodal)
    nodes = touching(near, nodal.tool_of)
    response, changes = updated_response(response, changes, compliance, tools, nodal)
    field = gather(compliance, nodes, near)
    # As long as no node changes its state, the equations of the tick before do.
    settled, fresh = True, False
    rounding = negligible_force(tools, compliance)
    for count in range(1, max_rounds + 1):
        displace(field, nodes, nodal.force, near, nodal.displacement)
        if find_contacts(tools, rest, previous_displacement, near, nodal) > 0:
            nodes, fresh = touching(near, nodal.tool_of), True
            response, changes = updated_response(response, changes, compliance, tools, nodal)
            field = gather(compliance, nodes, near)
        sweeps = 0 if settled and not fresh else _SWEEPS
        settled, change, largest_force = solve_round(
            tools, rest, nodes, compliance, response, nodal, sweeps
        )
        still = change <= max(tolerance * largest_force, rounding)
        if not fresh and still and (settled or count > max_rounds // 2):
            every = np.arange(len(rest))
            nodal.displacement[:] = 0.0
            add_displacement(compliance, nodes, nodal.force, 1.0, nodal.displacement.reshape(-1))
            if find_contacts(tools, rest, previous_displacement, every, nodal) == 0:
                release_nodes(tools, rest, nodes, nodal)
                return count, response, changes
            near, nodes, fresh = every, touching(every, nodal.tool_of), True
            response, changes = updated_response(response, changes, compliance, tools, nodal)
            field = gather(compliance, nodes, near)
        else:
            fresh = False
    return 0, response, changes


@numba.njit(cache=True, error_model="numpy")
def add_resultants(tools, rest, nodal, force, torque):
    """Add the force on each tool, and the torque about its position; both are (t, 3)."""
    for i in range(len(rest)):
        t = nodal.tool_of[i]
        if t >= 0:
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                arm_b = rest[i, b] + nodal.displacement[i, b] - tools.position[t, b]
                arm_c = rest[i, c] + nodal.displacement[i, c] - tools.position[t, c]
                force[t, a] -= nodal.force[i, a]
                torque[t, a] -= arm_b * nodal.force[i, c] - arm_c * nodal.force[i, b]

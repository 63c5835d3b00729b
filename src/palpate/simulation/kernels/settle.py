"""A tick: rounds of contact search and solution until nothing moves any more."""

import numba
import numpy as np

from palpate.simulation.kernels.friction import at_rest, solve_together, sweep
from palpate.simulation.kernels.linear import add_displacement, displace, dot, gather, set_frame
from palpate.simulation.kernels.nodes import begin_tick, find_contacts, leave, near_nodes, touching
from palpate.simulation.kernels.response import up_to_date

# Sweeps before a solution, where nodes came in or the last solution did not settle.
_SWEEPS = 8


@numba.njit(cache=True, error_model="numpy")
def set_up(tools, rest, nodes, nodal, frames, friction, residual, now, own):
    """What the equations of the touching nodes start from."""
    y = np.empty(3)
    for j in range(nodes.size):
        i = nodes[j]
        t = nodal.tool_of[i]
        friction[j], own[j] = tools.friction[t], nodal.status[i]
        set_frame(nodal.normal[i], frames[j])
        for a in range(3):
            now[j, a] = nodal.force[i, a]
            y[a] = rest[i, a] + nodal.moved[i, a] - tools.place[t, a]
            for b in range(3):
                y[a] -= tools.turn[t, a, b] * nodal.anchor[i, b]
        lift = nodal.gap[i] - dot(y, nodal.normal[i])
        for a in range(3):
            residual[j, a] = y[a] + lift * nodal.normal[i, a]


@numba.njit(cache=True, error_model="numpy")
def take_over(nodes, nodal, now, own, slide):
    """Write forces and states of the touching nodes; returns the largest change and force."""
    change, strength = 0.0, 0.0
    for j in range(nodes.size):
        i = nodes[j]
        nodal.status[i] = own[j]
        for a in range(3):
            change = max(change, abs(now[j, a] - nodal.force[i, a]))
            strength = max(strength, abs(now[j, a]))
            nodal.force[i, a], nodal.slide[i, a] = now[j, a], slide[j, a]
    return change, strength


@numba.njit(cache=True, error_model="numpy")
def farthest(nodes, nodal):
    """How far the touching nodes have moved at most."""
    most = 0.0
    for i in nodes:
        for a in range(3):
            most = max(most, abs(nodal.moved[i, a]))
    return most


@numba.njit(cache=True, error_model="numpy")
def solve_round(tools, rest, nodes, compliance, response, nodal, swept):
    """One round of all touching nodes; returns whether they settled, the change and the force."""
    k = nodes.size
    frames, residual, now = np.empty((k, 3, 3)), np.empty((k, 3)), np.empty((k, 3))
    friction, own, slide = np.empty(k), np.empty(k, dtype=np.int64), np.empty((k, 3))
    set_up(tools, rest, nodes, nodal, frames, friction, residual, now, own)
    if not swept and at_rest(frames, friction, residual, now, own, slide, farthest(nodes, nodal)):
        take_over(nodes, nodal, now, own, slide)
        return True, 0.0, 0.0
    free = residual - nodal.moved[nodes]
    if swept:
        block = gather(compliance, nodes, nodes)
        sweep(block, frames, friction, residual, now, own, swept)
    given = nodal.given[nodes]
    settled = solve_together(response, given, frames, friction, free, residual, now, own, slide)
    change, strength = take_over(nodes, nodal, now, own, slide)
    return settled, change, strength


@numba.njit(cache=True, error_model="numpy")
def smallest_force(tools, compliance):
    """A force whose displacement is lost in the rounding of the places."""
    size, softest = 0.0, 0.0
    for t in range(tools.kind.size):
        for a in range(3):
            size = max(size, abs(tools.place[t, a]) + tools.reach[t])
    for i in range(len(compliance)):
        softest = max(softest, compliance[i, i])
    return 8.0 * np.finfo(np.float64).eps * size / softest


@numba.njit(cache=True, error_model="numpy")
def settle(tools, rest, compliance, response, nodal, tolerance, most):
    """Bring all touching nodes to rest after the tools have moved; `nodal` changes in place.

    Returns the rounds it took, zero where it did not settle, and the response of the nodes that
    touched in the last.
    """
    before = nodal.moved.copy()
    begin_tick(tools, rest, nodal)
    near = near_nodes(tools, rest, nodal)
    nodes = touching(near, nodal.tool_of)
    response = up_to_date(response, compliance, tools, nodal)
    field = gather(compliance, nodes, near)
    # As long as no node changes its state, the equations of the tick before do.
    settled, fresh = True, False
    rounding = smallest_force(tools, compliance)
    for count in range(1, most + 1):
        displace(field, nodes, nodal.force, near, nodal.moved)
        if find_contacts(tools, rest, before, near, nodal) > 0:
            nodes, fresh = touching(near, nodal.tool_of), True
            response = up_to_date(response, compliance, tools, nodal)
            field = gather(compliance, nodes, near)
        swept = 0 if settled and not fresh else _SWEEPS
        settled, change, strength = solve_round(
            tools, rest, nodes, compliance, response, nodal, swept
        )
        still = change <= max(tolerance * strength, rounding)
        if not fresh and still and (settled or count > most // 2):
            every = np.arange(len(rest))
            nodal.moved[:] = 0.0
            add_displacement(compliance, nodes, nodal.force, 1.0, nodal.moved.reshape(-1))
            if find_contacts(tools, rest, before, every, nodal) == 0:
                leave(tools, rest, nodes, nodal)
                return count, response
            near, nodes, fresh = every, touching(every, nodal.tool_of), True
            response = up_to_date(response, compliance, tools, nodal)
            field = gather(compliance, nodes, near)
        else:
            fresh = False
    return 0, response


@numba.njit(cache=True, error_model="numpy")
def add_resultants(tools, rest, nodal, force, torque):
    """Add the force on each tool, and the torque about its place; both are (t, 3)."""
    for i in range(len(rest)):
        t = nodal.tool_of[i]
        if t >= 0:
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                arm_b = rest[i, b] + nodal.moved[i, b] - tools.place[t, b]
                arm_c = rest[i, c] + nodal.moved[i, c] - tools.place[t, c]
                force[t, a] -= nodal.force[i, a]
                torque[t, a] -= arm_b * nodal.force[i, c] - arm_c * nodal.force[i, b]

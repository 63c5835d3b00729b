"""Kernels: a tick, rounds of contact search and solution until nothing moves any more.

The search measures how far nodes are from a tool, how they came in, and when they leave.
"""

import numba
import numpy as np

from palpate.contact.friction import at_rest, solve_together, sweep
from palpate.contact.response import (
    NO_SLIP,
    OPEN,
    ROUND,
    ROUNDING,
    SLIDES,
    SPHERE,
    STICKS,
    add_displacement,
    displace,
    dot,
    gather,
    set_frame,
    updated_response,
)

# Sweeps before a solution, where nodes came in or the last solution did not settle.
_SWEEPS = 8
# Of a tool's bounding radius: nodes within so much of its surface are looked at first.
_NEAR = 0.02


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
    free, given = residual - nodal.displacement[nodes], nodal.given[nodes]
    # What sticks at any force is torn loose by the solution alone: sweeps would let go of nodes
    # that only their neighbours' forces, not found yet, seem to pull.
    settled = (
        k > 0
        and friction.max() >= NO_SLIP
        and solve_together(response, given, frames, friction, free, residual, force, status, slide)
    )
    if not settled:
        if sweeps:
            block = gather(compliance, nodes, nodes)
            sweep(block, frames, friction, residual, force, status, sweeps)
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
            size = max(size, abs(tools.position[t, a]) + tools.reach[t])
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


@numba.njit(cache=True, error_model="numpy")
def tool_gap(tools, t, face, y, normal):
    """Signed distance of a point of the tool's frame from its surface, and the normal there.

    With a face given, the distance is from its plane. Returns the distance and the face that it was
    measured from.
    """
    if tools.kind[t] == SPHERE:
        length = np.sqrt(y[0] ** 2 + y[1] ** 2 + y[2] ** 2)
        for a in range(3):
            normal[a] = y[a] / length
        return length - tools.radius[t], 0
    best, at = -np.inf, -1
    first, last = (face, face + 1) if face >= 0 else (tools.start[t], tools.start[t + 1])
    for k in range(first, last):
        height = over_face(tools, t, k, y)
        if height > best:
            best, at = height, k
    for a in range(3):
        normal[a] = tools.faces[at, a]
    if tools.kind[t] == ROUND:
        from_axis, across = np.hypot(y[0], y[1]), normal[0]
        # On the axis itself any direction is outward.
        normal[0] = across * (y[0] / from_axis if from_axis > 0.0 else 1.0)
        normal[1] = across * (y[1] / from_axis if from_axis > 0.0 else 0.0)
    return best, at


@numba.njit(cache=True, error_model="numpy")
def over_face(tools, t, k, y):
    """Signed distance of a point of the tool's frame from one of its faces."""
    p = tools.faces[k]
    if tools.kind[t] == ROUND:
        return p[0] * np.hypot(y[0], y[1]) + p[2] * y[2] - p[3]
    return p[0] * y[0] + p[1] * y[1] + p[2] * y[2] - p[3]


@numba.njit(cache=True, error_model="numpy")
def tool_gaps(tools, points):
    """Signed distances of points from the first tool, and its normals there."""
    gap, normal = np.empty(len(points)), np.empty((len(points), 3))
    y, local = np.empty(3), np.empty(3)
    for i in range(len(points)):
        to_tool(tools.rotation[0], tools.position[0], points[i], y)
        gap[i], _ = tool_gap(tools, 0, -1, y, local)
        for a in range(3):
            normal[i, a] = 0.0
            for b in range(3):
                normal[i, a] += tools.rotation[0, a, b] * local[b]
    return gap, normal


@numba.njit(cache=True, error_model="numpy")
def entry(tools, t, y0, y1):
    """Through which face, and which share of the way from y0 to y1, a point came into a tool."""
    if tools.kind[t] == SPHERE:
        g0 = np.sqrt(y0[0] ** 2 + y0[1] ** 2 + y0[2] ** 2) - tools.radius[t]
        g1 = np.sqrt(y1[0] ** 2 + y1[1] ** 2 + y1[2] ** 2) - tools.radius[t]
        return 0, (g0 / (g0 - g1) if g0 > 0.0 else 1.0)
    share, at, highest, shallowest = -1.0, -1, -np.inf, -1
    for k in range(tools.start[t], tools.start[t + 1]):
        g0, g1 = over_face(tools, t, k, y0), over_face(tools, t, k, y1)
        if g0 > 0.0 and g0 / (g0 - g1) > share:
            share, at = g0 / (g0 - g1), k
        if g1 > highest:
            highest, shallowest = g1, k
    return (at, share) if at >= 0 else (shallowest, 1.0)


@numba.njit(cache=True, error_model="numpy")
def to_tool(rotation, position, x, y):
    """A point of the object's frame in the tool's."""
    for a in range(3):
        y[a] = 0.0
        for b in range(3):
            y[a] += rotation[b, a] * (x[b] - position[b])


@numba.njit(cache=True, error_model="numpy")
def out_of_reach(tools, t, x, margin):
    """Whether a point is farther from a tool than its bounding radius and a margin."""
    far = 0.0
    for a in range(3):
        far += (x[a] - tools.position[t, a]) ** 2
    # What is on the rim is looked at: rounding does not decide.
    return far > (1.0 + 1e3 * ROUNDING) * (tools.reach[t] + margin) ** 2


@numba.njit(cache=True, error_model="numpy")
def find_contacts(tools, rest, previous_displacement, near, nodal):
    """Gaps of the nodes that may touch, at their present places; nodes that came into a tool join.

    Returns how many joined.
    """
    y, y0, x, x0, local = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    joined = 0
    for i in near:
        for a in range(3):
            x[a] = rest[i, a] + nodal.displacement[i, a]
            x0[a] = rest[i, a] + previous_displacement[i, a]
        if nodal.tool_of[i] < 0:
            for t in range(tools.kind.size):
                if out_of_reach(tools, t, x, 0.0):
                    continue
                to_tool(tools.rotation[t], tools.position[t], x, y)
                gap, _ = tool_gap(tools, t, -1, y, local)
                if gap < 0.0 and nodal.tool_of[i] < 0:
                    to_tool(tools.previous_rotation[t], tools.previous_position[t], x0, y0)
                    nodal.face[i], share = entry(tools, t, y0, y)
                    nodal.tool_of[i] = t
                    nodal.status[i] = STICKS if tools.friction[t] > 0.0 else SLIDES
                    for a in range(3):
                        nodal.anchor[i, a] = y0[a] + share * (y[a] - y0[a])
                    joined += 1
        t = nodal.tool_of[i]
        if t >= 0:
            to_tool(tools.rotation[t], tools.position[t], x, y)
            nodal.gap[i], _ = tool_gap(tools, t, nodal.face[i], y, local)
            for a in range(3):
                nodal.normal[i, a] = dot(tools.rotation[t, a], local)
    return joined


@numba.njit(cache=True, error_model="numpy")
def near_nodes(tools, rest, nodal):
    """Nodes that touch, or may come to touch in this tick; who is missed is found at its end."""
    out = np.empty(len(rest), dtype=np.int64)
    x, y, normal, count = np.empty(3), np.empty(3), np.empty(3), 0
    for i in range(len(rest)):
        keep = nodal.tool_of[i] >= 0
        for a in range(3):
            x[a] = rest[i, a] + nodal.displacement[i, a]
        for t in range(tools.kind.size):
            step = 0.0
            for a in range(3):
                step += (tools.position[t, a] - tools.previous_position[t, a]) ** 2
            margin = 2.0 * np.sqrt(step) + _NEAR * tools.reach[t]
            if not keep and not out_of_reach(tools, t, x, margin):
                to_tool(tools.rotation[t], tools.position[t], x, y)
                keep = tool_gap(tools, t, -1, y, normal)[0] < margin
        if keep:
            out[count] = i
            count += 1
    return out[:count]


@numba.njit(cache=True, error_model="numpy")
def begin_tick(tools, rest, nodal):
    """Let go of nodes that slid past the rim of their face; what was torn loose may stick again."""
    x, y, normal = np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(rest)):
        t = nodal.tool_of[i]
        if t >= 0 and tools.friction[t] >= NO_SLIP:
            nodal.status[i] = STICKS
        if t >= 0 and tools.kind[t] != SPHERE:
            for a in range(3):
                x[a] = rest[i, a] + nodal.displacement[i, a]
            to_tool(tools.previous_rotation[t], tools.previous_position[t], x, y)
            if tool_gap(tools, t, -1, y, normal)[0] > 1e3 * ROUNDING * tools.reach[t]:
                nodal.tool_of[i], nodal.face[i], nodal.status[i] = -1, -1, OPEN
                for a in range(3):
                    nodal.force[i, a] = 0.0


@numba.njit(cache=True, error_model="numpy")
def release_nodes(tools, rest, nodes, nodal):
    """Nodes that no force holds leave their tool; those that slid stick to where they are now."""
    x = np.empty(3)
    for i in nodes:
        t = nodal.tool_of[i]
        if nodal.status[i] == OPEN:
            nodal.tool_of[i], nodal.face[i] = -1, -1
            for a in range(3):
                nodal.force[i, a] = 0.0
        elif nodal.status[i] == SLIDES:
            for a in range(3):
                x[a] = rest[i, a] + nodal.displacement[i, a]
            to_tool(tools.rotation[t], tools.position[t], x, nodal.anchor[i])


@numba.njit(cache=True, error_model="numpy")
def touching(near, tool_of):
    """Nodes that touch a tool."""
    out = np.empty(near.size, dtype=np.int64)
    count = 0
    for i in near:
        if tool_of[i] >= 0:
            out[count] = i
            count += 1
    return out[:count]

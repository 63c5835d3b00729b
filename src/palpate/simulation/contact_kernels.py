"""Kernels of rigid contact on an elastic map: what a tick of a haptic loop does.

All vectors are in the object's frame unless said otherwise. `compliance` is (3 n, 3 n) and symmetric,
so that what a force does is read from a row. A force is that of the tool on the node.

Source
------
Jean, The non-smooth contact dynamics method, Comput. Methods Appl. Mech. Engrg. 177 (1999) 235: the
sweeps, node by node. Once these tell which nodes stick and which slide, the equations of all touching
nodes are solved together: the capacitance matrix of James and Pai, ArtDefo (SIGGRAPH 1999), section 4.
"""

from typing import NamedTuple

import numba
import numpy as np

# States of a node.
OPEN, SLIDES, STICKS = 0, 1, 2
# Kinds of tools.
SPHERE, FACES = 0, 1
# Between two solutions for all nodes at once.
_SWEEPS = 8
# Steps of a node's own problem of friction.
_NODE_STEPS = 12
# Of the largest force: what is less than nothing by so little is nothing.
_ROUNDING = 1e-12
# Coefficients of friction from which on nothing slides.
_GLUE = 1e9
# Of the way a node slides, in one round [rad].
_LARGEST_TURN = 0.5
# Of a tool's reach: nodes within so much of its surface are looked at first.
_NEAR = 0.02


class Nodal(NamedTuple):
    """What is known of all n nodes; the kernels change it in place.

    Attributes
    ----------
    force, moved : (n, 3) float [N], [m]
    tool_of, face, status : (n,) int        as in `ContactState`
    anchor, normal, slide : (n, 3) float
    gap : (n,) float [m]
    """

    force: np.ndarray
    moved: np.ndarray
    tool_of: np.ndarray
    face: np.ndarray
    status: np.ndarray
    anchor: np.ndarray
    normal: np.ndarray
    slide: np.ndarray
    gap: np.ndarray


class ToolArrays(NamedTuple):
    """Tools as the kernels see them; `planes` are those of all tools, one after the other.

    Attributes
    ----------
    kind, start : (t,), (t + 1,) int
    radius, reach : (t,) float [m]      of the sphere; of a ball about the place that holds the tool
    planes : (p, 4) float               outward normal, and the offset along it [m]
    friction : (t,) float               coefficient; 0 slides freely, infinite sticks
    place, turn : (t, 3), (t, 3, 3)     pose; a point y of the tool is at place + turn y
    before, turn_before                 the pose at the tick before
    """

    kind: np.ndarray
    start: np.ndarray
    radius: np.ndarray
    reach: np.ndarray
    planes: np.ndarray
    friction: np.ndarray
    place: np.ndarray
    turn: np.ndarray
    before: np.ndarray
    turn_before: np.ndarray


@numba.njit(cache=True, error_model="numpy")
def tool_gap(tools, t, face, y, normal):
    """Signed distance of a point of the tool's frame from its surface, and the outward normal there.

    With a face given, a point behind it counts against that face, unless another one is in front of
    the point. Returns the distance and the face that it was measured from.
    """
    if tools.kind[t] == SPHERE:
        length = np.sqrt(y[0] ** 2 + y[1] ** 2 + y[2] ** 2)
        for a in range(3):
            normal[a] = y[a] / length
        return length - tools.radius[t], 0
    best, at = -np.inf, -1
    for k in range(tools.start[t], tools.start[t + 1]):
        p = tools.planes[k]
        height = p[0] * y[0] + p[1] * y[1] + p[2] * y[2] - p[3]
        if height > best:
            best, at = height, k
    if face >= 0 and best <= _ROUNDING * tools.reach[t]:
        p = tools.planes[face]
        best, at = p[0] * y[0] + p[1] * y[1] + p[2] * y[2] - p[3], face
    for a in range(3):
        normal[a] = tools.planes[at, a]
    return best, at


@numba.njit(cache=True, error_model="numpy")
def entry(tools, t, y0, y1):
    """Through which face, and which share of the way from y0 to y1, a point came into a tool."""
    if tools.kind[t] == SPHERE:
        g0 = np.sqrt(y0[0] ** 2 + y0[1] ** 2 + y0[2] ** 2) - tools.radius[t]
        g1 = np.sqrt(y1[0] ** 2 + y1[1] ** 2 + y1[2] ** 2) - tools.radius[t]
        return 0, (g0 / (g0 - g1) if g0 > 0.0 else 1.0)
    share, at, highest, shallowest = -1.0, -1, -np.inf, -1
    for k in range(tools.start[t], tools.start[t + 1]):
        p = tools.planes[k]
        g0 = p[0] * y0[0] + p[1] * y0[1] + p[2] * y0[2] - p[3]
        g1 = p[0] * y1[0] + p[1] * y1[1] + p[2] * y1[2] - p[3]
        if g0 > 0.0 and g0 / (g0 - g1) > share:
            share, at = g0 / (g0 - g1), k
        if g1 > highest:
            highest, shallowest = g1, k
    return (at, share) if at >= 0 else (shallowest, 1.0)


@numba.njit(cache=True, error_model="numpy")
def to_tool(turn, place, x, y):
    """A point of the object's frame in the tool's."""
    for a in range(3):
        y[a] = 0.0
        for b in range(3):
            y[a] += turn[b, a] * (x[b] - place[b])


@numba.njit(cache=True, error_model="numpy")
def displace(compliance, nodes, force, rows, out):
    """Displacement of some rows of nodes under the forces on others; out is (n, 3)."""
    for i in rows:
        for a in range(3):
            out[i, a] = 0.0
    for j in nodes:
        for b in range(3):
            f = force[j, b]
            if f != 0.0:
                row = compliance[3 * j + b]
                for i in rows:
                    for a in range(3):
                        out[i, a] += f * row[3 * i + a]


@numba.njit(cache=True, error_model="numpy")
def find_contacts(tools, rest, before, near, nodal):
    """Gaps of the nodes that may touch, at their present places; nodes that came into a tool join.

    Returns how many joined.
    """
    y, y0, x, x0, local = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    joined = 0
    for i in near:
        for a in range(3):
            x[a] = rest[i, a] + nodal.moved[i, a]
            x0[a] = rest[i, a] + before[i, a]
        if nodal.tool_of[i] < 0:
            for t in range(tools.kind.size):
                to_tool(tools.turn[t], tools.place[t], x, y)
                gap, _ = tool_gap(tools, t, -1, y, local)
                if gap < 0.0 and nodal.tool_of[i] < 0:
                    to_tool(tools.turn_before[t], tools.before[t], x0, y0)
                    nodal.face[i], share = entry(tools, t, y0, y)
                    nodal.tool_of[i], nodal.status[i] = t, OPEN
                    for a in range(3):
                        nodal.anchor[i, a] = y0[a] + share * (y[a] - y0[a])
                    joined += 1
        t = nodal.tool_of[i]
        if t >= 0:
            to_tool(tools.turn[t], tools.place[t], x, y)
            nodal.gap[i], _ = tool_gap(tools, t, nodal.face[i], y, local)
            for a in range(3):
                nodal.normal[i, a] = dot(tools.turn[t, a], local)
    return joined


@numba.njit(cache=True, error_model="numpy")
def dot(x, y):
    """Scalar product of two vectors."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@numba.njit(cache=True, error_model="numpy")
def set_frame(normal, out):
    """Unit vectors by rows: the normal and two across it."""
    k = 0
    for a in range(1, 3):
        if abs(normal[a]) < abs(normal[k]):
            k = a
    length = np.sqrt(1.0 - normal[k] ** 2)
    for a in range(3):
        out[0, a] = normal[a]
        out[1, a] = ((1.0 if a == k else 0.0) - normal[k] * normal[a]) / length
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        out[2, a] = out[0, b] * out[1, c] - out[0, c] * out[1, b]


@numba.njit(cache=True, error_model="numpy")
def solve_in_place(matrix, right):
    """Gauss with partial pivoting; `right` becomes the solution."""
    size = right.size
    for c in range(size):
        best = c
        for r in range(c + 1, size):
            if abs(matrix[r, c]) > abs(matrix[best, c]):
                best = r
        if best != c:
            right[c], right[best] = right[best], right[c]
            for h in range(c, size):
                matrix[c, h], matrix[best, h] = matrix[best, h], matrix[c, h]
        for r in range(c + 1, size):
            factor = matrix[r, c] / matrix[c, c]
            if factor != 0.0:
                right[r] -= factor * right[c]
                low, high = matrix[c], matrix[r]
                for h in range(c + 1, size):
                    high[h] -= factor * low[h]
    for c in range(size - 1, -1, -1):
        row = matrix[c]
        total = right[c]
        for h in range(c + 1, size):
            total -= row[h] * right[h]
        right[c] = total / row[c]


@numba.njit(cache=True, error_model="numpy")
def node_force(w, q, friction, force, work):
    """The force on one node, the others given, in the frame of its normal.

    w (3, 3) is its own compliance, q (3,) gap and slide without force. Writes the force and returns
    the state.
    """
    if q[0] >= 0.0:
        for a in range(3):
            force[a] = 0.0
        return OPEN
    if friction > 0.0:
        trial = np.empty(3)
        for a in range(3):
            trial[a] = -q[a]
            for b in range(3):
                work[a, b] = w[a, b]
        solve_in_place(work, trial)
        across = np.sqrt(trial[1] ** 2 + trial[2] ** 2)
        if trial[0] > 0.0 and across <= friction * trial[0]:
            for a in range(3):
                force[a] = trial[a]
            return STICKS
    t1, t2, p = 0.0, 0.0, -q[0] / w[0, 0]
    if 0.0 < friction < _GLUE:
        t1, t2 = force[1], force[2]
        step = 2.0 / (w[1, 1] + w[2, 2])
        for _ in range(_NODE_STEPS):
            p = max(0.0, -(q[0] + w[0, 1] * t1 + w[0, 2] * t2) / w[0, 0])
            s1 = t1 - step * (q[1] + w[1, 0] * p + w[1, 1] * t1 + w[1, 2] * t2)
            s2 = t2 - step * (q[2] + w[2, 0] * p + w[2, 1] * t1 + w[2, 2] * t2)
            size = np.sqrt(s1**2 + s2**2)
            shrink = 1.0 if size <= friction * p or size == 0.0 else friction * p / size
            t1, t2 = shrink * s1, shrink * s2
    force[0], force[1], force[2] = p, t1, t2
    return SLIDES if p > 0.0 else OPEN


@numba.njit(cache=True, error_model="numpy")
def sweep(block, frames, friction, residual, force, status):
    """Gauss and Seidel: every node's force once, the others given.

    block is (3 k, 3 k); residual (k, 3) is the gap along the normal and the slide across it, as a
    vector, under `force` (k, 3). Both change in place.
    """
    k = friction.size
    local, now, q = np.empty(3), np.empty(3), np.empty(3)
    w, work, flat = np.empty((3, 3)), np.empty((3, 3)), residual.reshape(-1)
    for i in range(k):
        e = frames[i]
        for a in range(3):
            now[a] = local[a] = dot(e[a], force[i])
            for b in range(3):
                w[a, b] = 0.0
                for c in range(3):
                    w[a, b] += e[a, c] * dot(block[3 * i + c, 3 * i : 3 * i + 3], e[b])
        for a in range(3):
            q[a] = dot(e[a], residual[i]) - dot(w[a], now)
        status[i] = node_force(w, q, friction[i], local, work)
        for b in range(3):
            change = 0.0
            for a in range(3):
                change += e[a, b] * (local[a] - now[a])
            force[i, b] += change
            row = block[3 * i + b]
            for j in range(flat.size):
                flat[j] += change * row[j]


@numba.njit(cache=True, error_model="numpy")
def slide_directions(frames, friction, residual, force, status, slide):
    """Which way each sliding node goes on its tool: against its friction, where there is any."""
    for i in range(friction.size):
        for a in range(3):
            slide[i, a] = 0.0
        if status[i] == SLIDES and 0.0 < friction[i] < _GLUE:
            n = frames[i, 0]
            p, g = dot(force[i], n), dot(residual[i], n)
            pull, length = 0.0, 0.0
            for a in range(3):
                pull += (force[i, a] - p * n[a]) ** 2
                length += (residual[i, a] - g * n[a]) ** 2
            for a in range(3):
                if pull > 0.0:
                    slide[i, a] = -(force[i, a] - p * n[a]) / np.sqrt(pull)
                elif length > 0.0:
                    slide[i, a] = (residual[i, a] - g * n[a]) / np.sqrt(length)


@numba.njit(cache=True, error_model="numpy")
def set_across(normal, slide, out):
    """The unit vector across the normal and across the way a node slides."""
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        out[a] = normal[b] * slide[c] - normal[c] * slide[b]


@numba.njit(cache=True, error_model="numpy")
def capacitance(block, frames, friction, residual, force, status, slide):
    """Equations of the touching nodes, and what of the residual they demand to vanish.

    Unknown is the whole force of a sticking node, the pressing force of a sliding one, and the angle
    by which it turns the way it slides. Returns the matrix (m, m), and for every unknown its node,
    the direction of its force and the row's own direction.
    """
    k = friction.size
    node = np.empty(3 * k, dtype=np.int64)
    along, row, extra = np.zeros((3 * k, 3)), np.zeros((3 * k, 3)), np.zeros(3 * k)
    m = 0
    for i in range(k):
        if status[i] == STICKS:
            for a in range(3):
                node[m], along[m, a], row[m, a] = i, 1.0, 1.0
                m += 1
        elif status[i] == SLIDES:
            rubs = 0.0 < friction[i] < _GLUE
            limit = friction[i] if rubs else 0.0
            node[m] = i
            for a in range(3):
                row[m, a] = frames[i, 0, a]
                along[m, a] = frames[i, 0, a] - limit * slide[i, a]
            m += 1
            if rubs:
                node[m] = i
                set_across(frames[i, 0], slide[i], row[m])
                pull = limit * dot(force[i], frames[i, 0])
                for a in range(3):
                    along[m, a] = -pull * row[m, a]
                extra[m] = -max(0.0, dot(residual[i], slide[i]))
                m += 1
    matrix = np.empty((m, m))
    part = np.empty(3 * k)
    for h in range(m):
        # What each unknown does to every node, then what the rows see of it.
        j = 3 * node[h]
        x, y, z = along[h, 0], along[h, 1], along[h, 2]
        for i in range(3 * k):
            part[i] = x * block[j, i] + y * block[j + 1, i] + z * block[j + 2, i]
        for g in range(m):
            i = 3 * node[g]
            matrix[g, h] = (
                row[g, 0] * part[i] + row[g, 1] * part[i + 1] + row[g, 2] * part[i + 2]
            )
        matrix[h, h] += extra[h]
    return matrix, node[:m], along[:m], row[:m]


@numba.njit(cache=True, error_model="numpy")
def add_displacement(block, nodes, force, sign, out):
    """Add what the forces on some nodes do to all of them; out is flat, (3 n,)."""
    for j in nodes:
        for b in range(3):
            f = sign * force[j, b]
            if f != 0.0:
                row = block[3 * j + b]
                for i in range(out.size):
                    out[i] += f * row[i]


@numba.njit(cache=True, error_model="numpy")
def solve_together(block, frames, friction, residual, force, status, slide):
    """The forces of all nodes at once, if none of them changes its state by it.

    Changes residual and force in place and returns True; returns False and changes neither where a
    node would pull, part, come in, stick or slide.
    """
    k = friction.size
    if k == 0:
        return True
    slide_directions(frames, friction, residual, force, status, slide)
    matrix, node, along, row = capacitance(
        block, frames, friction, residual, force, status, slide
    )
    after = residual.copy()
    each = np.arange(k)
    add_displacement(block, each, force, -1.0, after.reshape(-1))
    right, found, depth = np.empty(node.size), np.zeros((k, 3)), 0.0
    for g in range(node.size):
        right[g] = -dot(row[g], after[node[g]])
        depth = max(depth, abs(right[g]))
    solve_in_place(matrix, right)
    for g in range(node.size):
        for a in range(3):
            found[node[g], a] += right[g] * along[g, a]
    add_displacement(block, each, found, 1.0, after.reshape(-1))
    turn_friction(frames, friction, node, right, found, status, slide)
    if not keeps_state(frames, friction, after, found, status, slide, depth):
        return False
    for i in range(k):
        for a in range(3):
            force[i, a], residual[i, a] = found[i, a], after[i, a]
    return True


@numba.njit(cache=True, error_model="numpy")
def keeps_state(frames, friction, residual, force, status, slide, depth):
    """Whether forces and residuals of all nodes are as their states demand."""
    strength = 0.0
    for i in range(friction.size):
        for a in range(3):
            strength = max(strength, abs(force[i, a]))
    for i in range(friction.size):
        n = frames[i, 0]
        p = dot(force[i], n)
        if status[i] == OPEN and dot(residual[i], n) < -_ROUNDING * depth:
            return False
        if status[i] != OPEN and p < -_ROUNDING * strength:
            return False
        if status[i] == STICKS and friction[i] < _GLUE:
            across = np.sqrt(max(0.0, dot(force[i], force[i]) - p**2))
            if across > friction[i] * p + _ROUNDING * strength:
                return False
        if status[i] == SLIDES and dot(residual[i], slide[i]) < -_ROUNDING * depth:
            return False
    return True


@numba.njit(cache=True, error_model="numpy")
def turn_friction(frames, friction, node, found, force, status, slide):
    """Turn the friction of sliding nodes by the angles that were found; `slide` turns with it."""
    across = np.empty(3)
    for g in range(1, node.size):
        i = node[g]
        if status[i] == SLIDES and node[g - 1] == i:
            n, p = frames[i, 0], found[g - 1]
            angle = min(max(found[g], -_LARGEST_TURN), _LARGEST_TURN)
            set_across(n, slide[i], across)
            for a in range(3):
                slide[i, a] = np.cos(angle) * slide[i, a] + np.sin(angle) * across[a]
                force[i, a] = p * (n[a] - friction[i] * slide[i, a])


@numba.njit(cache=True, error_model="numpy")
def gather(compliance, nodes):
    """Rows and columns of some nodes."""
    k = nodes.size
    block = np.empty((3 * k, 3 * k))
    for i in range(k):
        for j in range(k):
            for a in range(3):
                for b in range(3):
                    block[3 * i + a, 3 * j + b] = compliance[3 * nodes[i] + a, 3 * nodes[j] + b]
    return block


@numba.njit(cache=True, error_model="numpy")
def near_nodes(tools, rest, nodal):
    """Nodes that touch, or may come to touch in this tick; who is missed is found at its end."""
    out = np.empty(len(rest), dtype=np.int64)
    x, y, normal, count = np.empty(3), np.empty(3), np.empty(3), 0
    for i in range(len(rest)):
        keep = nodal.tool_of[i] >= 0
        for a in range(3):
            x[a] = rest[i, a] + nodal.moved[i, a]
        for t in range(tools.kind.size):
            step, far = 0.0, 0.0
            for a in range(3):
                step += (tools.place[t, a] - tools.before[t, a]) ** 2
                far += (x[a] - tools.place[t, a]) ** 2
            margin = 2.0 * np.sqrt(step) + _NEAR * tools.reach[t]
            if not keep and far <= (tools.reach[t] + margin) ** 2:
                to_tool(tools.turn[t], tools.place[t], x, y)
                keep = tool_gap(tools, t, -1, y, normal)[0] < margin
        if keep:
            out[count] = i
            count += 1
    return out[:count]


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
def touching(near, tool_of):
    """Those of some nodes that touch a tool."""
    out = np.empty(near.size, dtype=np.int64)
    count = 0
    for i in near:
        if tool_of[i] >= 0:
            out[count] = i
            count += 1
    return out[:count]


@numba.njit(cache=True, error_model="numpy")
def solve_round(tools, rest, nodes, block, nodal, swept):
    """One round of all touching nodes; returns whether they settled, the change and the force."""
    k = nodes.size
    frames, residual, now = np.empty((k, 3, 3)), np.empty((k, 3)), np.empty((k, 3))
    friction, own, slide = np.empty(k), np.empty(k, dtype=np.int64), np.empty((k, 3))
    set_up(tools, rest, nodes, nodal, frames, friction, residual, now, own)
    for _ in range(swept):
        sweep(block, frames, friction, residual, now, own)
    settled = solve_together(block, frames, friction, residual, now, own, slide)
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
def settle(tools, rest, compliance, nodal, tolerance, most):
    """Bring all touching nodes to rest after the tools have moved; `nodal` changes in place.

    Returns the rounds it took; zero: it did not settle.
    """
    before = nodal.moved.copy()
    near = near_nodes(tools, rest, nodal)
    nodes = touching(near, nodal.tool_of)
    block = gather(compliance, nodes)
    settled, fresh = False, True
    rounding = smallest_force(tools, compliance)
    for count in range(1, most + 1):
        displace(compliance, nodes, nodal.force, near, nodal.moved)
        if find_contacts(tools, rest, before, near, nodal) > 0:
            nodes = touching(near, nodal.tool_of)
            block, fresh = gather(compliance, nodes), True
        swept = 0 if settled and not fresh else _SWEEPS
        settled, change, strength = solve_round(tools, rest, nodes, block, nodal, swept)
        still = change <= max(tolerance * strength, rounding)
        if not fresh and still and (settled or count > most // 2):
            every = np.arange(len(rest))
            nodal.moved[:] = 0.0
            add_displacement(compliance, nodes, nodal.force, 1.0, nodal.moved.reshape(-1))
            if find_contacts(tools, rest, before, every, nodal) == 0:
                leave(tools, rest, nodes, nodal)
                return count
            near, nodes = every, touching(every, nodal.tool_of)
            block, fresh = gather(compliance, nodes), True
        else:
            fresh = False
    return 0


@numba.njit(cache=True, error_model="numpy")
def leave(tools, rest, nodes, nodal):
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
                x[a] = rest[i, a] + nodal.moved[i, a]
            to_tool(tools.turn[t], tools.place[t], x, nodal.anchor[i])


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def move_surface(surface, nodes, force, out):
    """Displacement of the whole surface, (3 v,), under the forces on some nodes.

    surface is (n, 3, 3 v).
    """
    out[:] = 0.0
    for j in nodes:
        for b in range(3):
            f = force[j, b]
            row = surface[j, b]
            for i in range(out.size):
                out[i] += f * row[i]

"""Forces of the touching nodes: no pulling, no penetration, Coulomb's friction.

Source
------
Alart and Curnier, A mixed formulation for frictional contact problems prone to Newton like solution
methods, Comput. Methods Appl. Mech. Engrg. 92 (1991) 353: the equations of all touching nodes are
solved together, and nodes whose state the solution contradicts change it. Jean, The non-smooth
contact dynamics method, ibid. 177 (1999) 235: sweeps, node by node, where that does not settle.
"""

import numba
import numpy as np

from palpate.contact.response import (
    BY_DISPLACEMENT,
    BY_FORCE,
    NO_SLIP,
    OPEN,
    ROUNDING,
    SLIDES,
    STICKS,
    add_columns,
    assign,
    component,
    dot,
    invert,
    solve,
)

# Steps of a node's own problem of friction.
_NODE_STEPS = 12
# Of the largest force, and of the farthest that a touching node has moved: what is left of the
# equations counts as nothing.
_TOLERANCE = 1e-11
# Solutions for all nodes at once before sweeps decide which of them stick and which slide.
_CHANGES = 5
# Of the way a node slides, in one round [rad].
_LARGEST_TURN = 0.5


@numba.njit(cache=True, error_model="numpy")
def node_force(w, inverse, q, friction, state, force, trial):
    """The force on one node, the others given, in the frame of its normal.

    w (3, 3) is its own compliance, and its inverse; q (3,) gap and slide without force; trial (3,)
    is room to work in. Writes the force and returns the state. What sticks whatever its force, and
    was torn loose, does not stick again before the tick is over.
    """
    if q[0] >= 0.0:
        for a in range(3):
            force[a] = 0.0
        return OPEN
    if friction > 0.0 and (friction < NO_SLIP or state == STICKS):
        for a in range(3):
            trial[a] = -(inverse[a, 0] * q[0] + inverse[a, 1] * q[1] + inverse[a, 2] * q[2])
        across = np.sqrt(trial[1] ** 2 + trial[2] ** 2)
        if trial[0] > 0.0 and across <= friction * trial[0]:
            for a in range(3):
                force[a] = trial[a]
            return STICKS
    t1, t2, p = 0.0, 0.0, -q[0] / w[0, 0]
    if 0.0 < friction < NO_SLIP:
        t1, t2 = force[1], force[2]
        step = 2.0 / (w[1, 1] + w[2, 2])
        for _ in range(_NODE_STEPS):
            p = max(0.0, -(q[0] + w[0, 1] * t1 + w[0, 2] * t2) / w[0, 0])
            s1 = t1 - step * (q[1] + w[1, 0] * p + w[1, 1] * t1 + w[1, 2] * t2)
            s2 = t2 - step * (q[2] + w[2, 0] * p + w[2, 1] * t1 + w[2, 2] * t2)
            size = np.sqrt(s1**2 + s2**2)
            shrink = 1.0 if size <= friction * p or size == 0.0 else friction * p / size
            change = max(abs(shrink * s1 - t1), abs(shrink * s2 - t2))
            t1, t2 = shrink * s1, shrink * s2
            if change <= ROUNDING * friction * p:
                break
    force[0], force[1], force[2] = p, t1, t2
    return SLIDES if p > 0.0 else OPEN


@numba.njit(cache=True, error_model="numpy")
def own_compliances(block, frames):
    """What each node's force does to itself, in the frame of its normal, and the inverse.

    Both are (k, 3, 3).
    """
    k = len(frames)
    compliance, inverse = np.zeros((k, 3, 3)), np.empty((k, 3, 3))
    for i in range(k):
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    for d in range(3):
                        part = frames[i, a, c] * block[3 * i + c, 3 * i + d]
                        compliance[i, a, b] += part * frames[i, b, d]
        invert(compliance[i], inverse[i])
    return compliance, inverse


@numba.njit(cache=True, error_model="numpy")
def sweep(block, frames, friction, residual, force, status, times):
    """Gauss and Seidel: every node's force some times, the others given.

    block is (3 k, 3 k); residual (k, 3) is the gap along the normal and the slide across it, as a
    vector, under `force` (k, 3). Both change in place.
    """
    k = friction.size
    local, now, q, trial = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    flat = residual.reshape(-1)
    compliance, inverse = own_compliances(block, frames)
    for step in range(times * k):
        i = step % k
        w = compliance[i]
        for a in range(3):
            now[a] = local[a] = component(frames, i, a, force)
        for a in range(3):
            free = w[a, 0] * now[0] + w[a, 1] * now[1] + w[a, 2] * now[2]
            q[a] = component(frames, i, a, residual) - free
        status[i] = node_force(w, inverse[i], q, friction[i], status[i], local, trial)
        change = 0.0
        for a in range(3):
            local[a] -= now[a]
            change = max(change, abs(local[a]))
        if change > 0.0:
            for a in range(3):
                now[a] = 0.0
                for b in range(3):
                    now[a] += frames[i, b, a] * local[b]
                force[i, a] += now[a]
            add_columns(block, i, now, flat)


@numba.njit(cache=True, error_model="numpy")
def slide_directions(frames, friction, residual, force, status, slide):
    """Direction in which each sliding node moves on its tool: against its friction, if any."""
    for i in range(friction.size):
        for a in range(3):
            slide[i, a] = 0.0
        if status[i] == SLIDES and 0.0 < friction[i] < NO_SLIP:
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
def unknowns(given, frames, friction, residual, force, status, slide):
    """Unknowns and equations of the touching nodes.

    A sticking node has none, since its displacement is given. A node that slides under friction has
    two, its motion along the slide and across it; the equations say that its force has the size of
    friction and is opposite to the slide. A node whose force is given has the pressing force as its
    unknown; the equation says that it stays on the tool. Returns, for every unknown, its node, its
    direction, the direction in which its equation takes the response of the node, and the factor
    of the unknown itself.
    """
    k = friction.size
    node = np.empty(3 * k, dtype=np.int64)
    along, row, extra = np.zeros((3 * k, 3)), np.zeros((3 * k, 3)), np.zeros(3 * k)
    m = 0
    for i in range(k):
        n, has_friction = frames[i, 0], 0.0 < friction[i] < NO_SLIP
        if given[i] == BY_FORCE and status[i] == SLIDES:
            node[m] = i
            for a in range(3):
                along[m, a] = row[m, a] = n[a]
            m += 1
        elif given[i] == BY_DISPLACEMENT and status[i] == SLIDES and has_friction:
            node[m] = node[m + 1] = i
            pull, far = friction[i] * dot(force[i], n), max(0.0, dot(residual[i], slide[i]))
            set_across(n, slide[i], along[m + 1])
            for a in range(3):
                along[m, a] = slide[i, a]
                row[m, a] = slide[i, a] + friction[i] * n[a]
                row[m + 1, a] = far * along[m + 1, a]
            extra[m + 1] = pull if far + pull > 0.0 else 1.0
            m += 2
        elif given[i] == BY_DISPLACEMENT and status[i] != STICKS:
            for a in range(1 if status[i] == SLIDES else 0, 3):
                node[m] = i
                for b in range(3):
                    along[m, b] = row[m, b] = frames[i, a, b]
                m += 1
    return node[:m], along[:m], row[:m], extra[:m]


@numba.njit(cache=True, error_model="numpy")
def at_rest(frames, friction, residual, force, status, slide, depth):
    """Whether the forces are those that `solve_together` would find, to `_TOLERANCE` of the largest
    force and of a depth."""
    slide_directions(frames, friction, residual, force, status, slide)
    across, largest_force = np.empty(3), 0.0
    for i in range(friction.size):
        for a in range(3):
            largest_force = max(largest_force, abs(force[i, a]))
    for i in range(friction.size):
        left = 0.0
        if status[i] == STICKS:
            left = max(abs(residual[i, 0]), abs(residual[i, 1]), abs(residual[i, 2]))
        elif status[i] == SLIDES:
            left, has_friction = abs(component(frames, i, 0, residual)), 0.0 < friction[i] < NO_SLIP
            pull = np.hypot(component(frames, i, 1, force), component(frames, i, 2, force))
            limit = friction[i] * component(frames, i, 0, force) if has_friction else 0.0
            # The normal has turned since the force was found.
            if abs(pull - limit) > _TOLERANCE * largest_force:
                return False
            if has_friction:
                set_across(frames[i, 0], slide[i], across)
                left = max(left, abs(dot(across, residual[i])))
        if left > _TOLERANCE * depth:
            return False
    return contradicted(frames, friction, residual, force, status.copy(), slide, depth) == 0


@numba.njit(cache=True, error_model="numpy")
def apply_response(response, given, free, prescribed, force, residual):
    """Forces and residuals of all nodes from what is prescribed of them; `free` is the residual
    without force. All are (k, 3)."""
    flat = response @ prescribed.reshape(-1)
    for i in range(len(given)):
        for a in range(3):
            value = flat[3 * i + a]
            if given[i] == BY_FORCE:
                force[i, a], residual[i, a] = prescribed[i, a], free[i, a] + value
            else:
                force[i, a], residual[i, a] = value, free[i, a] + prescribed[i, a]


@numba.njit(cache=True, error_model="numpy")
def solve_once(response, given, frames, friction, free, residual, force, status, slide):
    """Forces and residuals of all nodes in their states, in place; friction turns linearly.

    Returns False where the equations are singular.
    """
    node, along, row, extra = unknowns(given, frames, friction, residual, force, status, slide)
    prescribed = np.zeros((len(given), 3))
    for i in range(len(given)):
        if given[i] == BY_DISPLACEMENT:
            for a in range(3):
                prescribed[i, a] = -free[i, a]
    m = node.size
    apply_response(response, given, free, prescribed, force, residual)
    matrix, solution, part = np.empty((m, m)), np.empty(m), np.empty(len(response))
    for g in range(m):
        j, seen = node[g], residual if given[node[g]] == BY_FORCE else force
        solution[g] = -dot(row[g], seen[j])
        part[:] = 0.0
        first, second, third = response[3 * j], response[3 * j + 1], response[3 * j + 2]
        for i in range(part.size):
            part[i] = row[g, 0] * first[i] + row[g, 1] * second[i] + row[g, 2] * third[i]
        for h in range(m):
            i = 3 * node[h]
            matrix[g, h] = (
                along[h, 0] * part[i] + along[h, 1] * part[i + 1] + along[h, 2] * part[i + 2]
            )
        matrix[g, g] += extra[g]
    if not solve(matrix, solution):
        return False
    for g in range(m):
        for a in range(3):
            prescribed[node[g], a] += solution[g] * along[g, a]
    apply_response(response, given, free, prescribed, force, residual)
    return True


@numba.njit(cache=True, error_model="numpy")
def solve_together(response, given, frames, friction, free, residual, force, status, slide):
    """The forces of all nodes at once; where the solution contradicts states, these change and the
    equations are solved again.

    Changes residual, force and status in place and returns True when no node is contradicted any
    more; returns False and changes none of them where that does not happen.
    """
    if friction.size == 0:
        return True
    forces, after, states, depth = force.copy(), residual.copy(), status.copy(), 0.0
    pull = np.empty(friction.size)
    for i in range(friction.size):
        depth = max(depth, abs(dot(free[i], frames[i, 0])))
    for _ in range(_CHANGES):
        slide_directions(frames, friction, after, forces, states, slide)
        for i in range(friction.size):
            pull[i] = friction[i] * dot(forces[i], frames[i, 0])
        if not solve_once(response, given, frames, friction, free, after, forces, states, slide):
            return False
        turn_friction(frames, friction, pull, forces, states, slide)
        if not contradicted(frames, friction, after, forces, states, slide, depth):
            assign(forces, force)
            assign(after, residual)
            assign(states, status)
            return True
    return False


@numba.njit(cache=True, error_model="numpy")
def contradicted(frames, friction, residual, force, status, slide, depth):
    """Number of nodes whose force or residual contradicts their state; these change state.

    A node that sticks whatever its force and was torn loose slides if it comes in again.
    """
    largest_force, count = 0.0, 0
    for i in range(friction.size):
        for a in range(3):
            largest_force = max(largest_force, abs(force[i, a]))
    for i in range(friction.size):
        n, state = frames[i, 0], status[i]
        p = dot(force[i], n)
        if state == OPEN:
            if dot(residual[i], n) < -ROUNDING * depth:
                state = STICKS if 0.0 < friction[i] < NO_SLIP else SLIDES
        elif p < -ROUNDING * largest_force:
            state = OPEN
        elif state == STICKS and friction[i] < NO_SLIP:
            across = np.sqrt(max(0.0, dot(force[i], force[i]) - p**2))
            if across > friction[i] * p + ROUNDING * largest_force:
                state = SLIDES
        elif state == SLIDES and dot(residual[i], slide[i]) < -ROUNDING * depth:
            state = STICKS
        if state != status[i]:
            status[i] = state
            count += 1
    return count


@numba.njit(cache=True, error_model="numpy")
def turn_friction(frames, friction, pull, force, status, slide):
    """Turn the friction of sliding nodes by the angles found; `slide` turns with it.

    pull (k,) is the size of friction before, by which the angles are measured.
    """
    across = np.empty(3)
    for i in range(friction.size):
        if status[i] == SLIDES and 0.0 < friction[i] < NO_SLIP:
            n, p = frames[i, 0], dot(force[i], frames[i, 0])
            set_across(n, slide[i], across)
            angle = -dot(force[i], across) / pull[i] if pull[i] > 0.0 else 0.0
            angle = min(max(angle, -_LARGEST_TURN), _LARGEST_TURN)
            for a in range(3):
                slide[i, a] = np.cos(angle) * slide[i, a] + np.sin(angle) * across[a]
                force[i, a] = p * (n[a] - friction[i] * slide[i, a])

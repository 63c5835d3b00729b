"""Forces of the touching nodes: no pulling, no penetration, Coulomb's friction.

Source
------
Jean, The non-smooth contact dynamics method, Comput. Methods Appl. Mech. Engrg. 177 (1999) 235: the
sweeps, node by node. Once these tell which nodes stick and which slide, the equations of all that
touch are solved together: the capacitance matrix of James and Pai, ArtDefo (SIGGRAPH 1999), section
4.
"""

import numba
import numpy as np

from palpate.simulation.kernels.linear import (
    add_columns,
    add_displacement,
    component,
    dot,
    invert,
)
from palpate.simulation.kernels.state import GLUE, OPEN, ROUNDING, SLIDES, STICKS

# Steps of a node's own problem of friction.
_NODE_STEPS = 12
# Of the largest force, and of the farthest that a touching node has moved: what is left of the
# equations counts as nothing.
_NOTHING = 1e-11
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
    if friction > 0.0 and (friction < GLUE or state == STICKS):
        for a in range(3):
            trial[a] = -(inverse[a, 0] * q[0] + inverse[a, 1] * q[1] + inverse[a, 2] * q[2])
        across = np.sqrt(trial[1] ** 2 + trial[2] ** 2)
        if trial[0] > 0.0 and across <= friction * trial[0]:
            for a in range(3):
                force[a] = trial[a]
            return STICKS
    t1, t2, p = 0.0, 0.0, -q[0] / w[0, 0]
    if 0.0 < friction < GLUE:
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
    own, inverse = np.zeros((k, 3, 3)), np.empty((k, 3, 3))
    for i in range(k):
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    for d in range(3):
                        part = frames[i, a, c] * block[3 * i + c, 3 * i + d]
                        own[i, a, b] += part * frames[i, b, d]
        invert(own[i], inverse[i])
    return own, inverse


@numba.njit(cache=True, error_model="numpy")
def sweep(block, frames, friction, residual, force, status, times):
    """Gauss and Seidel: every node's force some times, the others given.

    block is (3 k, 3 k); residual (k, 3) is the gap along the normal and the slide across it, as a
    vector, under `force` (k, 3). Both change in place.
    """
    k = friction.size
    local, now, q, trial = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    flat = residual.reshape(-1)
    own, inverse = own_compliances(block, frames)
    for step in range(times * k):
        i = step % k
        w = own[i]
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
    """Which way each sliding node goes on its tool: against its friction, where there is any."""
    for i in range(friction.size):
        for a in range(3):
            slide[i, a] = 0.0
        if status[i] == SLIDES and 0.0 < friction[i] < GLUE:
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

    Unknown is the whole force of a sticking node, the pressing force of a sliding one, and the
    angle by which it turns the way it slides. Returns the matrix (m, m), and for every unknown its
    node, the direction of its force and the row's own direction.
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
            rubs = 0.0 < friction[i] < GLUE
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
            matrix[g, h] = row[g, 0] * part[i] + row[g, 1] * part[i + 1] + row[g, 2] * part[i + 2]
        matrix[h, h] += extra[h]
    return matrix, node[:m], along[:m], row[:m]


@numba.njit(cache=True, error_model="numpy")
def at_rest(frames, friction, residual, force, status, slide, depth):
    """Whether the forces are those that `solve_together` would find, to `_NOTHING` of the largest
    force and of a depth."""
    slide_directions(frames, friction, residual, force, status, slide)
    across, strength = np.empty(3), 0.0
    for i in range(friction.size):
        for a in range(3):
            strength = max(strength, abs(force[i, a]))
    for i in range(friction.size):
        left = 0.0
        if status[i] == STICKS:
            left = max(abs(residual[i, 0]), abs(residual[i, 1]), abs(residual[i, 2]))
        elif status[i] == SLIDES:
            left, rubs = abs(component(frames, i, 0, residual)), 0.0 < friction[i] < GLUE
            pull = np.hypot(component(frames, i, 1, force), component(frames, i, 2, force))
            limit = friction[i] * component(frames, i, 0, force) if rubs else 0.0
            # The normal has turned since the force was found.
            if abs(pull - limit) > _NOTHING * strength:
                return False
            if rubs:
                set_across(frames[i, 0], slide[i], across)
                left = max(left, abs(dot(across, residual[i])))
        if left > _NOTHING * depth:
            return False
    return keeps_state(frames, friction, residual, force, status, slide, depth)


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
    matrix, node, along, row = capacitance(block, frames, friction, residual, force, status, slide)
    after = residual.copy()
    each = np.arange(k)
    add_displacement(block, each, force, -1.0, after.reshape(-1))
    right, found, depth = np.empty(node.size), np.zeros((k, 3)), 0.0
    for g in range(node.size):
        right[g] = -dot(row[g], after[node[g]])
        depth = max(depth, abs(right[g]))
    right = np.linalg.solve(matrix, right)
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
        if status[i] == OPEN and dot(residual[i], n) < -ROUNDING * depth:
            return False
        if status[i] != OPEN and p < -ROUNDING * strength:
            return False
        if status[i] == STICKS and friction[i] < GLUE:
            across = np.sqrt(max(0.0, dot(force[i], force[i]) - p**2))
            if across > friction[i] * p + ROUNDING * strength:
                return False
        if status[i] == SLIDES and dot(residual[i], slide[i]) < -ROUNDING * depth:
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

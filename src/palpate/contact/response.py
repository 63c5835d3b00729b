"""Kernels: response of the touching nodes, updated node by node as contact grows and shrinks.

The kernels of contact work on tools as arrays, `ToolArrays`, and on what is known of every node,
`Nodal`. Vectors are in the object's frame unless said otherwise. A force is that of the tool on the
node. `compliance` is (3 n, 3 n) and symmetric, so that what a force does is read from a row.

For a node without friction the response gives the displacement that follows from its force, for a
node that may stick the force that follows from its displacement, so that only sliding nodes leave
unknowns in the equations of contact. A node that comes in is appended, and pivoted if it may stick;
one that leaves is pivoted back and dropped. No matrix of all nodes is ever factorised.

Rounding adds up with every node that comes in or leaves, by the square of the condition number of
the compliance. So after `REBUILT_AFTER` changes the response is built anew from the compliance of
the touching nodes. Measured over 100 000 changes of the rim of a contact of 20 to 40 nodes, against
a fresh response and relative to its largest entry: 1e-13 at a condition number of 50 and 2e-9 at
5000 if it is never built anew; 5e-15 and 1.4e-10 if it is, and below 1e-9 up to 10 000.

Source
------
James and Pai, ArtDefo: accurate real time deformable objects, SIGGRAPH (1999), section 4: the
capacitance matrix. Tsatsomeros, Principal pivot transforms, Linear Algebra Appl. 307 (2000) 151.
"""

from typing import NamedTuple

import numba
import numpy as np

# Nodes that come in or leave until the response is built anew: a fraction of a millisecond then.
REBUILT_AFTER = 500
# States of a node.
OPEN, SLIDES, STICKS = 0, 1, 2
# What is given of a node in the response.
ABSENT, BY_FORCE, BY_DISPLACEMENT = 0, 1, 2
# Kinds of tools: a ball, one that is round about its axis, and one of planes.
SPHERE, ROUND, FACES = 0, 1, 2
# Of the largest force: what is less than nothing by so little is nothing.
ROUNDING = 1e-12
# Coefficients of friction from which on nothing slides.
NO_SLIP = 1e9


@numba.njit(cache=True, error_model="numpy")
def updated_response(response, changes, compliance, tools, nodal):
    """The response of the nodes that touch now; brings `nodal.given` up to date, too.

    Also returns `changes`, the number of nodes that came in or left since it was built anew.
    """
    wanted, before_now = np.empty_like(nodal.given), changes
    for i in range(wanted.size):
        t = nodal.tool_of[i]
        wanted[i] = ABSENT if t < 0 else BY_DISPLACEMENT if tools.friction[t] > 0.0 else BY_FORCE
        changes += wanted[i] != nodal.given[i]
    if changes == before_now:
        return response, changes
    before, nodes = np.flatnonzero(nodal.given), np.flatnonzero(wanted)
    if changes > REBUILT_AFTER:
        assign(wanted, nodal.given)
        return fresh_response(compliance, nodes, wanted), 0
    pivoted, out = response.copy(), np.zeros((3 * nodes.size, 3 * nodes.size))
    row_of = np.full(wanted.size, -1)
    for j in range(before.size):
        i = before[j]
        if wanted[i] == nodal.given[i]:
            row_of[i] = j
        elif nodal.given[i] == BY_DISPLACEMENT:
            pivot(pivoted, j)
    for h in range(nodes.size):
        for g in range(nodes.size):
            j, i = row_of[nodes[h]], row_of[nodes[g]]
            if j >= 0 and i >= 0:
                for a in range(3):
                    for b in range(3):
                        out[3 * h + a, 3 * g + b] = pivoted[3 * j + a, 3 * i + b]
    for h in range(nodes.size):
        if row_of[nodes[h]] < 0:
            append(out, h, compliance, nodes, wanted, row_of)
            row_of[nodes[h]] = h
            if wanted[nodes[h]] == BY_DISPLACEMENT:
                pivot(out, h)
    assign(wanted, nodal.given)
    return out, changes


@numba.njit(cache=True, error_model="numpy")
def fresh_response(compliance, nodes, given):
    """The response of some nodes from their compliance alone."""
    out = gather(compliance, nodes, nodes)
    for j in range(nodes.size):
        if given[nodes[j]] == BY_DISPLACEMENT:
            pivot(out, j)
    return out


@numba.njit(cache=True, error_model="numpy")
def append(response, h, compliance, nodes, given, row_of):
    """Append one node, its force given; `row_of` is negative for nodes that are not in yet."""
    force, column = np.empty(3), np.empty(3 * nodes.size)
    for a in range(3):
        # Compliance is symmetric, and the response is so up to signs: a column is a row.
        by_force = compliance[3 * nodes[h] + a]
        column[:] = 0.0
        for g in range(nodes.size):
            if row_of[nodes[g]] >= 0 and given[nodes[g]] == BY_DISPLACEMENT:
                for b in range(3):
                    force[b] = by_force[3 * nodes[g] + b]
                add_columns(response, g, force, column)
        for b in range(3):
            column[3 * h + b] = by_force[3 * nodes[h] + b]
        for g in range(nodes.size):
            if g == h or row_of[nodes[g]] < 0:
                continue
            sign = -1.0 if given[nodes[g]] == BY_DISPLACEMENT else 1.0
            for b in range(3):
                displacement = by_force[3 * nodes[g] + b]
                column[3 * g + b] *= sign
                if sign > 0.0:
                    column[3 * g + b] += displacement
                response[3 * h + a, 3 * g + b] = sign * column[3 * g + b]
                response[3 * g + b, 3 * h + a] = column[3 * g + b]
        for b in range(3):
            response[3 * h + a, 3 * h + b] = column[3 * h + b]
    # Its own compliance, less what nodes of given displacement hold back.
    for a in range(3):
        for b in range(3):
            for g in range(nodes.size):
                if row_of[nodes[g]] >= 0 and given[nodes[g]] == BY_DISPLACEMENT:
                    for c in range(3):
                        constrained = compliance[3 * nodes[h] + a, 3 * nodes[g] + c]
                        response[3 * h + a, 3 * h + b] += (
                            constrained * response[3 * g + c, 3 * h + b]
                        )


@numba.njit(cache=True, error_model="numpy")
def pivot(response, j):
    """Exchange force and displacement of one node as given and found; its own inverse."""
    diagonal, inverse, f = np.empty((3, 3)), np.empty((3, 3)), 3 * j
    for a in range(3):
        for b in range(3):
            diagonal[a, b] = response[f + a, f + b]
    invert(diagonal, inverse)
    rows = np.zeros((3, len(response)))
    for a in range(3):
        for b in range(3):
            factor, source = -inverse[a, b], response[f + b]
            for i in range(source.size):
                rows[a, i] += factor * source[i]
        for b in range(3):
            rows[a, f + b] = 0.0
    first, second, third = rows[0], rows[1], rows[2]
    for h in range(len(response)):
        row = response[h]
        x, y, z = row[f], row[f + 1], row[f + 2]
        for i in range(row.size):
            row[i] += x * first[i] + y * second[i] + z * third[i]
        for b in range(3):
            row[f + b] = x * inverse[0, b] + y * inverse[1, b] + z * inverse[2, b]
    for a in range(3):
        assign(rows[a], response[f + a])
        for b in range(3):
            response[f + a, f + b] = inverse[a, b]


@numba.njit(cache=True, error_model="numpy")
def dot(x, y):
    """Scalar product of two vectors."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@numba.njit(cache=True, error_model="numpy")
def assign(values, out):
    """Copy an array into one of its shape, both contiguous; `out[:] = values` takes seconds to
    compile."""
    source, target = values.reshape(-1), out.reshape(-1)
    for i in range(target.size):
        target[i] = source[i]


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
def component(frames, i, a, vectors):
    """Component of a node's vector along one of its unit vectors, without a view of either."""
    return (
        frames[i, a, 0] * vectors[i, 0]
        + frames[i, a, 1] * vectors[i, 1]
        + frames[i, a, 2] * vectors[i, 2]
    )


@numba.njit(cache=True, error_model="numpy")
def invert(matrix, out):
    """The inverse of a (3, 3) matrix, by its minors."""
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        for d in range(3):
            e, f = (d + 1) % 3, (d + 2) % 3
            out[d, a] = matrix[b, e] * matrix[c, f] - matrix[b, f] * matrix[c, e]
    determinant = matrix[0, 0] * out[0, 0] + matrix[0, 1] * out[1, 0] + matrix[0, 2] * out[2, 0]
    for a in range(3):
        for d in range(3):
            out[a, d] /= determinant


@numba.njit(cache=True, error_model="numpy")
def solve(matrix, right):
    """Solve a square system in place, by elimination with partial pivoting: the matrix is lost, the
    solution is in `right`. Returns False where the matrix is singular."""
    n = right.size
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[best, k]):
                best = i
        pivot_row, first = matrix[k], matrix[best]
        if not abs(first[k]) > 0.0:
            return False
        for j in range(k, n):
            pivot_row[j], first[j] = first[j], pivot_row[j]
        right[k], right[best] = right[best], right[k]
        for i in range(k + 1, n):
            row, factor = matrix[i], matrix[i, k] / pivot_row[k]
            for j in range(k + 1, n):
                row[j] -= factor * pivot_row[j]
            right[i] -= factor * right[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            right[k] -= matrix[k, j] * right[j]
        right[k] /= matrix[k, k]
    return True


@numba.njit(cache=True, error_model="numpy")
def displace(block, nodes, force, near, out):
    """Displacement of the near nodes under the forces on others; out is (n, 3).

    block is what `gather` makes of both.
    """
    total = np.zeros(3 * near.size)
    for j in range(nodes.size):
        for b in range(3):
            f, row = force[nodes[j], b], block[3 * j + b]
            for i in range(total.size):
                total[i] += f * row[i]
    for j in range(near.size):
        for a in range(3):
            out[near[j], a] = total[3 * j + a]


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
def add_columns(block, i, force, out):
    """Add what a force on one node does to all of them; out is flat, (3 n,)."""
    x, y, z = force[0], force[1], force[2]
    first, second, third = block[3 * i], block[3 * i + 1], block[3 * i + 2]
    for j in range(out.size):
        out[j] += x * first[j] + y * second[j] + z * third[j]


@numba.njit(cache=True, error_model="numpy")
def gather(compliance, rows, columns):
    """What forces on some nodes, by rows, do to others."""
    block = np.empty((3 * rows.size, 3 * columns.size))
    for i in range(rows.size):
        for a in range(3):
            source, target = compliance[3 * rows[i] + a], block[3 * i + a]
            for j in range(columns.size):
                for b in range(3):
                    target[3 * j + b] = source[3 * columns[j] + b]
    return block


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


class Nodal(NamedTuple):
    """What is known of all n nodes; the kernels change it in place.

    Attributes
    ----------
    force, displacement : (n, 3) float [N], [m]
    tool_of, face, status, given : (n,) int         as in `ContactState`
    anchor, normal, slide : (n, 3) float
    gap : (n,) float [m]
    """

    force: np.ndarray
    displacement: np.ndarray
    tool_of: np.ndarray
    face: np.ndarray
    status: np.ndarray
    given: np.ndarray
    anchor: np.ndarray
    normal: np.ndarray
    slide: np.ndarray
    gap: np.ndarray


class ToolArrays(NamedTuple):
    """Tools as the kernels see them; `faces` are those of all tools, one after the other.

    Attributes
    ----------
    kind, start : (t,), (t + 1,) int
    radius, reach : (t,) float [m]      of the sphere; of a ball about the position that holds the
                                        tool
    faces : (p, 4) float                as of `Tool`
    friction : (t,) float               coefficient; 0 slides freely, infinite sticks
    position, rotation : (t, 3), (t, 3, 3)   pose; a point y of the tool is at position + rotation y
    previous_position, previous_rotation    the pose at the tick before
    """

    kind: np.ndarray
    start: np.ndarray
    radius: np.ndarray
    reach: np.ndarray
    faces: np.ndarray
    friction: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    previous_position: np.ndarray
    previous_rotation: np.ndarray

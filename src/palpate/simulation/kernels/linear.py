"""Small linear algebra without a call of a library, and sums over Green's functions.

`compliance` is (3 n, 3 n) and symmetric, so that what a force does is read from a row.
"""

import numba
import numpy as np


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

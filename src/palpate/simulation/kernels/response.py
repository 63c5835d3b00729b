"""Response of the touching nodes, updated node by node as contact grows and shrinks.

For a node without friction it gives the displacement that follows from its force, for a node that
may stick the force that follows from its displacement, so that only sliding nodes leave unknowns in
the equations of contact. A node that comes in is appended, and pivoted if it may stick; one that
leaves is pivoted back and dropped. No matrix of all nodes is ever factorised.

Source
------
James and Pai, ArtDefo: accurate real time deformable objects, SIGGRAPH (1999), section 4: the
capacitance matrix. Tsatsomeros, Principal pivot transforms, Linear Algebra Appl. 307 (2000) 151.
"""

import numba
import numpy as np

from palpate.simulation.kernels.linear import add_columns, invert
from palpate.simulation.kernels.state import ABSENT, BY_DISPLACEMENT, BY_FORCE


@numba.njit(cache=True, error_model="numpy")
def up_to_date(response, compliance, tools, nodal):
    """The response of the nodes that touch now; brings `nodal.given` up to date, too."""
    wanted, same = np.empty_like(nodal.given), True
    for i in range(wanted.size):
        t = nodal.tool_of[i]
        wanted[i] = ABSENT if t < 0 else BY_DISPLACEMENT if tools.friction[t] > 0.0 else BY_FORCE
        same = same and wanted[i] == nodal.given[i]
    if same:
        return response
    before, nodes = np.flatnonzero(nodal.given), np.flatnonzero(wanted)
    kept, out = response.copy(), np.zeros((3 * nodes.size, 3 * nodes.size))
    of = np.full(wanted.size, -1)
    for j in range(before.size):
        i = before[j]
        if wanted[i] == nodal.given[i]:
            of[i] = j
        elif nodal.given[i] == BY_DISPLACEMENT:
            pivot(kept, j)
    for h in range(nodes.size):
        for g in range(nodes.size):
            j, i = of[nodes[h]], of[nodes[g]]
            if j >= 0 and i >= 0:
                for a in range(3):
                    for b in range(3):
                        out[3 * h + a, 3 * g + b] = kept[3 * j + a, 3 * i + b]
    for h in range(nodes.size):
        if of[nodes[h]] < 0:
            append(out, h, compliance, nodes, wanted, of)
            of[nodes[h]] = h
            if wanted[nodes[h]] == BY_DISPLACEMENT:
                pivot(out, h)
    nodal.given[:] = wanted
    return out


@numba.njit(cache=True, error_model="numpy")
def append(response, h, compliance, nodes, given, of):
    """Append one node, its force given; `of` is negative for nodes that are not in yet."""
    force, column = np.empty(3), np.empty(3 * nodes.size)
    for a in range(3):
        # Compliance is symmetric, and the response is so up to signs: a column is a row.
        by_force = compliance[3 * nodes[h] + a]
        column[:] = 0.0
        for g in range(nodes.size):
            if of[nodes[g]] >= 0 and given[nodes[g]] == BY_DISPLACEMENT:
                force[:] = by_force[3 * nodes[g] : 3 * nodes[g] + 3]
                add_columns(response, g, force, column)
        for b in range(3):
            column[3 * h + b] = by_force[3 * nodes[h] + b]
        for g in range(nodes.size):
            if g == h or of[nodes[g]] < 0:
                continue
            sign = -1.0 if given[nodes[g]] == BY_DISPLACEMENT else 1.0
            for b in range(3):
                moved = by_force[3 * nodes[g] + b]
                column[3 * g + b] *= sign
                if sign > 0.0:
                    column[3 * g + b] += moved
                response[3 * h + a, 3 * g + b] = sign * column[3 * g + b]
                response[3 * g + b, 3 * h + a] = column[3 * g + b]
        response[3 * h + a, 3 * h : 3 * h + 3] = column[3 * h : 3 * h + 3]
    # Its own compliance, less what nodes of given displacement hold back.
    for a in range(3):
        for b in range(3):
            for g in range(nodes.size):
                if of[nodes[g]] >= 0 and given[nodes[g]] == BY_DISPLACEMENT:
                    for c in range(3):
                        held = compliance[3 * nodes[h] + a, 3 * nodes[g] + c]
                        response[3 * h + a, 3 * h + b] += held * response[3 * g + c, 3 * h + b]


@numba.njit(cache=True, error_model="numpy")
def pivot(response, j):
    """Exchange force and displacement of one node as given and found; its own inverse."""
    own, inverse, f = np.empty((3, 3)), np.empty((3, 3)), 3 * j
    own[:] = response[f : f + 3, f : f + 3]
    invert(own, inverse)
    rows = -inverse @ response[f : f + 3]
    rows[:, f : f + 3] = 0.0
    first, second, third = rows[0], rows[1], rows[2]
    for h in range(len(response)):
        row = response[h]
        x, y, z = row[f], row[f + 1], row[f + 2]
        for i in range(row.size):
            row[i] += x * first[i] + y * second[i] + z * third[i]
        for b in range(3):
            row[f + b] = x * inverse[0, b] + y * inverse[1, b] + z * inverse[2, b]
    response[f : f + 3] = rows
    response[f : f + 3, f : f + 3] = inverse

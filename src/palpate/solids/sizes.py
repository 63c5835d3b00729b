"""How many nodes a solid gets and what memory it takes, before it is made.

The constants were measured on cubes of 10 to 30 edges along each side, 14 000 to 340 000 nodes, and
for factors of 7 000 to 60 000 nodes; tests/ground/test_machine.py measures one again.
"""

import numpy as np

from palpate.geometry import TriangleMesh, enclosed_volume
from palpate.machine import check_memory_for, usable_memory

# Nodes per cube of the edge, and memory for each while the solid is filled [bytes].
_NODES_PER_CUBE, _BYTES_PER_NODE = 12.5, 1400.0
# Memory of a factor over the number of nodes to the power 4/3, which nested dissection has [bytes].
_BYTES_OF_FACTOR = 2000.0


def node_count(mesh: TriangleMesh, edge: float) -> float:
    """About how many nodes `make_solid` makes; refined regions add a few thousand each.

    Parameters
    ----------
    mesh : TriangleMesh             closed
    edge : float [m]                > 0
    """
    return float(_NODES_PER_CUBE * abs(enclosed_volume(mesh)) / edge**3)


def solid_memory(nodes: float) -> float:
    """Peak memory of `make_solid` [bytes].

    Parameters
    ----------
    nodes : float                   number of nodes, see `node_count`
    """
    return _BYTES_PER_NODE * nodes


def body_memory(nodes: float) -> float:
    """Peak memory of `make_body` [bytes].

    Parameters
    ----------
    nodes : float                   number of nodes, see `node_count`
    """
    return float(_BYTES_OF_FACTOR * nodes ** (4.0 / 3.0))


def check_solid_size(mesh: TriangleMesh, edge: float) -> None:
    """Refuse elements that are too many for the memory, before anything is computed.

    Parameters
    ----------
    mesh : TriangleMesh             closed
    edge : float [m]                > 0, as in `make_solid`

    Raises
    ------
    InputError                      `make_solid` would take more than the machine has
    """
    count = node_count(mesh, edge)
    needed = solid_memory(count)
    # As much longer as rounding may shorten it.
    least = 1.05 * edge * np.cbrt(needed / usable_memory())
    check_memory_for(
        f"tetrahedra with an edge of {1e3 * edge:.3g} mm have some {count:.2g} nodes, which",
        needed,
        f"use an edge of {1e3 * least:.2g} mm or more",
    )

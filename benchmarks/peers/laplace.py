"""Times of bempp-cl's scalar Laplace operators; runs in its own environment, without palpate.

    benchmarks/peers/.venv/bin/python benchmarks/peers/laplace.py mesh.npz REPEATS

The mesh file holds `vertices` (n, 3) and `triangles` (m, 3). Prints one JSON object.
"""

import json
import sys
import time
from importlib.metadata import version

import bempp_cl.api
import numpy as np
from bempp_cl.api.operators.boundary import laplace


def timed(make, repeats: int) -> float:
    """Shortest wall time [s] of a dense assembly, after one that compiles."""
    seconds = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        make().weak_form().to_dense()
        seconds.append(time.perf_counter() - start)
    return min(seconds[1:])


def main() -> None:
    """Assemble both operators with continuous linear functions, Galerkin, as bempp-cl does."""
    path, repeats = sys.argv[1], int(sys.argv[2])
    mesh = np.load(path)
    grid = bempp_cl.api.Grid(mesh["vertices"].T, mesh["triangles"].T.astype(np.uint32))
    space = bempp_cl.api.function_space(grid, "P", 1)
    kind = {"assembler": "dense", "device_interface": "numba"}
    seconds = {"version": version("bempp-cl")}
    for name in ("single_layer", "double_layer"):
        operator = getattr(laplace, name)
        seconds[name] = timed(lambda op=operator: op(space, space, space, **kind), repeats)
    print(json.dumps(seconds))


if __name__ == "__main__":
    main()

"""bempp-cl's times for the scalar Laplace operators."""

import json
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.peers.environment import Environment, last_line, run_command
from palpate.geometry import TriangleMesh

HERE = Path(__file__).resolve().parent


def laplace_times(mesh: TriangleMesh, *, repeats: int, make: bool) -> dict | str:
    """bempp-cl's times for the scalar Laplace operators on a mesh.

    Parameters
    ----------
    mesh : TriangleMesh
    repeats : int             the shortest counts
    make : bool               whether a missing environment may be made

    Returns
    -------
    dict or str               `version`, `single_layer` [s], `double_layer` [s]; or why not
    """
    environment = Environment(HERE, "bempp-cl")
    if problem := environment.problem(make=make):
        return problem
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.npz"
        np.savez(path, vertices=mesh.vertices, triangles=mesh.triangles)
        script = str(HERE / "laplace.py")
        done = run_command([str(environment.python), script, str(path), str(repeats)])
    if done.returncode:
        return f"bempp-cl stopped: {last_line(done.stderr)}"
    return json.loads(done.stdout.splitlines()[-1])

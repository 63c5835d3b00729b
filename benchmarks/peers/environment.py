"""Makes the other programs' environment and runs them in it."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from palpate.geometry import TriangleMesh

__all__ = ["laplace_times"]

HERE = Path(__file__).resolve().parent
ENVIRONMENT = HERE / ".venv"
PYTHON = ENVIRONMENT / "bin" / "python"


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
    if not PYTHON.exists():
        if not make:
            return "not measured: run with --peers to make bempp-cl's environment"
        problem = _make_environment()
        if problem:
            return problem
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.npz"
        np.savez(path, vertices=mesh.vertices, triangles=mesh.triangles)
        done = _run([str(PYTHON), str(HERE / "laplace.py"), str(path), str(repeats)])
    if done.returncode:
        return f"bempp-cl stopped: {_last_line(done.stderr)}"
    return json.loads(done.stdout.splitlines()[-1])


def _make_environment() -> str:
    """Install what requirements.txt pins; empty, or what went wrong."""
    for command in (
        [sys.executable, "-m", "venv", str(ENVIRONMENT)],
        [str(PYTHON), "-m", "pip", "install", "--quiet", "-r", str(HERE / "requirements.txt")],
    ):
        done = _run(command)
        if done.returncode:
            PYTHON.unlink(missing_ok=True)
            return f"bempp-cl could not be installed: {_last_line(done.stderr)}"
    return ""


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False)


def _last_line(text: str) -> str:
    return (text.strip().splitlines() or ["no message"])[-1]

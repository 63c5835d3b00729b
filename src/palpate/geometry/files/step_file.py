"""Solids in STEP files (ISO 10303-21), as CAD programs write them, converted to triangles."""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from palpate.errors import MeshError
from palpate.optional_imports import late_import
from palpate.shapes import Triangles, Vertices

STEP_SUFFIXES = (".step", ".stp")
# Deflection of the triangles from the surface, relative to its edges, and angle between adjacent
# ones [rad]: a ball gets 20,000 triangles, and loses 0.1 % of its volume.
_OFF, _TURN = 5e-4, 0.3
# A part of thousands of faces takes seconds.
_MOST_SECONDS = 300
# In a process of its own: OpenCASCADE may crash on a damaged file, and prints to the terminal. With
# -P, or a cascadio.py in the current folder would be run; -I would lose the user's own packages.
_CONVERT = """\
import sys, cascadio
source, target, off, turn = sys.argv[1:]
sys.exit(cascadio.step_to_glb(source, target, float(off), float(turn), tol_relative=True))
"""


def read_step(path: Path) -> tuple[Vertices, Triangles]:
    """Vertices [m] and triangles of all solids of a STEP file, which states its own unit.

    Adjacent faces have separate, coinciding vertices along their common edge.

    Parameters
    ----------
    path : Path

    Returns
    -------
    vertices : (v, 3) float [m]
    triangles : (m, 3) int

    Raises
    ------
    InputError                      the optional package is missing
    MeshError                       the file holds no solid, is damaged, or takes over 300 s
    """
    late_import("cascadio", extra="cad", purpose=f"reading {path.name}")
    trimesh = late_import("trimesh", extra=None, purpose=f"reading {path.name}")
    with TemporaryDirectory() as scratch:
        target = Path(scratch) / "solid.glb"
        numbers = (str(path.resolve()), str(target), str(_OFF), str(_TURN))
        try:
            done = subprocess.run(
                [sys.executable, "-P", "-c", _CONVERT, *numbers],
                capture_output=True, timeout=_MOST_SECONDS, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired as error:
            raise MeshError(
                f"{path}: covering it with triangles takes more than {_MOST_SECONDS} s; leave out"
                " of the drawing what is not the object, or export an STL"
            ) from error
        # glTF is in metres by definition.
        read = done.returncode == 0 and target.exists()
        drawn = trimesh.load(target, force="mesh", process=False) if read else None
    if drawn is None or len(drawn.faces) == 0:
        raise MeshError(
            f"{path}: no solid can be read of this STEP file; open it in a drawing program, check"
            " that it is there, and export it again (STEP AP214 or AP242), or as an STL"
        )
    return np.array(drawn.vertices, dtype=np.float64), np.array(drawn.faces, dtype=np.int64)

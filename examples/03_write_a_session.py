"""Write a session folder by hand: mesh, support, one probing, one table of displacements.

python examples/03_write_a_session.py

A body of your own in such a folder, fitted: docs/notebooks/own_mesh.py.
"""

import tempfile
from pathlib import Path

import numpy as np

import palpate

SESSION = """\
format = "palpate-session/1"
name = "rubber eraser"

[object]
mesh = "mesh.ply"
length_unit = "mm"

[support]
plane = { point = [0, 0, 0], normal = [0, 0, 1], tolerance = 0.01 }

[[probe]]
name = "top"
contact = { point = [20, 10, 12], radius = 4, profile = "smooth" }
force = [0, 0, -1.5]        # N, on the object: a push downward is -z
force_std = 0.015
displacement = "top.csv"
"""
# Lengths in mm: where the points lie at rest, and how far they moved. nan: looked at, not found.
TABLE = """\
x,y,z,ux,uy,uz
14,10,12,0.021,0.000,-0.110
26,10,12,-0.020,0.001,-0.112
20,4,12,0.000,0.019,-0.108
20,16,12,nan,nan,nan
"""


def block(size: tuple[float, float, float]) -> palpate.TriangleMesh:
    """A block from the origin to `size`: eight corners, twelve triangles seen from outside."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * size
    faces = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    halves = [half for a, b, c, d in faces for half in ((a, b, c), (a, c, d))]
    return palpate.TriangleMesh(corners, np.array(halves))


def main() -> int:
    """Write the folder and read it back; gives the number of points that were measured."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        palpate.write_mesh(folder / "mesh.ply", block((40.0, 20.0, 12.0)))
        (folder / "session.toml").write_text(SESSION, encoding="utf-8")
        (folder / "top.csv").write_text(TABLE, encoding="utf-8")
        session = palpate.read_session(folder)
    print(f"{session.name}: {len(session.held_triangles)} triangles held")
    measured = np.isfinite(session.probings[0].displacement.displacement).all(axis=1)
    print(f"{measured.sum()} of {len(measured)} points measured")
    for note in session.notes:
        print(f"note: {note}")
    return int(measured.sum())


if __name__ == "__main__":
    main()

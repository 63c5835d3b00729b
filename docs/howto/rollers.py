"""A block between two plates, glued to them and sliding on them: the picture of tension.md.

python docs/howto/rollers.py      # a minute; writes docs/images/rollers.png
"""

from pathlib import Path

import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from palpate.bem import (
    boundary_system,
    factorise,
    integral_weights,
    make_surface,
    solve,
    support_columns,
)
from palpate.figures.style import BLUE, GREY, INK, ORANGE, save_figure, styled
from palpate.geometry import TriangleMesh, welded

SIZE = np.array([0.04, 0.04, 0.03])
SHEAR, NU, DOWN = 1e4, 0.45, 1e-3
YOUNG = 2 * SHEAR * (1 + NU)
FACTOR = 3.0
PICTURE = Path(__file__).parents[1] / "images" / "rollers.png"


def block() -> TriangleMesh:
    """Its surface, every face of 8 x 8 squares cut in two."""
    body = trimesh.creation.box(extents=SIZE)
    for _ in range(3):
        body = body.subdivide()
    return welded(TriangleMesh(body.vertices + 0.5 * SIZE, body.faces))


def pressed(mesh: TriangleMesh, directions: np.ndarray) -> tuple[np.ndarray, float]:
    """Displacement of every vertex [m] and the force [N], the upper plate moving down."""
    height = mesh.vertices[mesh.triangles][:, :, 2]
    ends = np.flatnonzero((np.ptp(height, axis=1) < 1e-9) & (abs(height[:, 0] - 0.015) > 0.0149))
    projector = directions.T @ directions
    surface = make_surface(mesh, ends, directions=np.tile(projector, (ends.size, 1, 1)))
    system = boundary_system(surface)
    plates = np.zeros_like(mesh.vertices)
    plates[mesh.vertices[:, 2] > 0.0299, 2] = -DOWN
    x = solve(factorise(system, NU), support_columns(system, plates).at(NU))[:, 0]
    unknowns, count = system.unknowns, 3 * system.unknowns.free_vertices.size
    moved = plates.copy()
    moved[unknowns.free_vertices] += x[:count].reshape(-1, 3)
    traction = x[count:-3].reshape(-1, 3) * SHEAR / system.traction_length
    upper = ends[mesh.vertices[mesh.triangles[ends], 2].mean(axis=1) > 0.015]
    weights = integral_weights(surface, upper)[unknowns.held_sides]
    return moved, -float(weights @ traction[:, 2])


def draw(axes: Axes, mesh: TriangleMesh, moved: np.ndarray, colour: str, title: str) -> None:
    """The face toward the reader, at rest and pressed, the motion drawn larger."""
    front = mesh.triangles[(mesh.vertices[mesh.triangles][:, :, 1] < 1e-9).all(axis=1)]
    edges = np.unique(np.sort(front[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    # The squares, without the diagonals that cut them.
    along = np.abs(np.subtract(*mesh.vertices[edges].transpose(1, 0, 2)))
    edges = edges[np.minimum(along[:, 0], along[:, 2]) < 1e-9]
    for factor, shade, width in ((0.0, GREY, 0.4), (FACTOR, colour, 0.9)):
        position = 1e3 * (mesh.vertices + factor * moved)[:, [0, 2]]
        axes.add_collection(LineCollection(list(position[edges]), colors=shade, linewidths=width))
    for z in (0.0, 30.0 - 1e3 * FACTOR * DOWN):
        axes.axhline(z, color=INK, linewidth=1.5)
    axes.set(aspect="equal", title=title, xlabel="mm", xlim=(-8, 48), ylim=(-3, 33))


@styled
def main() -> None:
    """Compute both, print the forces, write the picture."""
    mesh = block()
    figure = Figure(figsize=(7.0, 2.9), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    exact = YOUNG * SIZE[0] * SIZE[1] * DOWN / SIZE[2]
    for axes, colour, name, directions in (
        (panels[0], ORANGE, "glued", np.eye(3)),
        (panels[1], BLUE, "on rollers", np.array([[0.0, 0.0, 1.0]])),
    ):
        moved, force = pressed(mesh, directions)
        print(f"{name}: {force:.4f} N; E A u / h is {exact:.4f} N")
        draw(axes, mesh, moved, colour, f"{name}: {force:.2f} N")
    panels[0].set_ylabel("mm")
    save_figure(figure, PICTURE)


if __name__ == "__main__":
    main()

"""A ball pressed into the half ball and dragged over it: the pictures of simulate.md and export.md.

python docs/howto/touch.py      # a minute; writes docs/images/simulate.png and export.png
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from palpate.contact import PlacedTool
from palpate.figures.displacement import make_view, projected
from palpate.figures.style import BLUE, GREY, INK, ORANGE, open_frame, save_figure, styled
from palpate.geometry import TriangleMesh
from palpate.records import Session, Sphere, read_session
from palpate.simulation import (
    GreenFunctions,
    Material,
    force_covariance,
    make_green_functions,
    nearest_nodes,
    start_contact,
    surface_displacement,
    touch,
)
from palpate.solids import make_solid

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
RADIUS, FRICTION, PRESS, DRAG = 0.012, 0.4, 2e-3, 6e-3
# What was measured by `python -m benchmarks.run --only replay`: off from Palpate [%].
REPLAYS = {"CalculiX": 0.25, "MuJoCo": 1.6}
VIEW = np.array([0.3, -1.0, 0.45])


def walk(green: GreenFunctions, top: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Way of the ball [mm], force on it with its deviation [N], displacement at the end."""
    ball, up = Sphere(RADIUS, friction=FRICTION), np.array([0.0, 0.0, 1.0])
    down = [top + (RADIUS - d) * up for d in np.linspace(0, PRESS, 100)]
    aside = [down[-1] + np.array([a, 0, 0]) for a in np.linspace(0, DRAG, 200)]
    state = start_contact(green, [PlacedTool(ball, top + (RADIUS + 1e-6) * up)])
    rows = []
    for position in down + aside:
        state = touch(green, [PlacedTool(ball, position)], state)
        sigma = np.sqrt(np.diag(force_covariance(green, state)[0]))
        rows.append([*state.tool_force[0], *sigma])
    step = np.linalg.norm(np.diff(down + aside, axis=0), axis=1)
    way = 1e3 * np.concatenate([[0.0], np.cumsum(step)])
    return way, np.array(rows), surface_displacement(green, state)


def draw_surface(axes: Axes, mesh: TriangleMesh, moved: np.ndarray, *, lines: bool = True) -> None:
    """The surface seen from the side, moved, coloured by how far."""
    view = make_view(TriangleMesh(mesh.vertices + moved, mesh.triangles), VIEW)
    where = 1e3 * projected(view, mesh.vertices + moved)[mesh.triangles][:, :, :2]
    (ax, ay), (bx, by) = (where[:, k].T - where[:, 0].T for k in (1, 2))
    normal = ax * by - ay * bx
    depth = (mesh.vertices[mesh.triangles].mean(axis=1)) @ VIEW
    order = np.argsort(depth)
    order = order[normal[order] > 0.0]
    size = 1e3 * np.linalg.norm(moved, axis=1)[mesh.triangles].mean(axis=1)
    patches = PolyCollection(
        list(where[order]), array=size[order], cmap="YlGnBu", edgecolors=GREY,
        linewidths=0.25 if lines else 0.1,
    )  # fmt: skip
    patches.set_clim(0.0, max(float(size.max()), 1e-9))
    axes.add_collection(patches)
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.axis("off")
    if moved.any():
        bar = axes.figure.colorbar(patches, ax=axes, fraction=0.035, pad=0.02)
        bar.set_label("displacement, mm")


@styled
def draw_touch(session: Session, green: GreenFunctions) -> Figure:
    """Force along the way, and the surface at its end."""
    top = session.probings[0].contact.point
    way, force, moved = walk(green, top)
    figure = Figure(figsize=(8.4, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    for row, name, colour in ((2, "against the press", BLUE), (0, "against the drag", ORANGE)):
        value = force[:, row] if row == 2 else -force[:, row]
        left.plot(way, value, color=colour, label=name)
        spread = 2 * force[:, 3 + row]
        left.fill_between(way, value - spread, value + spread, color=colour, alpha=0.25, lw=0)
    left.axvline(1e3 * PRESS, color=GREY, lw=0.6, ls=":")
    left.set_xlabel("way of the ball, mm: 2 mm in, then 6 mm aside")
    left.set_ylabel("force on the ball, N")
    left.legend(loc="center right", title="band: two standard deviations")
    open_frame(left)
    draw_surface(right, session.mesh, moved)
    view = make_view(session.mesh, VIEW)
    middle = projected(view, top + np.array([DRAG, 0.0, RADIUS - PRESS]))
    right.add_patch(Circle(1e3 * middle[:2], 1e3 * RADIUS, fill=False, ec=INK, lw=0.8))
    right.autoscale_view()
    right.set_title("at the end: the ball, and the surface under it")
    return figure


@styled
def draw_export(mesh: TriangleMesh) -> Figure:
    """Outer faces of the linear tetrahedra, and what simulators made of the push."""
    figure = Figure(figsize=(8.4, 2.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.0))
    draw_surface(left, mesh, np.zeros_like(mesh.vertices), lines=False)
    left.set_title("56848 tetrahedra, finer under the push")
    names = list(REPLAYS)
    right.barh(names, [REPLAYS[name] for name in names], color=[BLUE, ORANGE], height=0.45)
    for name in names:
        right.text(REPLAYS[name] + 0.06, name, f"{REPLAYS[name]:g} %", va="center")
    right.axvline(5.0, color=INK, lw=0.8, ls="--")
    right.text(4.93, 1.42, "allowed", ha="right", va="center")
    right.set_xlim(0.0, 5.3)
    right.set_ylim(-0.5, 1.6)
    right.set_xlabel("displacement of the push's point, off from Palpate's, %")
    open_frame(right)
    return figure


def main() -> None:
    """Write both pictures."""
    session = read_session(ROOT / "examples" / "half_ball")
    material = Material(23.0e3, 0.302, np.array([[260.0**2, 0.0], [0.0, 0.0037**2]]))
    top = session.probings[0].contact.point
    nodes = nearest_nodes(session, top[None], 90)
    green = make_green_functions(session, material, nodes=nodes)
    save_figure(draw_touch(session, green), IMAGES / "simulate.png")
    save_figure(draw_export(solid_boundary(session)), IMAGES / "export.png")


def solid_boundary(session: Session) -> TriangleMesh:
    """Outer faces as `palpate export` makes them for the first probing."""
    contact = session.probings[0].contact
    radius = contact.radius or 0.0
    fine = [(contact.point, 1.2 * radius, radius / 2.5)]
    solid = make_solid(session.mesh, edge=4.25e-3, fine=fine)
    quarters = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
    return TriangleMesh(solid.nodes, solid.facets[:, quarters].reshape(-1, 3))


if __name__ == "__main__":
    main()

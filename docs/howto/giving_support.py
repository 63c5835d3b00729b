"""A block on a polished plate over a pad that gives: the figures and the picture of tension.md.

python docs/howto/giving_support.py      # half a minute; writes docs/images/giving_support.png
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from matplotlib.figure import Figure

from palpate.figures.style import BLUE, GREY, INK, ORANGE, save_figure, styled
from palpate.geometry import TriangleMesh, closest_points, welded
from palpate.pipeline import fit_session
from palpate.records import EXACT, Contact, DisplacementField, Probing, Session, Support

SIZE = np.array([0.02, 0.02, 0.03])
YOUNG, NU, FORCE, STIFFNESS, NOISE = 56e3, 0.4, 0.5, 5e6, 5e-6
AREA = SIZE[0] * SIZE[1]
TO_THE_LEFT = {"textcoords": "offset points", "ha": "right"}
PICTURE = Path(__file__).parents[1] / "images" / "giving_support.png"


def measured() -> Session:
    """The block pressed from above, its sides seen at 120 points in two probings."""
    body = trimesh.creation.box(extents=SIZE).subdivide().subdivide()
    mesh = welded(TriangleMesh(body.vertices + 0.5 * SIZE, body.faces))
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    bottom, top = (np.flatnonzero(abs(middle[:, 2] - z) < 1e-9) for z in (0.0, SIZE[2]))
    rng = np.random.default_rng(0)
    points = rng.uniform(0.05, 0.95, (120, 3)) * SIZE
    points[:60, 0], points[60:, 1] = 0.0, SIZE[1]
    probings = []
    for k in (1, 2):
        force = 0.5 * k * FORCE
        moved = (points - [0.01, 0.01, 0.0]) * [NU, NU, -1.0] * force / (AREA * YOUNG)
        moved[:, 2] -= force / (AREA * STIFFNESS)
        moved += NOISE * rng.standard_normal(moved.shape)
        std, surface = np.full_like(moved, NOISE), closest_points(mesh, points)
        field = DisplacementField(points, moved, std, None, surface, f"n{k}.csv")
        contact = Contact(middle[top].mean(axis=0), None, "uniform", top)
        press, sure = np.array([0.0, 0.0, -force]), np.full(3, 1e-6)
        probings.append(Probing(f"n{k}", contact, press, sure, None, None, field, None))
    support = Support(bottom, directions=np.array([[0.0, 0.0, 1.0]]))
    return Session(
        "block", Path("block"), mesh, bottom, tuple(probings), None, None, None, (),
        supports=(support,), errors=EXACT,
    )  # fmt: skip


@styled
def main() -> None:
    """Fit three ways, print the constants, draw what moved and the three moduli."""
    rigid = measured()
    given = replace(rigid, supports=(replace(rigid.supports[0], stiffness=STIFFNESS),))
    unknown = replace(rigid, errors=replace(EXACT, support_compliance=4e-7))
    figure = Figure(figsize=(7.0, 2.8), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    field = rigid.probings[1].displacement
    height, down = 1e3 * field.points[:, 2], -1e6 * field.displacement[:, 2]
    left.scatter(down, height, s=6, color=BLUE)
    left.annotate("measured", (690, 20.0), (6, -8), textcoords="offset points", color=BLUE)
    sunk = 1e6 * FORCE / (AREA * STIFFNESS)
    left.axvline(sunk, color=ORANGE, linewidth=1.2)
    left.annotate("pad gives", (sunk, 28.0), (-4, -4), **TO_THE_LEFT, color=ORANGE)
    ends = np.array([0.0, 1e3 * SIZE[2]])
    left.plot(1e3 * ends * FORCE / (AREA * YOUNG), ends, color=GREY, linewidth=1.0)
    left.annotate("on a rigid plate", (600, 27.0), (-6, 0), **TO_THE_LEFT, color=GREY)
    left.set(xlabel="down, µm", ylabel="height, mm", xlim=(0, None), ylim=(0, 30))
    ways = (("taken for rigid", rigid), ("prior", unknown), ("stiffness given", given))
    for k, (name, session) in enumerate(ways):
        estimate = fit_session(session).estimate
        young = estimate.young_modulus
        low, high = (1e-3 * end for end in young.ci95)
        print(f"{name}: E {1e-3 * young.value:.2f} kPa, {low:.2f} to {high:.2f}, {estimate.status}")
        for error in estimate.errors:
            if "compliance" in error.name:
                print(f"{error.name}: {1e9 * error.value:.1f} +- {1e9 * error.std:.1f} um/kPa")
        right.plot([low, high], [k, k], color=INK, linewidth=1.5)
        right.plot([1e-3 * young.value], [k], "o", color=INK, markersize=4)
    right.axvline(1e-3 * YOUNG, color=ORANGE, linewidth=1.2)
    right.annotate("true", (1e-3 * YOUNG, 0.5), (-4, 0), **TO_THE_LEFT, color=ORANGE)
    right.set(
        xlabel="E, kPa",
        xlim=(30, 60),
        ylim=(-0.6, 2.7),
        yticks=range(3),
        yticklabels=[x for x, _ in ways],
    )
    save_figure(figure, PICTURE)


if __name__ == "__main__":
    main()

"""A ball pressed into a half ball that sags under its weight, by CalculiX and by our elements.

    python -m benchmarks.press_on_sag

where `ccx` is installed. The half ball of `benchmarks.calculix_press` has a weight that moves its
side by 2.3 mm; the ball comes to where the skin went, in the direction that it would have without.
Ours has other elements, and the ball's force alone.
"""

from dataclasses import replace

import numpy as np

from benchmarks.calculix_press import (
    BALL,
    SHEAR_MODULUS,
    half,
    input_deck,
    pressed_body,
    run,
    session_mesh,
)
from palpate.records import Sphere
from palpate.shapes import Points, Vector3
from palpate.solids import (
    Body,
    Sag,
    Solid,
    SplitNeoHookean,
    Tip,
    make_body,
    make_solid,
    nodal_volumes,
    press_finite,
    solve_finite,
    surface_values,
)

# Weight per volume [N/m^3]; depths of the ball, and how far away it waits meanwhile [m].
WEIGHT = np.array([8e4, 0.0, -8e4])
DEPTHS, AWAY = (2e-3, 4e-3), 6e-3
# Of elements away from the ball, and under it [m].
EDGES = 9e-3, 2e-3
# The press at its side.
PRESS = 1


def deck(solid: Solid, carried: Vector3, depths: tuple[float, ...]) -> tuple[str, np.ndarray]:
    """CalculiX's input of the weight, then of the ball, whose axis is carried along by the skin
    [m]; and the nodes whose motion it prints."""
    body = pressed_body("half_ball")
    waits = replace(
        body, point=body.point + carried - AWAY * body.inward, depth=tuple(AWAY + d for d in depths)
    )
    text, shown = input_deck(solid, waits, PRESS)
    # 1000 kg/m^3 in t/mm^3; then the acceleration in mm/s^2 is the weight in N/m^3.
    density, size = "*DENSITY\n1e-9\n", float(np.linalg.norm(WEIGHT))
    text = text.replace("*MATERIAL, NAME=STEEL\n", f"{density}*MATERIAL, NAME=STEEL\n")
    head, *steps = text.replace("*SOLID SECTION", f"{density}*SOLID SECTION", 1).split("*STEP")
    weighed = [
        ", NLGEOM, INC=400", "*STATIC", "0.25, 1., 1e-5, 0.5", "*BOUNDARY", "MOVED, 1, 3, 0.",
        "*DLOAD", ", ".join(["SOLID, GRAV", *(f"{x:.12g}" for x in (size, *WEIGHT / size))]),
        "*NODE PRINT, NSET=SHOWN, FREQUENCY=1000", "U",
        "*NODE PRINT, NSET=MOVED, TOTALS=ONLY, FREQUENCY=1000", "RF", "*END STEP\n",
    ]  # fmt: skip
    return "*STEP".join([head, "\n".join(weighed), *steps]), shown


def by_calculix(seen: Points) -> tuple[list[Points], list[float]]:
    """Displacement of points under the weight, then under the ball, too, at each depth [m]; and the
    ball's force along its motion at these [N]."""
    body = pressed_body("half_ball")
    point, inward = body.point[PRESS], body.inward[PRESS]
    solid = make_solid(half(body.surface), edge=EDGES[0], fine=[(point, 8e-3, EDGES[1])])
    text, shown = deck(solid, np.zeros(3), ())
    (sag,), _ = run(text, shown, len(solid.nodes), 1)
    text, shown = deck(solid, (surface_values(solid, point[None]) @ sag)[0], DEPTHS)
    moved, forces = run(text, shown, len(solid.nodes), 1 + len(DEPTHS))
    # What is on the other side of the plane of symmetry moves as its mirror image.
    at = surface_values(solid, np.column_stack([seen[:, 0], np.abs(seen[:, 1]), seen[:, 2]]))
    mirrored = np.where(seen[:, 1:2] < 0.0, [1.0, -1.0, 1.0], 1.0)
    return [mirrored * (at @ nodal) for nodal in moved], [float(f @ inward) for f in forces[1:]]


def sagged(body: Body) -> Sag:
    """A body under the weight; slopes are not asked for."""
    weight = np.outer(nodal_volumes(body.solid), WEIGHT)
    moved = solve_finite(body, weight, law=SplitNeoHookean)
    return Sag(weight, moved, np.zeros((moved.size, 3)))


def main() -> None:
    """Print how far ours is off, of what the ball adds to the sag: with the weight, without it, and
    with the axis where it would be without."""
    pressed, seen = pressed_body("half_ball"), session_mesh("half_ball").vertices
    (sag, *truth), forces = by_calculix(seen)
    point, inward = pressed.point[PRESS], pressed.inward[PRESS]
    solid = make_solid(pressed.surface, edge=EDGES[0], fine=[(point, 8e-3, EDGES[1])])
    held = np.isclose(solid.nodes[:, 2], 0.0, atol=1e-9)
    body = make_body(solid, held, shear_modulus=SHEAR_MODULUS, poisson_ratio=pressed.poisson_ratio)
    sag_of_body, look, tip = (
        sagged(body),
        surface_values(solid, seen),
        Tip(Sphere(BALL), point, inward),
    )
    off = np.linalg.norm(look @ sag_of_body.displacement - sag) / np.linalg.norm(sag)
    print(f"sag of {1e3 * np.linalg.norm(sag, axis=1).max():.2f} mm at most: off by {off:.2%}")
    back = (surface_values(solid, point[None]) @ sag_of_body.displacement)[0]
    behind = replace(tip, point=point - back)
    for depth, force, both in zip(DEPTHS, forces, truth, strict=True):
        for name, ball, rest in (
            ("", tip, sag_of_body),
            (", weightless", tip, None),
            (", axis left behind", behind, sag_of_body),
        ):
            result = press_finite(body, ball, abs(force), law=SplitNeoHookean, sag=rest)
            before = 0.0 if rest is None else rest.displacement
            apart = look @ (result.displacement - before) - (both - sag)
            off = np.linalg.norm(apart) / np.linalg.norm(both - sag)
            own_depth = result.travel + BALL
            print(
                f"{force:.3f} N, {1e3 * depth:g} mm deep{name}: off by {off:.2%},"
                f" {1e3 * own_depth:.3f} mm deep"
            )


if __name__ == "__main__":
    main()

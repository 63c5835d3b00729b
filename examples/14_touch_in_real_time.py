"""A rigid ball pressed into a fitted object and dragged along it, as a haptic device would.

python examples/14_touch_in_real_time.py
"""

import time
from pathlib import Path

import numpy as np

from palpate.contact import PlacedTool
from palpate.records import Sphere, read_session
from palpate.simulation import (
    Material,
    force_covariance,
    make_green_functions,
    nearest_nodes,
    start_contact,
    touch,
)

HERE = Path(__file__).parent
RADIUS, FRICTION = 0.012, 0.4  # of the ball [m], of its surface


def main() -> float:
    """Press by 2 mm, drag by 3 mm; gives the force against the press at the end [N]."""
    session = read_session(HERE / "half_ball")
    # What a fit found: shear modulus and Poisson's ratio with their covariance.
    material = Material(23.1e3, 0.30, np.array([[300.0**2, 0.0], [0.0, 0.004**2]]))
    top = session.probings[0].contact.point
    green = make_green_functions(session, material, nodes=nearest_nodes(session, top[None], 60))
    ball = Sphere(RADIUS, friction=FRICTION)
    up = np.array([0.0, 0.0, 1.0])
    down = [top + (RADIUS - d) * up for d in np.linspace(0, 2e-3, 100)]
    aside = [down[-1] + [a, 0, 0] for a in np.linspace(0, 3e-3, 100)]
    state = start_contact(green, [PlacedTool(ball, top + (RADIUS + 1e-6) * up)])
    begin = 0.0
    for k, position in enumerate(down + aside):
        state = touch(green, [PlacedTool(ball, position)], state)
        if k == 0:
            begin = time.perf_counter()  # the first call compiles
        if k in (99, 124, 199):
            sigma = np.sqrt(np.diag(force_covariance(green, state)[0]))
            force = ", ".join(
                f"{f:6.3f} +- {s:.3f}" for f, s in zip(state.tool_force[0], sigma, strict=True)
            )
            print(f"{len(state.touching)} nodes, {len(state.sticking)} stick: ({force}) N")
    print(f"{199 / (time.perf_counter() - begin):.0f} ticks a second")
    return float(state.tool_force[0, 2])


if __name__ == "__main__":
    main()

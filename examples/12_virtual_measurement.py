"""A virtual measurement without pictures: press finite elements, read the sensors, fit.

python examples/12_virtual_measurement.py
"""

from pathlib import Path

import numpy as np

from palpate.geometry import closest_points
from palpate.lab import Sensor, half_ball
from palpate.pipeline import fit_session
from palpate.records import Contact, DisplacementField, Probing, Session, Sphere
from palpate.solids import TIPS, held_nodes, make_body, make_solid, press, surface_values

YOUNG_MODULUS, POISSON_RATIO = 52e3, 0.21  # truth
RADIUS, TIP_RADIUS, DEPTH = 0.04, 0.012, 0.0015  # m
SIGMA = 1e-5  # of each component of a displacement [m]


def main() -> tuple[float, float]:
    """Measure and fit; gives Young's modulus [Pa] and Poisson's ratio."""
    mesh = half_ball(radius=RADIUS, edge=0.005)
    held = np.flatnonzero((mesh.vertices[mesh.triangles][..., 2] < 1e-9).all(axis=1))
    pole = np.array([0.0, 0.0, RADIUS])
    # The specimen: quadratic finite elements, fine under the tip; its shape is the round one.
    solid = make_solid(mesh, edge=0.012, fine=[(pole, 0.003, 0.0015)])
    shear = 0.5 * YOUNG_MODULUS / (1 + POISSON_RATIO)
    nodes = held_nodes(solid, held)
    body = make_body(solid, nodes, shear_modulus=shear, poisson_ratio=POISSON_RATIO)
    ball = TIPS["sphere"](TIP_RADIUS, pole, np.array([0.0, 0.0, -1.0]))
    (pressed,) = press(body, ball, np.array([DEPTH]))

    rng, sensor = np.random.default_rng(5), Sensor(noise=0.002)
    height = mesh.vertices[:, 2]
    away = np.linalg.norm(mesh.vertices - pole, axis=1)
    points = mesh.vertices[(height > 0.005) & (away > 2 * pressed.radius)]
    moved = surface_values(solid, points) @ pressed.displacement
    moved += SIGMA * rng.standard_normal(moved.shape)
    std, surface = np.full(points.shape, SIGMA), closest_points(mesh, points)
    field = DisplacementField(points, moved, std, None, surface, "example")
    contact = Contact.under(Sphere(TIP_RADIUS), pole)
    force = sensor.read(pressed.force, rng=rng)
    sigma = np.full(3, sensor.std(pressed.force))
    probing = Probing("pole", contact, force, sigma, None, None, field, None)
    session = Session("virtual", Path("virtual"), mesh, held, (probing,), None, None, None, ())

    estimate = fit_session(session).estimate
    for name, truth in (("young_modulus", YOUNG_MODULUS), ("poisson_ratio", POISSON_RATIO)):
        constant = getattr(estimate, name)
        low, high = constant.ci95
        print(f"{name}: truth {truth:g}, found {constant.value:.5g} ({low:.5g} to {high:.5g})")
    return estimate.young_modulus.value, estimate.poisson_ratio.value


if __name__ == "__main__":
    main()

"""Discs on a half space against Boussinesq, Cerruti, Hertz and the uniform disc."""

import numpy as np
import pytest
from scipy.special import ellipe

from palpate.bem import PressureDisc
from palpate.bem.loads.half_space import chord_integrals, disc_displacement, disc_potentials
from palpate.records.contact import PRESSURES

RADIUS = 0.02
CENTRE = np.array([0.1, -0.2, 0.3])
NORMAL = np.array([1.0, 2.0, 2.0]) / 3
PROFILES = {
    "uniform": np.ones_like,
    "hertz": lambda s: np.sqrt(np.clip(1 - s**2, 0, None)),
    "smooth": lambda s: np.clip(1 - s**2, 0, None) ** 2,
    "flat": PRESSURES["flat"],
    "cone": PRESSURES["cone"],
}


def plane_axes():
    e1 = np.array([2.0, -2.0, 1.0]) / 3
    return e1, np.cross(NORMAL, e1)


def tensor(profile, s, angle, nu):
    """Displacement times shear modulus per newton at distance s radii, in axes (radial 0 angle,
    second, outward)."""
    e1, e2 = plane_axes()
    s, angle = np.broadcast_arrays(np.asarray(s, dtype=float), angle)
    offset = RADIUS * s[:, None] * (np.cos(angle)[:, None] * e1 + np.sin(angle)[:, None] * e2)
    disc = PressureDisc(CENTRE, RADIUS, PROFILES[profile])
    potentials = disc_potentials(disc.profile)
    constant, slope = disc_displacement(disc, potentials, NORMAL, CENTRE + offset)
    frame = np.stack([e1, e2, NORMAL])
    return np.einsum("ai,nij,bj->nab", frame, constant + nu * slope, frame)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.5])
def test_far_away_it_is_boussinesq_and_cerruti(profile, nu):
    s, angle = np.array([60.0]), 0.7
    r = RADIUS * s[0]
    x, y = np.cos(angle), np.sin(angle)
    displacement = tensor(profile, s, angle, nu)[0] * 2 * np.pi * r
    half = 0.5 * (1 - 2 * nu)
    # Johnson, eq. 3.18, 3.19 and 3.77 at the surface; the outward axis points away from the solid:
    # pushed along x, the ground ahead rises, and pulled outward it draws away.
    expected = [
        [1 - nu + nu * x * x, nu * x * y, half * x],
        [nu * x * y, 1 - nu + nu * y * y, half * y],
        [-half * x, -half * y, 1 - nu],
    ]
    # A disc differs from a point by its second moment over the distance squared.
    np.testing.assert_allclose(displacement, expected, atol=1e-4)


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.5])
def test_uniform_disc_settles_by_an_elliptic_integral(nu):
    s = np.linspace(0, 0.95, 8)
    displacement = tensor("uniform", s, 0.3, nu)[:, 2, 2]
    exact = (1 - nu) / (2 * np.pi) * 4 * ellipe(s**2) / (np.pi * RADIUS)
    # Interpolants of degree 32; their nodes, which know the square root at the rim, are exact.
    np.testing.assert_allclose(displacement, exact, rtol=3e-8)
    potential = chord_integrals(PROFILES["uniform"], s)[:, 0]
    np.testing.assert_allclose(potential, 4 * ellipe(s**2) / np.pi, rtol=1e-12)


def test_flat_punch_settles_evenly():
    s, nu = np.linspace(0, 0.95, 9), 0.2
    displacement = tensor("flat", s, 0.8, nu)[:, 2, 2]
    # Johnson, eq. 3.36: the depth under one newton. Twelve radii leave 2e-8 close to the rim,
    # where the pressure is infinite.
    np.testing.assert_allclose(displacement, (1 - nu) / (4 * RADIUS), rtol=1e-6)


@pytest.mark.parametrize("profile", PROFILES)
def test_interpolants_are_the_integrals(profile):
    rim = np.logspace(-4, -1, 10)
    s = np.concatenate([np.linspace(0, 8.0, 200), 1 - rim, 1 + rim])
    exact = chord_integrals(PROFILES[profile], s)
    potentials = disc_potentials(PROFILES[profile]).at(s)
    # What the pressure's own singularity leaves: at the rim of a flat punch, the centre of a cone.
    tolerance = {"flat": 2e-4, "cone": 1e-3}.get(profile, 1e-6)
    np.testing.assert_allclose(potentials, exact, atol=tolerance * exact.max())


def test_hertz_disc_settles_by_a_parabola():
    s = np.linspace(0, 0.95, 9)
    nu = 0.3
    displacement = tensor("hertz", s, 1.0, nu)[:, 2, 2]
    exact = 3 * (1 - nu) * (2 - s**2) / (16 * RADIUS)
    # Twelve radii leave 3e-9 close to the rim.
    np.testing.assert_allclose(displacement, exact, rtol=1e-7)


@pytest.mark.parametrize("profile", PROFILES)
def test_radial_pull_of_a_normal_load(profile):
    # By symmetry the load inside s pulls as if at the centre: u_r = (1 - 2 nu) / (4 pi r) * share
    # within.
    s = np.array([0.3, 0.6, 0.9, 1.5, 3.0])
    share = {
        "uniform": np.minimum(s, 1) ** 2,
        "hertz": 1 - (1 - np.minimum(s, 1) ** 2) ** 1.5,
        "smooth": 1 - (1 - np.minimum(s, 1) ** 2) ** 3,
        "flat": 1 - np.sqrt(1 - np.minimum(s, 1) ** 2),
        "cone": 1
        - np.sqrt(1 - np.minimum(s, 1) ** 2)
        + np.minimum(s, 1) ** 2 * np.arccosh(1 / np.minimum(s, 1)),
    }[profile]
    nu = 0.2
    displacement = tensor(profile, s, 0.0, nu)[:, 0, 2]
    # The cone's pressure has no bound at its centre.
    tolerance = 2e-3 if profile == "cone" else 1e-5
    exact = (1 - 2 * nu) / (4 * np.pi * RADIUS * s) * share
    np.testing.assert_allclose(displacement, exact, rtol=tolerance)


def test_reciprocity_across_the_disc():
    here, there = (tensor("smooth", [0.7, 2.0], angle, 0.3) for angle in (0.4, 0.4 + np.pi))
    np.testing.assert_allclose(here, there.transpose(0, 2, 1), rtol=1e-9, atol=1e-9)


def test_it_is_linear_in_poisson_ratio_and_scales_with_one_over_length():
    low, middle, high = (tensor("smooth", [0.5], 0.2, nu) for nu in (0.0, 0.25, 0.5))
    np.testing.assert_allclose(middle, 0.5 * (low + high), rtol=1e-12)
    disc = PressureDisc(np.zeros(3), 1.0, PROFILES["smooth"])
    twice = PressureDisc(np.zeros(3), 2.0, PROFILES["smooth"])
    offset = np.array([[0.3, 0.4, 0.0]])
    up, potentials = np.array([0.0, 0.0, 1.0]), disc_potentials(PROFILES["smooth"])
    first = disc_displacement(disc, potentials, up, offset)
    other = disc_displacement(twice, potentials, up, 2 * offset)
    np.testing.assert_allclose(first, 2 * other, rtol=1e-12)


def test_a_push_along_the_surface_is_the_sum_of_cerruti_s_points():
    """Just outside a smooth disc, where ahead and aside differ most from a point's."""
    s, nu = 1.2, 0.4
    displacement = tensor("smooth", [s], 0.0, nu)[0] * 2 * np.pi * RADIUS
    # Midpoint rule; the profile falls to zero with its slope at the rim.
    radius, angle = np.meshgrid((np.arange(400) + 0.5) / 400, np.arange(400) / 400 * 2 * np.pi)
    weight = radius * PROFILES["smooth"](radius)
    x, y = s - radius * np.cos(angle), -radius * np.sin(angle)
    r = np.hypot(x, y)
    for k, axis in enumerate((x, y)):
        exact = (weight * (1 - nu + nu * (axis / r) ** 2) / r).sum() / weight.sum()
        # 400 steps each way, second order.
        np.testing.assert_allclose(displacement[k, k], exact, rtol=1e-4)

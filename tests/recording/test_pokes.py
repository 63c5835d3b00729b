"""Curves of pokes whose law is known, and surfaces through the points that were touched."""

import numpy as np
import pytest

from palpate.geometry import checked_mesh, enclosed_volume
from palpate.recording import height_field, read_pokes
from palpate.records import FlatFace, PokeTable, Sphere

# Depth = dented force^(1 - q) + linear force.
DENTED, LINEAR, COUNT = 4e-3, 3e-3, 10
BALL, FLAT = Sphere(4e-3), FlatFace(3e-3)


def table(exponent, *, count=COUNT, noise=0.0, seed=0, normal=(0.0, 0.0, 1.0), numbered=True):
    """Pokes on a grid, at equal steps of force, each from a depth of its own."""
    rng, rows = np.random.default_rng(seed), []
    normal = np.array(normal) / np.linalg.norm(normal)
    for k in range(count):
        start = np.array([5e-3 * (k % 20), 5e-3 * (k // 20), 0.03]) + 1e-4 * rng.normal() * normal
        for force in np.linspace(0.02, 0.3, 10):
            depth = DENTED * force**exponent + LINEAR * force
            rows.append([*(start - depth * normal), force + noise * rng.normal(), k])
    rows = np.array(rows)
    return PokeTable(
        rows[:, :3], rows[:, 3:4], np.tile(normal, (len(rows), 1)),
        rows[:, 4].astype(int) if numbered else None, 0,
    )  # fmt: skip


@pytest.mark.parametrize(("tool", "exponent"), [(BALL, 2.0 / 3.0), (FLAT, 1.0)])
@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.3, -0.4, 1.0)])
def test_a_reading_is_free_of_the_start_of_contact(tool, exponent, normal):
    """Exactly, whatever shares the two parts of the depth have."""
    pokes = read_pokes(table(exponent, normal=normal), tool)
    expected = DENTED * pokes.force**exponent + LINEAR * pokes.force
    np.testing.assert_allclose(pokes.depth, expected, rtol=1e-9)
    assert pokes.samples == 10 * COUNT
    assert pokes.after_deepest == 0


def test_pokes_are_told_apart_by_where_they_are():
    whole, apart = (read_pokes(table(2.0 / 3.0, numbered=n), BALL) for n in (True, False))
    np.testing.assert_array_equal(whole.depth, apart.depth)


def test_the_sign_of_the_force_does_not_count_nor_the_way_back():
    there = table(2.0 / 3.0)
    force = -there.force[:, 0]
    # Hysteresis on the way back, which takes no part.
    back = np.concatenate([np.arange(10), np.arange(8, -1, -1)])
    rows = (10 * np.arange(COUNT)[:, None] + back).ravel()
    lower = np.tile(np.where(np.arange(19) < 10, 1.0, 0.7), COUNT)
    both = PokeTable(
        there.position[rows],
        (lower * force[rows])[:, None],
        there.normal[rows],
        there.poke[rows],
        0,
    )
    pokes = read_pokes(both, BALL)
    np.testing.assert_allclose(pokes.depth, read_pokes(there, BALL).depth, rtol=1e-9)
    assert pokes.after_deepest == 9 * COUNT


def test_a_force_vector_counts_along_the_normal():
    there = table(2.0 / 3.0, normal=(0.3, -0.4, 1.0))
    vectors = PokeTable(
        there.position, -there.force * there.normal + [0.1, 0.075, 0.0], there.normal, there.poke, 0
    )
    np.testing.assert_allclose(read_pokes(vectors, BALL).force, read_pokes(there, BALL).force)


def test_standard_deviations_are_those_of_the_noise():
    """400 pokes: the variance of the z-scores is known to 7 %, their mean to 0.05."""
    pokes = read_pokes(table(2.0 / 3.0, count=400, noise=3e-3), BALL)
    assert pokes.force_noise == pytest.approx(3e-3, rel=0.1)
    exact = read_pokes(table(2.0 / 3.0, count=400), BALL)
    # Of the depth at one force: readings are at forces that the noise moves a little.
    power = np.log(
        exact.depth / (DENTED * (0.9 * exact.force) ** (2 / 3) + LINEAR * 0.9 * exact.force)
    )
    power /= np.log(1.0 / 0.9)
    z = (pokes.depth / exact.depth - (pokes.force / exact.force) ** power) * exact.depth
    z /= pokes.depth_std
    assert abs(z.mean()) < 0.2
    assert z.std() == pytest.approx(1.0, abs=0.15)


def test_pokes_without_contact_are_left_out_and_counted():
    there = table(2.0 / 3.0, noise=1e-3)
    force = there.force.copy()
    force[there.poke == 3] = 1e-3 * np.random.default_rng(1).normal(size=(10, 1))
    pokes = read_pokes(PokeTable(there.position, force, there.normal, there.poke, 0), BALL)
    assert pokes.without_contact == (4,)
    assert len(pokes.force) == COUNT - 1
    assert 4 not in pokes.number


def test_a_level_surface_is_closed_to_a_box():
    pokes = read_pokes(table(2.0 / 3.0, count=200), BALL)
    mesh = height_field(pokes, thickness=0.02, margin=5e-3)
    checked_mesh(mesh)
    width = np.ptp(pokes.point[:, :2], axis=0) + 1e-2
    # Contact begins within 0.1 mm of one height: some micrometres of the mean.
    assert enclosed_volume(mesh) == pytest.approx(width.prod() * 0.02, rel=5e-3)
    np.testing.assert_allclose(np.ptp(mesh.vertices[:, :2], axis=0), width)

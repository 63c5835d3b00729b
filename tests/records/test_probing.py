"""Turns of all measured points: found with whatever shifts and noise, and nothing else is."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palpate.errors import InputError
from palpate.records.probing import check_rotation, rigid_rotation_angle

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-0.02, 0.02, (200, 3))


def turned(points, degrees, axis=(1.0, -2.0, 0.5)):
    """Displacement of a turn about a point far away."""
    vector = np.radians(degrees) * np.array(axis) / np.linalg.norm(axis)
    return (points - 0.1) @ Rotation.from_rotvec(vector).as_matrix().T - (points - 0.1)


@pytest.mark.parametrize("degrees", [0.5, 11.0, 30.0, 90.0, 179.0])
@pytest.mark.parametrize("flat", [False, True])
def test_a_turn_is_found_whatever_comes_with_it(degrees, flat):
    points = POINTS * [1.0, 1.0, 0.0] if flat else POINTS
    moved = turned(points, degrees) + 2e-5 * RNG.normal(size=points.shape)
    # 200 points 12 mm from their middle, 0.02 mm each: 1e-4 rad, five times that.
    assert rigid_rotation_angle(points, moved) == pytest.approx(np.radians(degrees), abs=6e-4)


def test_an_axis_of_the_other_sign_is_the_same_turn():
    assert rigid_rotation_angle(POINTS, turned(POINTS, -30.0)) == pytest.approx(
        np.radians(30.0), abs=1e-9
    )


@pytest.mark.parametrize(
    "moved",
    [
        0.5 * POINTS * [1.0, -0.4, -0.4],
        5e-3 * RNG.normal(size=POINTS.shape),
        np.full_like(POINTS, 0.3),
        -0.04 * np.exp(-((POINTS / 0.01) ** 2).sum(axis=1))[:, None] * [0.0, 0.0, 1.0],
        np.zeros_like(POINTS),
    ],
    ids=["stretch", "noise", "shift", "dent", "nothing"],
)
def test_what_is_no_turn(moved):
    # A shift leaves round-off, and a turn of that.
    assert rigid_rotation_angle(POINTS, moved) < 1e-12
    check_rotation(POINTS, moved, "n.csv")


def test_points_on_a_line_say_nothing():
    line = np.outer(np.linspace(0.0, 1.0, 9), [0.01, 0.02, 0.0])
    assert rigid_rotation_angle(line, turned(line, 40.0)) == 0.0
    assert rigid_rotation_angle(POINTS[:2], turned(POINTS[:2], 40.0)) == 0.0


def test_small_turns_are_let_through_and_large_ones_named():
    check_rotation(POINTS, turned(POINTS, 28.0), "n.csv")
    with pytest.raises(InputError, match=r"n\.csv: the measured points turned by 30 degrees"):
        check_rotation(POINTS, turned(POINTS, 30.0), "n.csv")

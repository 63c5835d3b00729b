"""Tips on their way: what they touch first, and how far they may go."""

import numpy as np
import pytest

from palpate.errors import InputError
from palpate.records import FlatFace, Sphere
from palpate.solids.tips import Tip

POINT = np.array([0.01, -0.02, 0.03])
ALONG = np.array([0.3, -0.2, -0.9])
MODULUS = 5e4


@pytest.mark.parametrize("kind", [Sphere, FlatFace])
def test_a_tip_that_went_to_a_point_touches_it(kind):
    tip = Tip(kind(0.006), POINT, ALONG)
    points = POINT + np.random.default_rng(0).uniform(-0.004, 0.004, (200, 3))
    travel = tip.travel(points)
    for point, distance in zip(points, travel, strict=True):
        gap, normal = tip.distance(distance, point[None])
        # Rounding of lengths of a centimetre.
        assert abs(gap[0]) < 1e-16
        # It comes from outside: farther back the point is free, and the normal looks ahead.
        assert tip.distance(distance - 1e-3, point[None])[0][0] > 0.0
        assert normal[0] @ tip.direction > 0.0
        assert np.linalg.norm(normal[0]) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("kind", [Sphere, FlatFace])
def test_what_lies_beside_is_passed(kind):
    tip = Tip(kind(0.006), POINT, np.array([0.0, 0.0, -1.0]))
    beside = np.array([[0.00599, 0.0, -0.02], [0.00601, 0.0, -0.02], [0.0, 0.00601, 0.02]])
    np.testing.assert_array_equal(np.isfinite(tip.travel(POINT + beside)), [True, False, False])


def test_a_ball_goes_in_by_less_than_its_radius_and_a_punch_as_deep_as_it_likes():
    ball, punch = (Tip(kind(0.006), POINT, ALONG) for kind in (Sphere, FlatFace))
    # Johnson, Contact Mechanics (1985), equation 4.23; a thin layer may bear more than it says.
    force = 4.0 / 3.0 * MODULUS * np.sqrt(0.006 * 0.05**3)
    ball.check_depth(0.0059)
    ball.check_force(force, MODULUS)
    with pytest.raises(InputError, match="depth is 6 mm, the tip's radius 6 mm; a sphere goes in"):
        ball.check_depth(0.006)
    with pytest.raises(InputError, match=r"force is .* half space of this material in by 79.4 mm"):
        ball.check_force(2.0 * force, MODULUS)
    punch.check_depth(1.0)
    punch.check_force(1e9, MODULUS)


def test_a_point_under_the_rim_of_a_punch_is_touched():
    # Elements under the rim have nodes on it, up to rounding.
    rim = POINT + np.array([[0.006 * (1 + 1e-12), 0.0, -0.01]])
    assert Tip(FlatFace(0.006), POINT, np.array([0.0, 0.0, -1.0])).travel(rim)[0] == pytest.approx(
        0.01
    )

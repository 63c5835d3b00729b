"""Free motions in words: the same whatever basis of them is given, and whatever the body's size."""

import numpy as np
import pytest
from scipy.stats import ortho_group

from palpate.geometry.free_motion import motion_texts

CENTRE = np.array([0.004, -0.002, 0.01])
# Names below hold for any size: places are in mm from the origin, which these are not.
SIZES = [2e-3, 0.03, 2.0]


def _slide(direction: list[float]) -> np.ndarray:
    return np.array([0.0, 0.0, 0.0, *direction])


def _turn(axis: list[float], through: np.ndarray, pitch: float = 0.0) -> np.ndarray:
    """Rotation about an axis through a point, as a motion about the centre."""
    turn = np.array(axis)
    return np.concatenate([turn, np.cross(turn, CENTRE - through) + pitch * turn])


def _mixed(motions: list[np.ndarray], size: float) -> np.ndarray:
    """Another basis of the same motions, each of which moves points at `size` by about a metre."""
    scale = np.repeat([size, 1.0], 3)
    basis = np.linalg.qr((np.array(motions) * scale).T)[0].T
    mix = ortho_group.rvs(len(motions), random_state=3) if len(motions) > 1 else np.eye(1)
    return mix @ basis / scale


@pytest.mark.parametrize("size", SIZES)
def test_slides_and_turns_are_told_apart(size: float) -> None:
    beside = CENTRE + size * np.array([0.5, -0.25, 0.0])
    expected = 1e3 * np.array([beside[0], beside[1], 0.0])
    free = _mixed([_slide([0.0, 0.0, 1.0]), _turn([0.0, 0.0, 1.0], beside)], size)
    slide, turn = motion_texts(free, CENTRE, size)
    assert slide == "sliding along (0.00, 0.00, 1.00)"
    text, numbers = turn.split(" through (")
    assert text == "turning about the axis (0.00, 0.00, 1.00)"
    assert [float(v) for v in numbers.removesuffix(") mm").split(",")] == pytest.approx(
        list(expected), abs=0.051
    )


@pytest.mark.parametrize("size", SIZES)
def test_a_ball_turns_about_its_own_centre(size: float) -> None:
    pivot = CENTRE + size * np.array([0.0, 0.3, 0.1])
    free = _mixed([_turn(list(axis), pivot) for axis in np.eye(3)], size)
    (text,) = motion_texts(free, CENTRE, size)
    numbers = text.removeprefix("turning about any axis through (").removesuffix(") mm")
    assert [float(v) for v in numbers.split(",")] == pytest.approx(list(1e3 * pivot), abs=0.051)


@pytest.mark.parametrize("size", SIZES)
def test_a_plate_slides_and_turns_in_its_plane(size: float) -> None:
    free = _mixed(
        [_slide([1.0, 0.0, 0.0]), _slide([0.0, 1.0, 0.0]), _turn([0.0, 0.0, 1.0], CENTRE)], size
    )
    slides, turns = motion_texts(free, CENTRE, size)
    assert slides == "sliding across (0.00, 0.00, 1.00)"
    assert turns.startswith("turning about the axis (0.00, 0.00, 1.00) through")


@pytest.mark.parametrize(("pitch", "how"), [(0.05, "turning about the"), (0.2, "turning and slid")])
@pytest.mark.parametrize("size", SIZES)
def test_a_screw_slides_where_its_pitch_counts(size: float, pitch: float, how: str) -> None:
    free = _mixed([_turn([1.0, 0.0, 0.0], CENTRE, pitch * size)], size)
    (text,) = motion_texts(free, CENTRE, size)
    assert text.startswith(how)


@pytest.mark.parametrize(("sizes_away", "what"), [(20.0, "sliding along"), (5.0, "turning about")])
@pytest.mark.parametrize("size", SIZES)
def test_a_turn_about_an_axis_far_away_is_a_slide(
    size: float, sizes_away: float, what: str
) -> None:
    """Named as a turn where it turns the points by more than a tenth of what it moves them."""
    axis = CENTRE + sizes_away * size * np.array([1.0, 0.0, 0.0])
    (text,) = motion_texts(_mixed([_turn([0.0, 0.0, 1.0], axis)], size), CENTRE, size)
    assert text.startswith(what)

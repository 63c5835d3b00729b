from dataclasses import replace

import numpy as np
import pytest

from palpate.errors import InputError
from palpate.simulation import Material, PlacedTool, Sphere, start_contact, touch
from palpate.viewer.touch import force_text, place_ball, press, ray_intersection

TOP = np.array([0.02, 0.02, 0.04])
UP = np.array([0.0, 0.0, 1.0])
RADIUS = 0.01


def test_the_force_is_that_of_one_straight_press(green):
    pressed = press(green, place_ball(green, TOP, RADIUS), 1e-3)
    ball = Sphere(RADIUS)
    state = start_contact(green, [PlacedTool(ball, TOP + (RADIUS + 1e-6) * UP)])
    for depth in np.linspace(0.0, 1e-3, 400):
        state = touch(green, [PlacedTool(ball, TOP + (RADIUS - depth) * UP)], state)
    # Without friction the last pose alone counts; the contact is settled to 1e-9 of its force.
    np.testing.assert_allclose(pressed.force, -state.tool_force[0], rtol=1e-7, atol=1e-9)
    assert pressed.force[2] < 0.0


def test_deeper_and_back_is_as_before(green):
    first = press(green, place_ball(green, TOP, RADIUS), 1e-3)
    back = press(green, press(green, first, 2.5e-3), 1e-3)
    np.testing.assert_allclose(back.displacement, first.displacement, atol=1e-12)
    assert np.linalg.norm(press(green, first, 2.5e-3).force) > np.linalg.norm(first.force)


def test_no_vertex_is_inside_the_ball(green):
    pressed = press(green, place_ball(green, TOP, RADIUS), 2e-3)
    places = (green.mesh.vertices + pressed.displacement)[green.nodes]
    distance = np.linalg.norm(places - pressed.centre, axis=1)
    assert distance.min() > RADIUS - 1e-9
    assert (distance < RADIUS + 1e-9).sum() == pressed.touching


def test_what_is_held_cannot_be_pressed(green):
    with pytest.raises(InputError, match="held there"):
        place_ball(green, np.array([0.02, 0.02, 0.0]), RADIUS)


def test_what_is_not_prepared_cannot_be_pressed(green):
    with pytest.raises(InputError, match="prepared"):
        place_ball(green, np.array([0.0, 0.02, 0.01]), RADIUS)


def test_too_few_vertices_are_told(green):
    assert "too few" in force_text(press(green, place_ball(green, TOP, 0.002), 2e-4))


def test_a_force_that_is_not_resolved_has_no_sigma(green):
    material = Material(2e4, 0.3, np.diag([1e6, 1e-4]))
    unsure = replace(green, material=material)
    assert "\N{PLUS-MINUS SIGN}" in force_text(press(unsure, place_ball(unsure, TOP, 0.2), 2e-3))
    few = force_text(press(unsure, place_ball(unsure, TOP, 0.002), 2e-4))
    assert "\N{PLUS-MINUS SIGN}" not in few


def test_rays_meet_the_cube_where_they_enter_its_slabs(session):
    draws = np.random.default_rng(3)
    met = 0
    for _ in range(40):
        start = 0.02 + 0.1 * np.sign(draws.normal(size=3)) * draws.uniform(0.5, 1.0, 3)
        way = 0.02 + 0.02 * draws.normal(size=3) - start
        # Between 0 and 40 mm along x, y and z at once, from the latest entry to the first exit.
        times = np.sort((np.array([[0.0], [0.04]]) - start) / way, axis=0)
        enters, leaves = times[0].max(), times[1].min()
        found = ray_intersection(session.mesh, start, way)
        assert (found is not None) == (enters < leaves)
        if found is not None:
            met += 1
            np.testing.assert_allclose(found, start + enters * way, atol=1e-12)
    assert 10 < met < 40

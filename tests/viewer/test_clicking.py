"""A draft written into session.toml, and a ball pressed where a click hits the surface."""

from dataclasses import replace

import numpy as np
import pytest
from surfaces import box

from palpate.contact import PlacedTool
from palpate.errors import InputError, PalpateError
from palpate.records import Sphere, read_session
from palpate.simulation import (
    Material,
    start_contact,
    touch,
)
from palpate.viewer.clicking import (
    Draft,
    flat_face,
    force_text,
    place_ball,
    press,
    triangles_near,
    write_draft,
)

TOP = np.array([0.02, 0.02, 0.04])
UP = np.array([0.0, 0.0, 1.0])
RADIUS = 0.01


@pytest.fixture
def opened(cube_session):
    return read_session(cube_session)


def bottom(mesh):
    return np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] == 0.0).all(axis=1))


def test_a_face_of_a_box_ends_at_its_edges():
    mesh = box(size=(0.04, 0.04, 0.04), cells=6)
    for triangle in (0, 100, 300):
        face = flat_face(mesh, triangle)
        corners = mesh.vertices[mesh.triangles[face]].reshape(-1, 3)
        # Six by six squares of two triangles, in one plane.
        assert len(face) == 72
        assert np.ptp(corners, axis=0).min() == 0.0


def test_near_is_a_ball():
    mesh = box(size=(0.04, 0.04, 0.04), cells=6)
    near = triangles_near(mesh, np.array([0.02, 0.02, 0.04]), 0.01)
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    inside = np.linalg.norm(middle - [0.02, 0.02, 0.04], axis=1) <= 0.01
    assert 0 < len(near) == inside.sum()


def test_what_was_set_is_read_back_and_the_rest_stays(opened):
    text = opened.path.read_text().replace("[support]", "# a comment of a person\n[support]")
    opened.path.write_text(text)
    held = bottom(opened.mesh)[:40]
    draft = Draft().with_support(held).with_contact("n01", np.array([0.01, 0.02, 0.04]))
    write_draft(opened, draft)
    again = read_session(opened.path)
    assert again.held_triangles.tolist() == held.tolist()
    np.testing.assert_allclose(again.probings[0].contact.point, [0.01, 0.02, 0.04])
    assert again.probings[0].contact.radius == opened.probings[0].contact.radius
    written = opened.path.read_text()
    assert "# a comment of a person" in written
    unchanged = [
        line for line in text.splitlines() if "plane" not in line and "contact" not in line
    ]
    assert [line for line in unchanged if line not in written.splitlines()] == []


def test_lengths_are_written_in_the_session_s_unit(opened):
    # The same numbers in millimetres: a cube of 40 micrometres, its contact scaled along.
    opened.path.write_text(opened.path.read_text().replace('"m"', '"mm"').replace("1e-6", "1e-4"))
    small = read_session(opened.path, observations=False)
    write_draft(small, Draft().with_contact("n01", np.array([1e-5, 2e-5, 4e-5])))
    assert "point = [0.01, 0.02, 0.04]" in opened.path.read_text()


def test_a_session_that_could_not_be_read_is_not_written(opened):
    before = opened.path.read_text()
    whole = np.arange(len(opened.mesh.triangles))
    with pytest.raises(PalpateError, match="whole surface"):
        write_draft(opened, Draft().with_support(whole))
    assert opened.path.read_text() == before
    assert not (opened.path.parent / "support_triangles.txt").exists()


def test_nothing_set_is_said(opened):
    with pytest.raises(InputError, match="nothing was set"):
        write_draft(opened, Draft())


def test_several_supports_are_left_to_their_author(opened):
    text = opened.path.read_text().replace("[support]", "[[support]]")
    again = text[text.index("[[support]]") : text.index("[[probe]]")]
    opened.path.write_text(text.replace("[[probe]]", again + "[[probe]]", 1))
    with pytest.raises(InputError, match="2 supports"):
        write_draft(opened, Draft().with_support(bottom(opened.mesh)))


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

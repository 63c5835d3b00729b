"""A push on an object of known constants: against closed forms and against the elastic map."""

from dataclasses import replace

import numpy as np
import pytest
from cube_session import cube_session as cube_session
from scipy.spatial.transform import Rotation
from tool_tractions import traction_of

from palpate.errors import InputError
from palpate.pipeline import poke_session, tool_contact, von_mises_stress
from palpate.probe import LocalSurface, tool_contact as contact_of
from palpate.records import Contact, Sphere, read_session

SHEAR, NU = 2e4, 0.3
TOP = np.array([0.02, 0.02, 0.04])
PRESS = np.array([0.0, 0.0, -1.0])
CENTRE = np.array([[0.02, 0.02, 0.02]])


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    return read_session(cube_session.__wrapped__(tmp_path_factory.mktemp("poke")))


def poked(session, force, **changes):
    contact = tool_contact(session, TOP, None)
    options = {"shear_modulus": SHEAR, "poisson_ratio": NU, "interior": CENTRE} | changes
    return poke_session(session, np.array(force), contact, **options)


@pytest.fixture(scope="module")
def pressed(session):
    return poked(session, PRESS)


def test_the_object_gives_way_under_the_tool_and_the_support_answers(pressed):
    assert pressed.displacement[2] < 0.0
    # The cube and the load are symmetric about the axis of the press, the diagonals of its
    # squares are not: one part in 10 000.
    assert np.abs(pressed.displacement[:2]).max() < 1e-3 * -pressed.displacement[2]
    np.testing.assert_array_equal(pressed.largest_point, TOP)
    # The system holds equilibrium exactly.
    np.testing.assert_allclose(pressed.reaction, -PRESS, atol=1e-9)


def test_it_does_not_matter_where_between_the_vertices_a_contact_lies():
    """A half ball is the same all around, its mesh is not."""
    ball = read_session("examples/half_ball", observations=False)
    moved = []
    for angle in np.linspace(0.0, 2.0, 9):
        turn = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
        direction = np.array([0.6, 0.0, 0.8])
        contact = Contact(0.03 * turn @ direction, 5.5e-3, "smooth")
        pressed = poke_session(
            ball, turn @ -direction, contact, shear_modulus=SHEAR, poisson_ratio=NU
        )
        moved.append(pressed.displacement @ turn)
    # Quadratics through the vertices alone are up to a tenth off, and by the integral equation at
    # the point two per cent, where it lies close to an edge.
    np.testing.assert_allclose(
        moved, np.tile(moved[0], (9, 1)), atol=1e-3 * np.linalg.norm(moved[0])
    )
    assert moved[0] @ -direction > 0.0


def test_the_plane_half_way_down_carries_the_force(session):
    """Equilibrium of the upper half: the stress over the plane adds up to the force."""
    side = (np.arange(8) + 0.5) * 0.04 / 8
    x, y = (grid.ravel() for grid in np.meshgrid(side, side))
    state = poked(session, PRESS, interior=np.column_stack([x, y, np.full(64, 0.02)]))
    stress = state.interior.stress
    np.testing.assert_allclose(stress, np.swapaxes(stress, 1, 2), atol=1e-9)
    # The midpoint rule of 8 by 8 points leaves 0.12 % of the force; four times that.
    np.testing.assert_allclose(0.04**2 * stress[:, :, 2].mean(axis=0), PRESS, atol=0.005)


def test_an_interior_point_moves_less_than_the_contact(pressed):
    inside = pressed.interior.displacement[0, 2]
    assert pressed.displacement[2] < inside < 0.0


def test_displacement_goes_with_the_force_and_against_the_modulus(session, pressed):
    other = poked(session, 2.0 * PRESS, shear_modulus=4.0 * SHEAR)
    # Linear in F / G to rounding; stress in F alone.
    np.testing.assert_allclose(other.displacement, 0.5 * pressed.displacement, rtol=1e-9)
    np.testing.assert_allclose(other.largest, 0.5 * pressed.largest, rtol=1e-9)
    np.testing.assert_allclose(
        other.interior.stress, 2.0 * pressed.interior.stress, rtol=1e-6, atol=1e-6 / 0.04**2
    )


def test_without_interior_points_nothing_is_said_of_the_inside(session):
    assert poked(session, PRESS, interior=None).interior is None


@pytest.mark.parametrize(
    ("point", "message"),
    [((0.02, 0.02, 0.05), "outside the object"), ((0.02, 0.02, 0.03999), "of the surface")],
)
def test_points_that_are_not_inside_are_refused(session, point, message):
    with pytest.raises(InputError, match=message):
        poked(session, PRESS, interior=np.array([point]))


def test_the_tool_is_that_of_the_first_probing(session):
    first = session.probings[0].contact
    contact = tool_contact(session, TOP, None)
    assert (contact.radius, contact.profile) == (first.radius, first.profile)
    assert tool_contact(session, TOP, 0.002).radius == 0.002


def test_a_tool_touches_what_follows_from_force_and_constants(session):
    """A session as it is read gives only a beginning; the fit would settle the radius, and so does
    a push."""
    ball = Sphere(6e-3)
    probing = replace(session.probings[0], contact=Contact.under(ball, TOP))
    tooled = replace(session, probings=(probing,))
    constants = {"shear_modulus": SHEAR, "poisson_ratio": NU}
    state = poke_session(tooled, PRESS, tool_contact(tooled, TOP, None), **constants)
    circle = contact_of(ball, LocalSurface(np.array([0.0, 0.0, 1.0]), 0.0), 1.0, **constants)
    assert state.contact.radius == pytest.approx(circle.radius, rel=1e-6)
    # Half the radius of the ball, as where a search begins, is another depth.
    known = tool_contact(tooled, TOP, circle.radius)
    assert known.tool is None
    known = replace(known, traction=circle.traction)
    alike = poke_session(tooled, PRESS, known, **constants)
    np.testing.assert_allclose(state.displacement, alike.displacement, rtol=1e-6, atol=1e-12)


@pytest.mark.slow
def test_the_outward_traction_of_a_tool_lifts_the_surface_under_it(session):
    """A traction -dQ/dr along a half space lifts it by (1 - 2 nu) / (2 G) Q; in the middle of
    Hertz's circle Q is 5 / (4 pi a) of force times the lever."""
    radius, outward = 6e-3, 0.2
    known = tool_contact(session, TOP, radius)
    plain, pulled = (
        replace(known, traction=traction_of("hertz", share)) for share in (0.0, outward)
    )
    options = {"shear_modulus": SHEAR, "poisson_ratio": NU, "interior": CENTRE}
    without = poke_session(session, PRESS, plain, **options)
    state = poke_session(session, PRESS, pulled, **options)
    lifted = state.displacement[2] - without.displacement[2]
    expected = (1 - 2 * NU) / (2 * SHEAR) * 5 / (4 * np.pi * radius) * outward
    # The edges of the triangles are as long as the radius, the cube is seven radii wide.
    assert lifted == pytest.approx(expected, rel=0.06)
    np.testing.assert_allclose(state.reaction, without.reaction, atol=1e-9)
    # Three radii below it is felt by its square: no resultant.
    deep = np.abs(state.interior.displacement - without.interior.displacement).max()
    assert 0.0 < deep < 0.15 * lifted
    stress = np.abs(state.interior.stress - without.interior.stress).max()
    assert 0.0 < stress < 0.15 * np.abs(without.interior.stress).max()


def test_a_vertex_is_no_tool(session):
    vertex = Contact(TOP, None, "vertex")
    probing = replace(session.probings[0], contact=vertex)
    blunt = replace(session, probings=(probing,))
    with pytest.raises(InputError, match="give one with --radius"):
        tool_contact(blunt, TOP, None)
    assert tool_contact(blunt, TOP, 0.003).radius == 0.003


def test_von_mises_stress_in_closed_form():
    tension, shear, pressure = np.zeros((3, 3, 3))
    tension[0, 0] = 5.0
    shear[0, 1] = shear[1, 0] = 2.0
    pressure[:] = -7.0 * np.eye(3)
    stress = np.stack([tension, shear, pressure, tension + pressure])
    np.testing.assert_allclose(
        von_mises_stress(stress), [5.0, 2.0 * np.sqrt(3.0), 0.0, 5.0], atol=1e-12
    )

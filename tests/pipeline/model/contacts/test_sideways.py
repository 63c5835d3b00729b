"""Where tools press on objects that move sideways and turn under them, against closed forms."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from surfaces import ball_mesh, box

from palpate.bem import (
    BoundarySurface,
    PressureDisc,
    disc_displacement,
    disc_potentials,
    make_surface,
)
from palpate.geometry import TriangleMesh
from palpate.pipeline.model.contacts.contact_radii import with_contact_radii
from palpate.pipeline.model.contacts.sideways import STEP, displaced_contacts
from palpate.records import (
    CONE,
    EXACT,
    FLAT,
    SPHERE,
    STICKS,
    Contact,
    Probing,
    Session,
    Tool,
)

SIDE, BALL, FORCE = 0.04, 6e-3, 0.3
CONSTANTS = {"shear_modulus": 2e4, "poisson_ratio": 0.3}
PLACE = np.array([0.021, 0.019, SIDE])
DOWN = np.array([0.0, 0.0, -1.0])
SIDEWAYS, TURN = np.array([4e-4, -2e-4, -1e-3]), np.array([0.02, 0.03, 0.01])


def _session(mesh: TriangleMesh, tool: Tool, travel: np.ndarray | None = None) -> Session:
    contact = replace(tool.contact(PLACE), radius=3e-3)
    probing = Probing("n", contact, FORCE * DOWN, None, travel, None, None, None)
    return Session("box", Path(), mesh, _held(mesh), (probing,), None, None, None, (), errors=EXACT)


def _held(mesh: TriangleMesh) -> np.ndarray:
    low = mesh.vertices[:, 2].min() + 0.05 * SIDE
    return np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] < low).all(axis=1))


def _surface(mesh: TriangleMesh) -> BoundarySurface:
    return make_surface(mesh, _held(mesh))


def _rigid(mesh: TriangleMesh) -> np.ndarray:
    return SIDEWAYS + np.cross(TURN, mesh.vertices - PLACE)


def _displaced(tool: Tool, travel: np.ndarray | None = None) -> Contact:
    """The contact on a box that moves rigidly, with the dent of a half space under the tool."""
    mesh = box((SIDE, SIDE, SIDE), 16)
    session = _session(mesh, tool, travel)
    contact = session.probings[0].contact
    disc = PressureDisc(contact.point, contact.reach, contact.pressure)
    potentials = disc_potentials(contact.pressure)
    constant, slope = disc_displacement(disc, potentials, -DOWN, mesh.vertices)
    dent = (constant + 0.3 * slope) @ (FORCE * DOWN) / 2e4
    found = displaced_contacts(session, _surface(mesh), [_rigid(mesh) + dent], **CONSTANTS)
    return found.probings[0].contact


def _slope() -> np.ndarray:
    """Derivatives of the height of a horizontal surface that turns by `TURN`."""
    return np.array([-TURN[1], TURN[0], 0.0])


# Between vertices a sixth of the half space's dent is left over as a slope of 1e-3: 6 um of a ball.
NEAR = 1e-5


def test_a_ball_touches_where_the_surface_faces_it() -> None:
    contact = _displaced(Tool(SPHERE, BALL))
    expected = STEP * (BALL * _slope() - np.append(SIDEWAYS[:2], 0.0))
    np.testing.assert_allclose(contact.point - PLACE, expected, rtol=0.0, atol=NEAR)
    np.testing.assert_array_equal(contact.start, PLACE)


def test_a_surface_that_sticks_does_not_slip_but_rolls() -> None:
    contact = _displaced(Tool(SPHERE, BALL, STICKS))
    np.testing.assert_allclose(contact.point - PLACE, STEP * BALL * _slope(), rtol=0.0, atol=NEAR)


@pytest.mark.parametrize("tool", [Tool(FLAT, 3e-3), Tool(CONE, 3e-3, angle=1.2)])
def test_faces_and_points_stay_where_they_are_in_space(tool: Tool) -> None:
    contact = _displaced(tool)
    np.testing.assert_allclose(
        (contact.point - PLACE)[:2], -STEP * SIDEWAYS[:2], rtol=0.0, atol=NEAR
    )


def test_an_arm_that_was_seen_to_move_sideways_is_followed() -> None:
    travel = np.array([3e-4, 1e-4, -2e-3])
    shift = _displaced(Tool(SPHERE, BALL), travel).point - _displaced(Tool(SPHERE, BALL)).point
    np.testing.assert_allclose(shift[:2], STEP * travel[:2], rtol=0.0, atol=1e-9)


def test_a_tool_is_followed_by_no_more_than_its_contact() -> None:
    mesh = box((SIDE, SIDE, SIDE), 16)
    session = _session(mesh, Tool(SPHERE, BALL))
    far = 0.01 * np.broadcast_to([1.0, 0.0, 0.0], mesh.vertices.shape)
    (probing,) = displaced_contacts(session, _surface(mesh), [far], **CONSTANTS).probings
    contact = probing.contact
    assert np.linalg.norm(contact.point - PLACE) == pytest.approx(STEP * contact.radius, rel=1e-2)


def test_a_curved_surface_turns_its_face_sooner() -> None:
    """On a ball of radius B, a ball of radius R touches at R B / (R + B) times the slope."""
    big = 0.03
    mesh = ball_mesh(np.full(3, big), 1500)
    top = mesh.vertices[int(mesh.vertices[:, 2].argmax())]
    session = _session(mesh, Tool(SPHERE, BALL))
    contact = replace(session.probings[0].contact, point=top)
    probing = replace(session.probings[0], contact=contact, force=1e-9 * DOWN)
    moved = np.cross(TURN, mesh.vertices - top)
    session = replace(session, probings=(probing,))
    (found,) = displaced_contacts(session, _surface(mesh), [moved], **CONSTANTS).probings
    expected = STEP * BALL * big / (BALL + big) * _slope()
    # The mesh's own curvature is known to 2 %.
    np.testing.assert_allclose((found.contact.point - top)[:2], expected[:2], rtol=0.0, atol=6e-6)


def test_contacts_without_a_tool_stay() -> None:
    mesh = box((SIDE, SIDE, SIDE), 4)
    session = _session(mesh, Tool(SPHERE, BALL))
    (probing,) = session.probings
    told = replace(probing, contact=Contact(PLACE, 3e-3, "hertz"))
    session = replace(session, probings=(told,))
    found = displaced_contacts(session, _surface(mesh), [_rigid(mesh)], **CONSTANTS)
    assert found.probings[0] is told
    # The circle of a tool is found anew about the place where it presses.
    assert with_contact_radii(found, **CONSTANTS).probings[0].contact is told.contact

"""Contacts whose radius nobody knows: a session that names its tool tells as much as one that knows
the circle that the tool touches.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

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
from palpate.checkpoints import Memory
from palpate.errors import PalpateError
from palpate.geometry import TriangleMesh, closest_points
from palpate.pipeline import (
    fit_session,
    graded_session,
    make_object_model,
    refined_session,
    session_observations,
)
from palpate.pipeline.contacts import (
    STEP,
    _consistent_modulus,
    displaced_contacts,
    largest_change,
    with_contact_radii,
)
from palpate.pipeline.fit_session import _contact_notes
from palpate.probe import LocalSurface, tool_contact
from palpate.records import (
    EXACT,
    SLIDES,
    STICKS,
    Cone,
    Constant,
    Contact,
    DisplacementField,
    ErrorEstimate,
    FlatFace,
    ProbeEstimate,
    Probing,
    Session,
    Sphere,
    Tool,
    ToolTraction,
    mesh_tool,
    read_session,
)

SHEAR, NU, BALL = 2e4, 0.3, 6e-3
# In the middle, the cube does not move sideways under a tool.
PLACE, PUSH = np.array([0.02, 0.02, 0.04]), 0.34
SIDE, TIP, FORCE = 0.04, 6e-3, 0.3
CONSTANTS = {"shear_modulus": 2e4, "poisson_ratio": 0.3}
TOP = np.array([0.021, 0.019, SIDE])
DOWN = np.array([0.0, 0.0, -1.0])
SIDEWAYS, TURN = np.array([4e-4, -2e-4, -1e-3]), np.array([0.02, 0.03, 0.01])
# Between vertices a sixth of the half space's dent is left over as a slope of 1e-3: 6 um of a ball.
NEAR = 1e-5


def _session(contact: Contact, push: float = PUSH) -> Session:
    """A glued cube of 4 cm, pressed from above, seen on its free faces."""
    mesh = box((0.04, 0.04, 0.04), 5)
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    points = mesh.vertices[mesh.vertices[:, 2] > 1e-6]
    field = DisplacementField(
        points, np.zeros_like(points), None, None, closest_points(mesh, points), ""
    )
    force = np.array([0.0, 0.0, -push])
    probing = Probing("n", contact, force, np.full(3, 1e-3), None, None, field, None)
    return Session("cube", Path("cube"), mesh, held, (probing,), None, None, None, (), errors=EXACT)


@pytest.fixture(scope="module")
def measured() -> Session:
    """What a ball moves that touches a circle of Sneddon's radius."""
    local = LocalSurface(np.array([0.0, 0.0, 1.0]), 0.0)
    touched = tool_contact(Sphere(BALL), local, PUSH, shear_modulus=SHEAR, poisson_ratio=NU)
    contact = Contact.under(Sphere(BALL), PLACE)
    session = _session(replace(contact, radius=touched.radius, traction=touched.traction))
    graded = graded_session(refined_session(session))
    (seen,) = session_observations(graded, make_object_model(graded))
    (probing,) = session.probings
    moved = (seen.response.value(NU) @ np.append(probing.force, 1.0) / SHEAR).reshape(-1, 3)
    field = replace(probing.displacement, displacement=moved[: len(seen.position)])
    return replace(session, probings=(replace(probing, displacement=field),))


def _named(measured: Session, tool: Tool) -> Session:
    (probing,) = measured.probings
    return replace(measured, probings=(replace(probing, contact=Contact.under(tool, PLACE)),))


def test_the_circle_is_found(measured: Session) -> None:
    estimate = fit_session(_named(measured, Sphere(BALL))).estimate
    # Radii count as settled at 1 %, which moves the constants by a tenth of that, and the mesh that
    # finds them is the coarser one.
    assert estimate.young_modulus.value == pytest.approx(2 * SHEAR * (1 + NU), rel=2e-3)
    assert estimate.poisson_ratio.value == pytest.approx(NU, abs=1e-3)
    (note,) = [note for note in estimate.notes if "touches" in note]
    radius = float(note.split("touches: ")[1].split(" mm")[0])
    (known,) = measured.probings
    assert radius == pytest.approx(1e3 * known.contact.radius, rel=0.01)


def test_all_radii_are_tried_with_the_same_factors(
    measured: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The radius changes the load, not the equations: each model is factorised once."""
    factorised, asked = [], []
    for module, name, calls in (
        ("palpate.bem.system.factors", "_factorise_with_slope", factorised),
        ("palpate.pipeline.contacts", "joint_minimum", asked),
    ):
        monkeypatch.setattr(sys.modules[module], name, _counted(sys.modules[module], name, calls))
    fit_session(_named(measured, Sphere(BALL)))
    assert len(asked) > 1
    # The given mesh, wider fits, finer edges, the graded mesh.
    assert len(factorised) == 4


def _counted(module: ModuleType, name: str, calls: list[object]) -> Callable[..., object]:
    plain = getattr(module, name)

    def counting(*arguments: object, **named: object) -> object:
        calls.append(arguments)
        return plain(*arguments, **named)

    return counting


@pytest.mark.slow
def test_a_ball_that_is_given_as_a_mesh_is_as_good(measured: Session) -> None:
    """Solved on a grid, for a polyhedron, with the slope of a sphere: pressure, outward part, load.

    The truth has r / R in place of the slope, which is 2 % of an outward part that is worth 0.004.
    """
    tool = mesh_tool(ball_mesh(np.full(3, BALL), 1500), np.eye(3))
    estimate = fit_session(_named(measured, tool)).estimate
    assert estimate.young_modulus.value == pytest.approx(2 * SHEAR * (1 + NU), rel=2e-3)
    assert estimate.poisson_ratio.value == pytest.approx(NU, abs=1e-3)


def test_without_its_outward_part_a_sphere_makes_nu_too_large(measured: Session) -> None:
    """The right circle and pressure, and nothing but these."""
    (probing,) = measured.probings
    pressure = probing.contact.traction.pressure
    plain = replace(probing.contact, tool=None, traction=ToolTraction(pressure, 0.0 * pressure))
    estimate = fit_session(replace(measured, probings=(replace(probing, contact=plain),))).estimate
    assert estimate.poisson_ratio.value > NU + 2e-3


@pytest.mark.parametrize("slope", [0.7, 0.2, -0.6])
def test_radii_and_moduli_converge_by_secants(slope: float) -> None:
    """A modulus that a fit finds depends on that of the radii, both as logarithms: linear here."""
    at_rest = 11.0
    taken: list[float] = []
    fitted = [7.0]
    for _ in range(3):
        taken.append(_consistent_modulus(taken, fitted))
        fitted.append(at_rest + slope * (taken[-1] - at_rest))
    # The first fit, with the initial radii, belongs to no modulus; two more fits give the slope.
    assert taken[:2] == fitted[:2]
    assert taken[2] == pytest.approx(at_rest, rel=1e-12)


def test_secants_are_not_trusted_beyond_a_slope() -> None:
    # Fitted moduli that change as fast as those of the radii have no fixed point near.
    assert _consistent_modulus([7.0, 8.0], [7.0, 8.0, 9.1]) == pytest.approx(8.0 + 1.1 / 0.2)


def test_outward_traction_is_as_well_known_as_the_circle(measured: Session) -> None:
    """One standard deviation of it is 5 %, where `touched_radius` is."""
    (probing,) = measured.probings
    known = replace(measured, errors=replace(EXACT, touched_radius=0.05))
    model = make_object_model(known)
    perturbed = zip(model.loads.perturbation_columns, model.loads.perturbations, strict=True)
    ((column, pulled),) = (pair for pair in perturbed if pair[1].outward)
    # Its column is the prior's share of the whole traction, which a contact without it lacks.
    pressure = probing.contact.traction.pressure
    level = ToolTraction(pressure, 0.0 * pressure)
    bare = replace(probing, contact=replace(probing.contact, traction=level))
    without = make_object_model(replace(known, probings=(bare,)))
    change = (model.right.terms[:, :, :3] - without.right.terms[:, :, :3]) @ (0.05 * probing.force)
    np.testing.assert_allclose(model.right.terms[:, :, column], change, rtol=1e-9, atol=1e-12)
    assert [parameter.name for parameter in pulled.steps] == ["outward traction in n"]


@pytest.mark.parametrize("sigmas", [2.0, -4.0])
@pytest.mark.parametrize("name", ["contact radius of n", "outward traction in n"])
def test_a_tool_of_another_friction_is_doubted(measured: Session, name: str, sigmas: float) -> None:
    error = ErrorEstimate(name, "", 0.05 * sigmas, 0.01, 0.05)
    probe = ProbeEstimate(
        "n", *[Constant(1.0, 0.1, (0.8, 1.2))] * 3, 1, 0, 0, 0.0, None, errors=(error,)
    )
    doubts = [note for note in _contact_notes(measured, [probe]) if "friction =" in note]
    assert len(doubts) == (abs(sigmas) > 3.0)
    assert all(
        '"slides": if the tool is right, try friction = "sticks"' in doubt for doubt in doubts
    )


def test_a_buried_ball_is_refused(measured: Session) -> None:
    with pytest.raises(
        PalpateError, match=r"probing 'n': a force of .* would bury a sphere of 1 mm"
    ):
        fit_session(_named(measured, Sphere(1e-3)))


def test_the_fit_follows_a_contact_that_the_object_carries_along(measured: Session) -> None:
    """Beside the middle the cube leans under the tool, which then presses farther out."""
    (probing,) = measured.probings
    contact = replace(
        Contact.under(Sphere(BALL), PLACE + np.array([0.01, 0.0, 0.0])), radius=2.5e-3
    )
    session = replace(measured, probings=(replace(probing, contact=contact),))
    (seen,) = session_observations(session, make_object_model(session))
    moved = (seen.response.value(NU) @ np.append(probing.force, 1.0) / SHEAR).reshape(-1, 3)
    field = replace(probing.displacement, displacement=moved)
    session = replace(session, probings=(replace(probing, contact=contact, displacement=field),))
    notes = fit_session(session).estimate.notes
    (note,) = [note for note in notes if "moves sideways under the tool" in note]
    assert "mm in n" in note


@pytest.mark.slow
def test_a_tool_slides_as_far_as_its_displacement_says(measured: Session) -> None:
    """The arm's displacement is that of the surface along the normal, and any along it."""
    known = _with_tip(measured, np.array([3e-4, -5e-4, 0.0]), SLIDES)
    (probe,) = fit_session(known).estimate.probes
    slips = {error.name: error.value for error in probe.errors if "slip of the tool" in error.name}
    # A mesh of 8 mm, cut along diagonals, moves by 0.07 mm sideways under a press of 1.5 mm.
    assert slips["slip of the tool in n toward +x"] == pytest.approx(3e-4, abs=1e-4)
    assert slips["slip of the tool in n toward +y"] == pytest.approx(-5e-4, abs=1e-4)
    # Where it sticks there is none, and such a displacement is a contradiction.
    stuck = fit_session(_with_tip(measured, np.array([3e-4, -5e-4, 0.0]), STICKS)).estimate
    assert not any("slip" in error.name for error in stuck.probes[0].errors)


def _with_tip(measured: Session, slip: np.ndarray, friction: str) -> Session:
    """The press with the displacement of its tool, which slid to where it presses."""
    (probing,) = measured.probings
    contact = replace(probing.contact, tool=Sphere(BALL, friction=friction))
    asked = replace(probing, contact=contact, tip_displacement=np.zeros(3))
    session = replace(measured, probings=(asked,))
    (seen,) = session_observations(session, make_object_model(session))
    moved = (seen.response.value(NU) @ np.append(probing.force, 1.0) / SHEAR).reshape(-1, 3)
    pressed = replace(
        asked,
        contact=replace(contact, point=PLACE - slip),
        # In the middle the surface moves along the normal only.
        tip_displacement=np.array([0.0, 0.0, moved[-1, 2]]) + slip,
        tip_displacement_std=np.full(3, 1e-5),
    )
    return replace(session, probings=(pressed,))


def test_a_contact_counts_as_changed_by_its_place_too(measured: Session) -> None:
    (probing,) = measured.probings
    contact = probing.contact
    moved = replace(contact, point=contact.point + 0.04 * contact.radius * np.eye(3)[0])
    wider = replace(contact, radius=contact.radius / 0.99)
    assert contact.traction is not None
    outward = contact.traction.outward * (1.0 + 0.01 / contact.traction.lever)
    pulled = replace(contact, traction=replace(contact.traction, outward=outward))
    for other in (moved, wider, pulled):
        changed = replace(measured, probings=(replace(probing, contact=other),))
        assert largest_change(measured, changed) == pytest.approx(0.01, rel=1e-9)
    unknown = replace(
        measured, probings=(replace(probing, contact=replace(contact, traction=None)),)
    )
    assert largest_change(unknown, measured) == 1.0


def _block_session(mesh: TriangleMesh, tool: Tool, travel: np.ndarray | None = None) -> Session:
    contact = replace(Contact.under(tool, TOP), radius=3e-3)
    probing = Probing("n", contact, FORCE * DOWN, None, travel, None, None, None)
    return Session("box", Path(), mesh, _held(mesh), (probing,), None, None, None, (), errors=EXACT)


def _held(mesh: TriangleMesh) -> np.ndarray:
    low = mesh.vertices[:, 2].min() + 0.05 * SIDE
    return np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] < low).all(axis=1))


def _surface(mesh: TriangleMesh) -> BoundarySurface:
    return make_surface(mesh, _held(mesh))


def _rigid(mesh: TriangleMesh) -> np.ndarray:
    return SIDEWAYS + np.cross(TURN, mesh.vertices - TOP)


def _displaced(tool: Tool, travel: np.ndarray | None = None) -> Contact:
    """The contact on a box that moves rigidly, with the dent of a half space under the tool."""
    mesh = box((SIDE, SIDE, SIDE), 16)
    session = _block_session(mesh, tool, travel)
    contact = session.probings[0].contact
    disc = PressureDisc(contact.point, contact.reach, contact.pressure)
    potentials = disc_potentials(contact.pressure)
    constant, slope = disc_displacement(disc, potentials, -DOWN, mesh.vertices)
    dent = (constant + 0.3 * slope) @ (FORCE * DOWN) / 2e4
    displaced = displaced_contacts(session, _surface(mesh), [_rigid(mesh) + dent], **CONSTANTS)
    return displaced.probings[0].contact


def _slope() -> np.ndarray:
    """Derivatives of the height of a horizontal surface that turns by `TURN`."""
    return np.array([-TURN[1], TURN[0], 0.0])


def test_a_ball_touches_where_the_surface_faces_it() -> None:
    contact = _displaced(Sphere(TIP))
    expected = STEP * (TIP * _slope() - np.append(SIDEWAYS[:2], 0.0))
    np.testing.assert_allclose(contact.point - TOP, expected, rtol=0.0, atol=NEAR)
    np.testing.assert_array_equal(contact.start, TOP)


def test_a_surface_that_sticks_does_not_slip_but_rolls() -> None:
    contact = _displaced(Sphere(TIP, friction=STICKS))
    np.testing.assert_allclose(contact.point - TOP, STEP * TIP * _slope(), rtol=0.0, atol=NEAR)


@pytest.mark.parametrize("tool", [FlatFace(3e-3), Cone(3e-3, 1.2)])
def test_faces_and_points_stay_where_they_are_in_space(tool: Tool) -> None:
    contact = _displaced(tool)
    np.testing.assert_allclose((contact.point - TOP)[:2], -STEP * SIDEWAYS[:2], rtol=0.0, atol=NEAR)


def test_an_arm_that_was_seen_to_move_sideways_is_followed() -> None:
    travel = np.array([3e-4, 1e-4, -2e-3])
    shift = _displaced(Sphere(TIP), travel).point - _displaced(Sphere(TIP)).point
    np.testing.assert_allclose(shift[:2], STEP * travel[:2], rtol=0.0, atol=1e-9)


def test_a_tool_is_followed_by_no_more_than_its_contact() -> None:
    mesh = box((SIDE, SIDE, SIDE), 16)
    session = _block_session(mesh, Sphere(TIP))
    far = 0.01 * np.broadcast_to([1.0, 0.0, 0.0], mesh.vertices.shape)
    (probing,) = displaced_contacts(session, _surface(mesh), [far], **CONSTANTS).probings
    contact = probing.contact
    assert np.linalg.norm(contact.point - TOP) == pytest.approx(STEP * contact.radius, rel=1e-2)


def test_a_curved_surface_turns_its_face_sooner() -> None:
    """On a ball of radius B, a ball of radius R touches at R B / (R + B) times the slope."""
    big = 0.03
    mesh = ball_mesh(np.full(3, big), 1500)
    top = mesh.vertices[int(mesh.vertices[:, 2].argmax())]
    session = _block_session(mesh, Sphere(TIP))
    contact = replace(session.probings[0].contact, point=top)
    probing = replace(session.probings[0], contact=contact, force=1e-9 * DOWN)
    moved = np.cross(TURN, mesh.vertices - top)
    session = replace(session, probings=(probing,))
    (displaced,) = displaced_contacts(session, _surface(mesh), [moved], **CONSTANTS).probings
    expected = STEP * TIP * big / (TIP + big) * _slope()
    # The mesh's own curvature is known to 2 %.
    np.testing.assert_allclose(
        (displaced.contact.point - top)[:2], expected[:2], rtol=0.0, atol=6e-6
    )


def test_contacts_without_a_tool_stay() -> None:
    mesh = box((SIDE, SIDE, SIDE), 4)
    session = _block_session(mesh, Sphere(TIP))
    (probing,) = session.probings
    hertzian = replace(probing, contact=Contact(TOP, 3e-3, "hertz"))
    session = replace(session, probings=(hertzian,))
    displaced = displaced_contacts(session, _surface(mesh), [_rigid(mesh)], **CONSTANTS)
    assert displaced.probings[0] is hertzian
    # The circle of a tool is found anew about the place where it presses.
    assert with_contact_radii(displaced, **CONSTANTS).probings[0].contact is hertzian.contact


def test_a_push_more_is_modelled_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Live, each of six pushes is fitted with those before it, to what a fit of all finds."""
    given = read_session(Path(__file__).parents[2] / "examples" / "half_ball")
    probings = tuple(
        replace(probing, contact=Contact.under(Sphere(0.02), probing.contact.point))
        for probing in given.probings
    )
    modelled: list[tuple[str, ...]] = []

    def noted(session: Session, **options: Any) -> object:
        modelled.append(tuple(probing.name for probing in session.probings))
        return make_object_model(session, **options)

    for module in ("palpate.pipeline.observations", "palpate.pipeline.fit_session"):
        monkeypatch.setattr(sys.modules[module], "make_object_model", noted)
    memory = Memory()
    for count in range(1, len(probings) + 1):
        modelled.clear()
        session = replace(given, probings=probings[:count])
        live = fit_session(session, cache=memory).estimate
    # Of the one before, the contact may still settle.
    assert {name for names in modelled for name in names} <= {"p5", "p6"}
    anew = fit_session(session).estimate
    for name in ("young_modulus", "poisson_ratio"):
        value, expected = getattr(live, name), getattr(anew, name)
        # Contacts stay that change by less than a quarter of a per cent.
        assert abs(value.value - expected.value) < 0.05 * expected.std
        assert value.std == pytest.approx(expected.std, rel=0.01)
    # The last push is taken back.
    fewer = replace(given, probings=probings[:-1])
    live, alone = (fit_session(fewer, cache=cache).estimate for cache in (memory, None))
    difference = live.young_modulus.value - alone.young_modulus.value
    assert abs(difference) < 0.05 * alone.young_modulus.std
    # Another force on the first push is another push.
    weaker = replace(probings[0], force=0.9 * probings[0].force)
    session = replace(given, probings=(weaker, *probings[1:]))
    live, anew = (fit_session(session, cache=cache).estimate for cache in (memory, None))
    assert abs(live.young_modulus.value - anew.young_modulus.value) < 0.05 * anew.young_modulus.std

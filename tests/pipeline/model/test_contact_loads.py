"""What the mesh about a contact may be off by: where there is such an error, and how large."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from error_columns import columns_of, curvature_of
from surfaces import box, sphere
from tool_tractions import traction_of

from palpate.bem import (
    BoundarySystem,
    boundary_system,
    indentation_corrections,
    load_right_hand,
    make_surface,
)
from palpate.bem.loads.right_hand import traction_column
from palpate.geometry import TriangleMesh, closest_points
from palpate.pipeline import make_object_model, session_observations
from palpate.pipeline.model import contact_loads
from palpate.pipeline.model.contact_loads import (
    DIP_ERROR,
    has_outward_traction,
    outward_load,
    outward_pushes,
)
from palpate.probe import ContactPatch, find_contact_patch
from palpate.records import EXACT, Contact, DisplacementField, Probing, Session
from palpate.records.error_priors import ErrorPriors
from palpate.solids import make_solid

RADIUS, NU, MODULUS = 0.03, 0.3, 2e4
NAME = "mesh about the contact of n (in dips of a half space)"
# Nothing but the mesh's own error beside the force's gain.
GAIN = replace(EXACT, force_gain=0.01)
BALL, SMALL_RADIUS, SIDE = 0.3, 12e-3, 0.04
# Under a sphere that slides.
OUTWARD = 0.4 * SMALL_RADIUS / BALL
PLACE, UP = np.array([0.02, 0.02, SIDE]), np.array([0.0, 0.0, 1.0])


def _session(cuts: int, errors: ErrorPriors, *, measured: np.ndarray | None = None) -> Session:
    """A ball on its cut-off foot, pressed from above over a circle of 5 mm."""
    mesh = TriangleMesh(RADIUS * sphere(cuts).vertices, sphere(cuts).triangles)
    held = np.flatnonzero(mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.3 * RADIUS)
    points = RADIUS * sphere(1).vertices[sphere(1).vertices[:, 2] > -0.1]
    field = DisplacementField(
        points,
        np.full(points.shape, 1e-5) if measured is None else measured,
        np.full(points.shape, 1e-7),
        None,
        closest_points(mesh, points),
        "",
    )
    contact = Contact(np.array([0.0, 0.0, RADIUS]), 5e-3, "smooth")
    push = np.array([0.05, 0.0, -0.2])
    probing = Probing("n", contact, push, None, None, None, field, None)
    return Session(
        "ball", Path("ball"), mesh, held, (probing,), None, None, None, (), errors=errors
    )


def _seen(session: Session):
    return session_observations(session, make_object_model(session))[0]


def test_the_parameter_stands_for_what_the_dip_adds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the model whose elements know nothing of dips."""
    seen = _seen(_session(2, GAIN))
    (error,) = [
        nuisance for nuisance in seen.nuisances if NAME in [p.name for p in nuisance.parameters]
    ]
    rows = np.arange(seen.displacement.size)
    load = np.append(seen.force, 1.0) / MODULUS
    with_dips = seen.response.value(NU)[rows]
    column = columns_of(error, with_dips, load, NU)[:, -1]
    monkeypatch.setattr(
        "palpate.pipeline.model.load_table.indentation_corrections",
        lambda _, loads: [None] * len(loads),
    )
    without = _seen(_session(2, GAIN))
    assert NAME not in [p.name for nuisance in without.nuisances for p in nuisance.parameters]
    step = (with_dips - without.response.value(NU)[rows])[:, :3] @ seen.force / MODULUS
    assert np.abs(step).max() > 1e-7
    # Both models are reduced to a residual of 1e-8.
    np.testing.assert_allclose(column, DIP_ERROR * step, atol=1e-6 * np.abs(step).max())


def test_the_dip_is_an_error_of_the_model() -> None:
    """Its size near the contact counts in the model's error of unknown shape."""
    seen = _seen(_session(2, GAIN))
    every = [parameter for error in seen.nuisances for parameter in error.parameters]
    assert [parameter.name for parameter in every if parameter.is_model_error] == [NAME]


def test_the_mesh_is_not_exact_where_the_laboratory_is() -> None:
    """What a session says of its sensors says nothing about triangles."""
    (error,) = _seen(_session(2, EXACT)).nuisances
    assert [parameter.name for parameter in error.parameters] == [NAME]


def _left(deviations: float) -> float:
    """What first and second derivatives leave of a contact that lies beside its place, over the
    largest displacement."""
    std = 5e-4
    session = _session(3, replace(EXACT, contact_point=std))
    (probing,) = session.probings
    seen = _seen(session)
    error = next(nuisance for nuisance in seen.nuisances if nuisance.curvature is not None)
    rows, load = np.arange(seen.displacement.size), np.append(seen.force, 1.0) / MODULUS
    nominal = seen.response.value(NU)[rows]
    slope = columns_of(error, nominal, load, NU)[:, 0]
    curvature = curvature_of(error, nominal, load, NU)[:, 0, 0]
    # The first tangent of a contact on top is x.
    there = closest_points(
        session.mesh,
        probing.contact.point + np.array([[0.0, 0.0, 0.0], [deviations * std, 0.0, 0.0]]),
    ).position
    contact = replace(probing.contact, point=probing.contact.point + there[1] - there[0])
    other = _seen(replace(session, probings=(replace(probing, contact=contact),), errors=EXACT))
    moved = (other.response.value(NU)[rows] - nominal)[:, :3] @ seen.force / MODULUS
    rest = moved - deviations * slope - 0.5 * deviations**2 * curvature
    return float(np.abs(rest).max() / np.abs(nominal[:, :3] @ seen.force / MODULUS).max())


@pytest.mark.slow
def test_contacts_far_beside_their_place_are_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    far = [_left(deviations) for deviations in (2.0, 3.0)]
    # A tenth of the contact's radius is one deviation.
    assert far[0] < 1e-3
    monkeypatch.setattr(contact_loads, "_PLACES", contact_loads._PLACES / np.sqrt(3.0))
    near = [_left(deviations) for deviations in (2.0, 3.0)]
    # Of a cubic (8 - 6) / (8 - 2) and (27 - 9) / (27 - 3); a little is of the fourth order.
    np.testing.assert_allclose(np.divide(far, near), [1 / 3, 3 / 4], atol=0.16)


@pytest.fixture(scope="module")
def system() -> BoundarySystem:
    """A cube whose triangles are less than a third of the touched radius."""
    mesh = box((SIDE, SIDE, SIDE), 12)
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    return boundary_system(make_surface(mesh, held))


def _patch(system: BoundarySystem, profile: str = "hertz") -> ContactPatch:
    contact = Contact(PLACE, SMALL_RADIUS, profile, traction=traction_of(profile, OUTWARD))
    held = np.flatnonzero(system.surface.held)
    return find_contact_patch(system.surface.mesh, contact, held, name="n")


def test_it_is_the_traction_itself(system: BoundarySystem) -> None:
    patch = _patch(system)
    nodes = system.surface.element_nodes[patch.triangles]
    offset = nodes - PLACE
    share = np.linalg.norm(offset, axis=2, keepdims=True) / SMALL_RADIUS
    # Hertz's pressure of one newton, times the lean.
    pressure = 1.5 / (np.pi * SMALL_RADIUS**2) * np.sqrt(np.clip(1.0 - share**2, 0.0, None))
    direct = traction_column(system, patch.triangles, pressure * offset / BALL)
    # Pushed down, along minus z.
    loads, forces = zip(*outward_pushes(patch, UP, -UP), strict=True)
    dips = indentation_corrections(system.surface, loads)
    columns = sum(
        load_right_hand(system, [load], [dip]).terms @ force
        for load, dip, force in zip(loads, dips, forces, strict=True)
    )
    # Six-node triangles at the rim miss some of its square root, and
    # know nothing of the dip between the vertices: 7 %.
    down = columns[:, :-3]
    miss = np.linalg.norm(down - direct.terms[:, :-3, 0]) / np.linalg.norm(down)
    assert miss < 0.1
    # It has no resultant.
    assert np.abs(columns[:, -3:]).max() < 1e-12 * np.abs(columns).max()


def test_what_has_an_outward_part(system: BoundarySystem) -> None:
    contact = _patch(system).contact
    assert has_outward_traction(contact)
    assert not has_outward_traction(replace(contact, traction=traction_of("hertz", 0.0)))


@pytest.mark.parametrize("profile", ["hertz", "cone", "flat"])
def test_in_finite_elements_it_stretches_as_much(profile: str) -> None:
    """Its virial, sum of force times place, is the lever times radius and force."""
    solid = make_solid(box((SIDE, SIDE, SIDE), 4), edge=9e-3, fine=[(PLACE, SMALL_RADIUS, 4e-3)])
    contact = Contact(PLACE, SMALL_RADIUS, profile, traction=traction_of(profile, OUTWARD))
    load = outward_load(solid, contact, np.array([0.0, 0.0, -2.0]))
    assert np.abs(load.sum(axis=0)).max() < 1e-12
    assert not load[:, 2].any()
    virial = float((load * (solid.nodes - PLACE)).sum())
    # Faces of a third of the radius, sampled at 196 points.
    assert virial == pytest.approx(2.0 * OUTWARD * SMALL_RADIUS, rel=0.01)

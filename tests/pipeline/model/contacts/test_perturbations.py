"""What the mesh about a contact may be off by: where there is such an error, and how large."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from error_columns import columns_of, curvature_of
from surfaces import sphere

from palpate.geometry import TriangleMesh, closest_points
from palpate.pipeline import make_object_model, session_observations
from palpate.pipeline.model.contacts import perturbations
from palpate.pipeline.model.contacts.perturbations import DIP_ERROR
from palpate.records import EXACT, Contact, DisplacementField, ErrorPriors, Probing, Session

RADIUS, NU, MODULUS = 0.03, 0.3, 2e4
NAME = "mesh about the contact of n (in dips of a half space)"
# Nothing but the mesh's own error beside the force's gain.
GAIN = replace(EXACT, force_gain=0.01)


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
    (error,) = [one for one in seen.nuisances if NAME in [p.name for p in one.parameters]]
    rows = np.arange(seen.displacement.size)
    load = np.append(seen.force, 1.0) / MODULUS
    with_dips = seen.response.value(NU)[rows]
    column = columns_of(error, with_dips, load, NU)[:, -1]
    monkeypatch.setattr(
        "palpate.pipeline.model.load_table.indentation_corrections",
        lambda _, loads: [None] * len(loads),
    )
    without = _seen(_session(2, GAIN))
    assert NAME not in [p.name for one in without.nuisances for p in one.parameters]
    step = (with_dips - without.response.value(NU)[rows])[:, :3] @ seen.force / MODULUS
    assert np.abs(step).max() > 1e-7
    # Both models are reduced to a residual of 1e-8.
    np.testing.assert_allclose(column, DIP_ERROR * step, atol=1e-6 * np.abs(step).max())


def test_the_dip_is_an_error_of_the_model() -> None:
    """Its size near the contact counts in the model's error of unknown shape."""
    seen = _seen(_session(2, GAIN))
    every = [one for error in seen.nuisances for one in error.parameters]
    assert [one.name for one in every if one.is_model_error] == [NAME]


def test_the_mesh_is_not_exact_where_the_laboratory_is() -> None:
    """What a session says of its sensors says nothing about triangles."""
    (error,) = _seen(_session(2, EXACT)).nuisances
    assert [one.name for one in error.parameters] == [NAME]


def _left(deviations: float) -> float:
    """What first and second derivatives leave of a contact that lies beside its place, over the
    largest displacement."""
    std = 5e-4
    told = _session(3, replace(EXACT, contact_point=std))
    (probing,) = told.probings
    seen = _seen(told)
    error = next(one for one in seen.nuisances if one.curvature is not None)
    rows, load = np.arange(seen.displacement.size), np.append(seen.force, 1.0) / MODULUS
    nominal = seen.response.value(NU)[rows]
    slope = columns_of(error, nominal, load, NU)[:, 0]
    curvature = curvature_of(error, nominal, load, NU)[:, 0, 0]
    # The first tangent of a contact on top is x.
    there = closest_points(
        told.mesh, probing.contact.point + np.array([[0.0, 0.0, 0.0], [deviations * std, 0.0, 0.0]])
    ).position
    contact = replace(probing.contact, point=probing.contact.point + there[1] - there[0])
    other = _seen(replace(told, probings=(replace(probing, contact=contact),), errors=EXACT))
    moved = (other.response.value(NU)[rows] - nominal)[:, :3] @ seen.force / MODULUS
    rest = moved - deviations * slope - 0.5 * deviations**2 * curvature
    return float(np.abs(rest).max() / np.abs(nominal[:, :3] @ seen.force / MODULUS).max())


@pytest.mark.slow
def test_contacts_far_beside_their_place_are_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    far = [_left(deviations) for deviations in (2.0, 3.0)]
    # A tenth of the contact's radius is one deviation.
    assert far[0] < 1e-3
    monkeypatch.setattr(perturbations, "_PLACES", perturbations._PLACES / np.sqrt(3.0))
    near = [_left(deviations) for deviations in (2.0, 3.0)]
    # Of a cubic (8 - 6) / (8 - 2) and (27 - 9) / (27 - 3); a little is of the fourth order.
    np.testing.assert_allclose(np.divide(far, near), [1 / 3, 3 / 4], atol=0.16)

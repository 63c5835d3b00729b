"""What the mesh may be off by between its vertices and along sharp edges: as much as finer ones
show, and in the intervals.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from error_columns import columns_of
from surfaces import box, sphere

from palpate.estimation import ProbeObservations, fit
from palpate.geometry import TriangleMesh, closest_points
from palpate.pipeline import (
    fit_session,
    graded_session,
    make_object_model,
    observations as mesh_errors,
    session_observations,
)
from palpate.pipeline.model.grading import edge_refined_session, halved_session
from palpate.pipeline.observations import (
    converged_observations,
    ungraded_observations,
    with_mesh_steps,
)
from palpate.records import EXACT, Contact, DisplacementField, Probing, Session

SHEAR, NU, RADIUS = 2e4, 0.3, 0.03
PRESSED = {
    "a": ([0, 0, 1], [0.0, 0.0, -0.5]),
    "b": ([0.7, 0, 0.7], [-0.3, 0.0, -0.3]),
    "c": ([0.0, -0.8, 0.6], [0.0, 0.3, -0.2]),
}


@pytest.fixture(scope="module")
def session() -> Session:
    """A coarse ball held at its foot that moves as a mesh of four times as many vertices does."""
    unit = sphere(2)
    mesh = TriangleMesh(RADIUS * unit.vertices, unit.triangles)
    held = np.flatnonzero(mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.4 * RADIUS)
    seen = np.flatnonzero(mesh.vertices[:, 2] > -0.2 * RADIUS)
    points, nothing = mesh.vertices[seen], np.zeros((len(seen), 3))
    surface = closest_points(mesh, points)
    probings = tuple(
        Probing(
            name,
            Contact(
                closest_points(mesh, RADIUS * np.array([direction])).position[0], 0.01, "smooth"
            ),
            np.array(force),
            np.zeros(3),
            None,
            None,
            DisplacementField(points, nothing, np.full_like(nothing, 1e-7), seen, surface, ""),
            None,
        )
        for name, (direction, force) in PRESSED.items()
    )
    still = Session("ball", Path("ball"), mesh, held, probings, None, None, None, (), errors=EXACT)
    fine = graded_session(halved_session(still))
    moved = [
        (observed.response.value(NU) @ np.append(observed.force, 1.0) / SHEAR).reshape(-1, 3)
        for observed in session_observations(fine, make_object_model(fine))
    ]
    return replace(
        still,
        probings=tuple(
            replace(probing, displacement=replace(probing.displacement, displacement=field))
            for probing, field in zip(probings, moved, strict=True)
        ),
    )


def _off(session: Session) -> np.ndarray:
    """Errors of nu and E over their standard errors."""
    estimate = fit_session(session).estimate
    young, ratio = estimate.young_modulus, estimate.poisson_ratio
    true = 2 * SHEAR * (1 + NU)
    return np.abs([(ratio.value - NU) / ratio.std, (young.value - true) / young.std])


def test_intervals_hold_what_a_finer_mesh_says(session: Session) -> None:
    assert (_off(session) < 1.96).all()


def test_the_steps_say_how_large_the_model_s_error_is(session: Session) -> None:
    _, plain = ungraded_observations(session)
    stepped = with_mesh_steps(session, plain)
    graded = graded_session(session)
    model = make_object_model(graded)
    first, other = (
        fit(converged_observations(graded, model, coarser=seen)).estimate.young_modulus
        for seen in (plain, stepped)
    )
    assert other.std > first.std
    assert abs(other.value - first.value) < 2.0 * other.std


def test_sharp_edges_are_a_step_of_their_own(session: Session) -> None:
    assert [len(observed.nuisances) for observed in _stepped(session)] == [1, 1, 1]
    block = _block()
    _, plain = ungraded_observations(block)
    _, refined = ungraded_observations(edge_refined_session(block))
    (seen,) = _stepped(block)
    between, edges = seen.nuisances
    assert between.parameters != edges.parameters
    rows, load = np.arange(seen.displacement.size), np.append(seen.force, 1.0) / SHEAR
    column = columns_of(edges, plain[0].response.value(NU)[rows], load, NU, rows)[:, 0]
    given, finer = (observed[0].response.value(NU)[rows] @ load for observed in (plain, refined))
    np.testing.assert_allclose(column, finer - given, atol=1e-9 * np.abs(given).max())
    assert np.abs(column).max() > 1e-4 * np.abs(given).max()


def _stepped(session: Session) -> list[ProbeObservations]:
    return with_mesh_steps(session, ungraded_observations(session)[1])


def _block() -> Session:
    """A glued cube of 3 cm, pushed aside on its top."""
    mesh = box((0.03, 0.03, 0.03), 4)
    held = np.flatnonzero(mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < 1e-9)
    points = np.array([[0.0, 0.01, 0.03], [0.02, 0.0, 0.02], [0.03, 0.03, 0.01]])
    surface = closest_points(mesh, points)
    field = DisplacementField(points, np.zeros((3, 3)), None, None, surface, "")
    contact = Contact(np.array([0.015, 0.015, 0.03]), 0.008, "smooth")
    push = np.array([0.3, 0.0, -0.5])
    probing = Probing("n", contact, push, np.zeros(3), None, None, field, None)
    return Session("block", Path("b"), mesh, held, (probing,), None, None, None, (), errors=EXACT)


def test_very_fine_meshes_have_none(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    _, seen = ungraded_observations(session)
    monkeypatch.setattr(mesh_errors, "LARGEST_DENSE", len(session.mesh.vertices) - 1)
    assert with_mesh_steps(session, seen) == seen

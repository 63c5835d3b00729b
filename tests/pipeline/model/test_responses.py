"""Responses of a probing: reduced against full, dips between vertices, slopes, gravity."""

import gc
from dataclasses import replace

import numpy as np
import pytest
from elastic_bodies import bump_load, held_part
from scipy.sparse import csr_array, hstack, kron
from surfaces import sphere

from palpate.bem import (
    body_force_columns,
    dilation_factor,
    factorise,
    load_right_hand,
    make_reduced_model,
    solve,
)
from palpate.bem.loads.right_hand import joined
from palpate.bem.reduced_model import ReducedModel
from palpate.geometry import interpolation_matrix
from palpate.pipeline.model.object_model import ObservationMatrix
from palpate.pipeline.model.responses import ProbeResponse, full_responses, reduced_responses

TOP = np.array([0.0, 0.0, 1.0])
RANGE = (0.0, 0.4999)
GRAVITY = np.array([0.5, 0.0, -3.0])


@pytest.fixture(scope="module")
def setting():
    """Ball pressed on top and on one side, with its weight; five points are seen."""
    mesh = sphere(2)
    system = held_part(mesh, mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.3)
    loads = [bump_load(mesh, np.array([0.6, 0.0, 0.8]), 0.5), bump_load(mesh, TOP, 0.5)]
    body = body_force_columns(system, GRAVITY)
    right = joined([load_right_hand(system, loads), body.right])
    columns = np.array([3, 4, 5, 6, 7])
    free = system.unknowns.free_vertices
    triangle = np.flatnonzero(np.isin(mesh.triangles, free).all(axis=1))[[2, 9, 20, 33, 40]]
    barycentric = np.random.default_rng(0).dirichlet([1, 1, 1], 5)
    at_points = interpolation_matrix(system.surface.displacement, triangle, barycentric)
    surface = kron(at_points[:, free], np.eye(3))
    rest = csr_array((15, system.size - 3 * free.size))
    rows = ObservationMatrix(
        columns,
        csr_array(hstack([surface, rest])),
        1e-3 * np.random.default_rng(1).normal(size=(2, 15, 5)),
        (at_points @ body.particular).ravel(),
        5,
        has_body_force=True,
    )
    return system, right, body, rows, at_points


def _exact(system, right):
    return lambda nu: solve(factorise(system, nu), right.at(nu))


@pytest.fixture(scope="module")
def responses(setting):
    system, right, _, rows, _ = setting
    return (
        full_responses(_exact(system, right), [rows])[0],
        reduced_responses(make_reduced_model(system, right), [rows], RANGE)[0],
    )


@pytest.mark.parametrize("nu", [0.0, 0.2, 0.499])
def test_full_response_is_what_the_solver_says(setting, responses, nu):
    system, right, body, rows, at_points = setting
    x = solve(factorise(system, nu), right.at(nu))[:, rows.columns]
    count = 3 * system.unknowns.free_vertices.size
    nodal = np.zeros((system.surface.mesh.vertices.shape[0], 3, 5))
    nodal[system.unknowns.free_vertices] = x[:count].reshape(-1, 3, 5)
    factor = dilation_factor(nu)
    nodal[:, :, 4] += body.particular
    missed = rows.indentation[0] + nu * rows.indentation[1]
    every = (at_points @ nodal.reshape(-1, 15)).reshape(15, 5) + missed
    expected = np.column_stack([every[:, :3], every[:, 3] + factor * every[:, 4]])
    np.testing.assert_allclose(responses[0].value(nu), expected, atol=1e-10)


@pytest.mark.parametrize("nu", [0.0, 0.1, 0.3, 0.45, 0.4999])
def test_reduced_response_is_the_full_one(responses, nu):
    full, reduced = (response.value(nu) for response in responses)
    # The reduced space leaves a residual of 1e-8, and ten times that as an error.
    np.testing.assert_allclose(reduced, full, atol=3e-7 * np.abs(full).max())


@pytest.mark.parametrize("nu", [0.0, 0.07, 0.31, 0.4999])
def test_series_is_what_the_reduced_model_says(setting, nu):
    system, right, _, rows, _ = setting
    model = make_reduced_model(system, right)
    # In another unit: what is left out is relative.
    surface = 1e-6 * rows.surface
    bare = replace(rows, surface=surface)
    weights = model.coefficients(nu)[0][:, rows.columns]
    solution = sum(w * x for w, x in zip(weights, model.basis(rows.columns), strict=True))
    expected = surface @ solution
    block = reduced_responses(model, [bare], RANGE)[0].blocks(nu)[0][: len(expected)]
    # Terms below 3e-8 are left out, and the others are kept in single precision.
    np.testing.assert_allclose(block, expected, atol=1e-7 * np.abs(expected).max())


def _models_with_directions():
    gc.collect()
    # The type itself: to ask a weak reference for its class fails where its object has gone.
    models = [item for item in gc.get_objects() if type(item) is ReducedModel]
    return sum(len(model.directions) > 0 for model in models)


@pytest.mark.slow
def test_a_response_holds_neither_directions_nor_matrix(setting):
    system, right, _, rows, _ = setting
    # Other tests may hold models of their own.
    before = _models_with_directions()
    model = make_reduced_model(system, right)
    response = reduced_responses(model, [rows], RANGE)[0]
    assert _models_with_directions() == before + 1
    del model
    assert _models_with_directions() == before
    assert rows.surface.nnz > response.rows.surface.nnz == 0
    assert np.isfinite(response.value(0.2)).all()


def test_the_derivative_by_the_compliance_of_a_support():
    """The response is linear in the solutions, and they in the compliance, where no support is
    pulled."""
    rng = np.random.default_rng(2)
    surface, indentation = csr_array(rng.normal(size=(6, 8))), rng.normal(size=(2, 6, 3))
    rows = ObservationMatrix(np.arange(3), surface, indentation, np.zeros(6), 2)
    blocks = np.stack([rows.observed(rng.normal(size=(8, 3))) for _ in range(3)])
    response = ProbeResponse(rows, lambda _: blocks)
    for support in range(2):
        derivative = response.compliance_derivative(0.3, support)
        np.testing.assert_allclose(derivative[:, :3], blocks[1 + support, :6], rtol=1e-9)


def test_without_gravity_the_last_column_is_zero(setting):
    system, right, _, rows, _ = setting
    indentation = rows.indentation[:, :, :3]
    bare = ObservationMatrix(rows.columns[:3], rows.surface, indentation, rows.particular, 5)
    for response in (
        full_responses(_exact(system, right), [bare])[0],
        reduced_responses(make_reduced_model(system, right), [bare], RANGE)[0],
    ):
        value = response.value(0.3)
        assert value.shape == (15, 4)
        assert not value[:, 3].any()
        assert value[:, :3].any()

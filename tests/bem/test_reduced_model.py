"""The reduced model against new factorisations."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from elastic_bodies import bump_load, held_part
from surfaces import box, sphere

from palpate.bem import (
    CENTRE,
    DENSE_RESIDUAL,
    CentredSystem,
    SurfaceLoad,
    body_force_columns,
    factorise,
    load_right_hand,
    make_reduced_model,
    reduced_model as module,
    solve,
    support_columns,
)
from palpate.bem.loads.right_hand import joined
from palpate.checkpoints import Checkpoints
from palpate.errors import NotConvergedError, SingularSystemError
from palpate.geometry import TriangleMesh

RATIOS = (-0.2, 0.0, 0.15, 0.3, 0.45, 0.4999)


@pytest.fixture(scope="module")
def problem():
    mesh = sphere(2)
    system = held_part(mesh, mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.3)
    load = bump_load(mesh, np.array([0.0, 0.0, 1.0]), 0.5)
    weight = body_force_columns(system, np.array([0.0, 0.0, -3.0]))
    lifted = support_columns(system, np.tile([[0.0], [0.0], [1.0]], (len(mesh.vertices), 1, 1)))
    quadratic = type(lifted)(np.stack([*lifted.terms[:2], 0.3 * weight.right.terms[0, :, :1]]))
    return system, joined([load_right_hand(system, [load]), weight.right, quadratic])


@pytest.fixture(scope="module")
def model(problem):
    return make_reduced_model(*problem)


def solution(model, nu, columns=slice(None)):
    weights, residual = model.coefficients(nu)
    wanted = np.arange(len(model.start))[columns]
    return np.einsum(
        "jc,jkc->kc", weights[:, columns], np.stack(list(model.basis(wanted)))
    ), residual


def true_solution(problem, nu):
    system, right = problem
    return solve(factorise(system, nu), right.at(nu))


# The space serves [0, 0.5), its residual 1e-8 at the ends; outside it is poorer.
TOLERANCE = dict(zip(RATIOS, (1e-4, 1e-7, 1e-9, 1e-12, 1e-8, 1e-7), strict=True))


@pytest.mark.parametrize("nu", RATIOS)
def test_solution_at_every_poisson_ratio(problem, model, nu):
    solved, _ = solution(model, nu)
    exact = true_solution(problem, nu)
    error = np.linalg.norm(solved - exact, axis=0) / np.linalg.norm(exact, axis=0)
    assert error.max() < TOLERANCE[nu]


def test_the_residual_tells_where_it_is_poor(problem, model):
    for nu in (nu for nu in RATIOS if nu != 0.3):
        solved, residual = solution(model, nu)
        exact = true_solution(problem, nu)
        error = (np.linalg.norm(solved - exact, axis=0) / model.scale).max()
        # Residual and error differ by the condition between two neighbouring matrices, K(nu0)^-1
        # K(nu).
        assert residual > 0.02 * error
        assert residual < 1e-2


def test_directions_are_added_until_the_whole_range_is_served(problem, model):
    wide = make_reduced_model(*problem, poisson_range=(-0.9, 0.4999))
    assert len(wide.directions) > len(model.directions)
    # The residual is held under 1e-8; far from the centre the error is up to 50 times as large.
    for nu in (-0.9, -0.4, 0.48):
        solved, residual = solution(wide, nu)
        exact = true_solution(problem, nu)
        assert residual <= 1e-8
        assert np.abs(solved - exact).max() < 5e-7 * np.abs(exact).max()


def test_columns_are_solved_for_in_slices(problem, model, monkeypatch):
    # The last slice is not full.
    monkeypatch.setattr(module, "MODEL_COLUMNS", problem[1].terms.shape[2] - 1)
    sliced = make_reduced_model(*problem)
    for nu in (0.0, 0.4999):
        expected, _ = solution(model, nu)
        # Rounding, times what it grows by in the Krylov space.
        np.testing.assert_allclose(solution(sliced, nu)[0], expected, atol=1e-10)


def test_no_more_is_kept_than_each_column_needs(problem):
    tolerance = np.full(problem[1].terms.shape[2], DENSE_RESIDUAL)
    tolerance[::2] = 1e-3
    mixed = make_reduced_model(*problem, tolerance=tolerance)
    column_sets = [set(columns.tolist()) for columns in mixed.columns]
    assert [direction.shape[1] for direction in mixed.directions] == [
        len(columns) for columns in column_sets
    ]
    assert column_sets[0] == set(range(len(tolerance)))
    assert all(later <= earlier for earlier, later in pairwise(column_sets))
    assert column_sets[-1] <= set(range(1, len(tolerance), 2))


def test_each_column_has_the_directions_that_it_needs(problem, model):
    """Every other column is wanted to 1e-3 only: it ends sooner, the rest is as it was."""
    system, right = problem
    tolerance = np.full(right.terms.shape[2], DENSE_RESIDUAL)
    tolerance[::2] = 1e-3
    mixed = make_reduced_model(system, right, tolerance=tolerance)
    every = np.arange(len(tolerance))
    used = np.array([np.any(vectors != 0.0, axis=0) for vectors in mixed.basis(every)]).sum(axis=0)
    assert used[::2].max() < used[1::2].min()
    for nu in (0.0, 0.2, 0.4999):
        solved, _ = solution(mixed, nu)
        exact = true_solution(problem, nu)
        error = np.linalg.norm(solved - exact, axis=0) / np.linalg.norm(exact, axis=0)
        residual = mixed.weights(nu)[1]
        # As above: residual and error differ by the condition between two neighbouring matrices.
        assert (residual <= tolerance).all()
        assert (error < 100.0 * tolerance).all()
        np.testing.assert_allclose(solved[:, 1::2], solution(model, nu)[0][:, 1::2], atol=1e-7)
    assert error[::2].max() > 1e-6


def test_thin_sheets_are_served_too():
    """Elements five times as long as thick: eigenvalues of the system lie close to nu = 0.5."""
    mesh = box(size=(0.1, 0.02, 0.001), cells=(20, 4, 1))
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    system = held_part(mesh, middle[:, 0] < 1e-9)
    load = SurfaceLoad(np.flatnonzero(middle[:, 0] > 0.1 - 1e-9), lambda t, b, p: np.ones(len(t)))
    thin = system, load_right_hand(system, [load])
    model = make_reduced_model(*thin)
    for nu in (0.0, 0.45, 0.4999):
        solved, _ = solution(model, nu)
        exact = true_solution(thin, nu)
        error = np.linalg.norm(solved - exact, axis=0) / np.linalg.norm(exact, axis=0)
        # A sheet's compliance makes up to 1000 times the residual of 1e-8.
        assert error.max() < 1e-5


def test_a_range_that_cannot_be_served_is_refused(problem):
    with pytest.raises(NotConvergedError, match="narrow the range"):
        make_reduced_model(*problem, poisson_range=(-0.999, 0.4999), tolerance=1e-30)


def test_columns_can_be_asked_for_alone(model):
    whole, _ = solution(model, 0.41)
    some, _ = solution(model, 0.41, np.array([4, 1]))
    np.testing.assert_allclose(some, whole[:, [4, 1]], rtol=1e-12, atol=1e-12)


def test_at_the_centre_it_is_the_factorised_solution(problem, model):
    solved, _ = solution(model, 0.3)
    np.testing.assert_allclose(solved, true_solution(problem, 0.3), rtol=1e-9, atol=1e-9)


def test_an_object_that_is_not_held_is_refused():
    """Two balls, only one of them held: the other floats."""
    ball = sphere(1)
    count = len(ball.vertices)
    both = TriangleMesh(
        np.concatenate([ball.vertices, ball.vertices + np.array([3.0, 0.0, 0.0])]),
        np.concatenate([ball.triangles, ball.triangles + count]),
    )
    low = both.vertices[both.triangles].mean(axis=1)[:, 2] < -0.3
    first = np.arange(len(both.triangles)) < len(ball.triangles)
    load = bump_load(both, np.array([0.0, 0.0, 1.0]), 0.9)
    system = held_part(both, low & first, smooth=False)
    with pytest.raises(SingularSystemError, match="singular"):
        make_reduced_model(system, load_right_hand(system, [load]))
    system = held_part(both, low, smooth=False)
    assert len(make_reduced_model(system, load_right_hand(system, [load])).directions) >= 10


def test_a_reduced_model_is_kept_for_its_loads(problem, tmp_path, monkeypatch):
    system, right = problem
    cached = replace(system, checkpoints=Checkpoints(tmp_path, "the body"))
    factors = CentredSystem(cached, CENTRE)
    first = make_reduced_model(factors, right)
    # What the system alone determines serves other loads; factors of one model alone are not kept.
    other = replace(right, terms=2.0 * right.terms)
    make_reduced_model(cached, other)
    assert len(list(tmp_path.iterdir())) == 3
    monkeypatch.setattr(module, "solve", None)
    for read, loads in ((make_reduced_model(CentredSystem(cached, CENTRE), right), 1.0),
                        (make_reduced_model(cached, other), 2.0)):  # fmt: skip
        for nu in RATIOS:
            solved, wanted = solution(read, nu)[0], solution(first, nu)[0]
            np.testing.assert_array_equal(solved, loads * wanted)
    for changes in ({"tolerance": 1e-5}, {"poisson_range": (0.0, 0.4)}):
        with pytest.raises(TypeError):
            make_reduced_model(cached, right, **changes)
    with pytest.raises(TypeError):
        make_reduced_model(CentredSystem(cached, CENTRE, single=True), right)

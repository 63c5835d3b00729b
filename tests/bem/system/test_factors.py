"""Supports that hold some directions only, against exact linear fields and their own algebra."""

import os

import numpy as np
import pytest
from elastic_bodies import Material, cube_with_faces, element_traction, held_part, linear_field
from scipy.linalg import lu_factor, lu_solve
from surfaces import box, sphere

from palpate.bem import (
    CentredSystem,
    body_force_columns,
    boundary_system,
    dilation_factor,
    face_columns,
    factorise,
    make_surface,
    solve,
    support_columns,
    unrestrained_motions,
)
from palpate.bem.integrals.surface import Quadrature
from palpate.bem.loads.right_hand import traction_column
from palpate.bem.system import factors
from palpate.bem.system.factors import lu_by_panels
from palpate.bem.system.matrix import matrix_and_slope, system_matrix

FINE = Quadrature(tolerance=1e-9)
MESH, FACE = cube_with_faces(2)
NORMALS = np.repeat(np.eye(3), 2, axis=0) * np.array([-1, 1, -1, 1, -1, 1])[:, None]
GENERAL = np.array([[0.1, 0.4, -0.2], [-0.3, 0.2, 0.5], [0.6, 0.0, -0.1]])


def along(*directions):
    """Projector onto what some directions span."""
    basis, _ = np.linalg.qr(np.array(directions, dtype=float).T)
    return basis @ basis.T


X, Y, Z, ALL = along([1, 0, 0]), along([0, 1, 0]), along([0, 0, 1]), np.eye(3)
# Held faces (2 axis + 1 on the far side) with their projectors, and how many motions are left.
SUPPORTS = {
    "a bed": ({4: Z}, 3),
    "two platens": ({4: Z, 5: Z}, 3),
    "a corner of three": ({4: Z, 0: X, 2: Y}, 0),
    "one direction on two faces": ({4: Z, 0: Z}, 3),
    "glued beside a roller": ({4: ALL, 0: Z}, 0),
    "aslant beside two": ({4: along([1, 0, 0], [0, 1, 0]), 0: along([1, 1, 1])}, 0),
    "held all but down": ({4: along([1, 0, 0], [0, 1, 0])}, 3),
}
NU = 0.3


@pytest.fixture(scope="module", params=SUPPORTS)
def rolling(request):
    faces, left = SUPPORTS[request.param]
    held = np.flatnonzero(np.isin(FACE, list(faces)))
    surface = make_surface(MESH, held, directions=np.array([faces[f] for f in FACE[held]]))
    return boundary_system(surface, quadrature=FINE), left


def boundary_data(system, field, material):
    """Right-hand side of a known field: its tractions where nothing holds, its displacements where
    something does."""
    surface = system.surface
    given = np.eye(3) - surface.held_directions
    loaded = np.flatnonzero(given.any(axis=(1, 2)))
    traction = element_traction(surface, loaded, field) / material.shear
    traction = np.einsum("kij,kqj->kqi", given[loaded], traction)
    right = traction_column(system, loaded, traction, quadrature=FINE).at(material.poisson)
    moved = field.displacement(surface.mesh.vertices)
    return right + support_columns(system, moved[:, :, None]).at(material.poisson)


@pytest.mark.parametrize("kind", ["tension", "general"])
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49])
def test_linear_fields_between_rollers(rolling, kind, nu):
    system, left = rolling
    unknowns, material = system.unknowns, Material(2.5, nu)
    gradient = np.diag([-nu, -nu, 1.0]) if kind == "tension" else GENERAL
    field = linear_field(gradient, material)
    x = solve(factorise(system, nu), boundary_data(system, field, material))[:, 0]
    exact = field.displacement(MESH.vertices)
    solution = np.zeros_like(exact)
    solution[unknowns.held_vertices] = np.einsum(
        "hij,hj->hi", unknowns.vertex_directions, exact[unknowns.held_vertices]
    )
    count = 3 * unknowns.free_vertices.size
    solution[unknowns.free_vertices] += x[:count].reshape(-1, 3)
    unrestrained = unrestrained_motions(system.surface).reshape(exact.size, left)
    away = (solution - exact).ravel()
    away -= unrestrained @ np.linalg.lstsq(unrestrained, away, rcond=None)[0]
    # The elements hold a linear field exactly: what is left is round-off, times the condition of
    # the supports (2e-6 at worst) and the pressure that belongs to the field.
    assert np.abs(away).max() < 1e-11 * np.abs(exact).max()
    sigma = field.stress(np.zeros((1, 3)))[0]
    side_face = np.zeros(system.surface.traction.n_nodes, dtype=np.int64)
    side_face[system.surface.sides.corner.ravel()] = np.repeat(FACE, 3)
    traction = (NORMALS @ sigma)[side_face[unknowns.held_sides]]
    answered = np.einsum("sij,sj->si", unknowns.side_directions, traction)
    held = x[count:-3].reshape(-1, 3) * material.shear / system.traction_length
    assert np.abs(held - answered).max() < 1e-10 * np.abs(sigma).max()


def test_motions_that_are_left(rolling):
    system, left = rolling
    unrestrained = unrestrained_motions(system.surface)
    assert unrestrained.shape[2] == left
    held = system.unknowns.held_vertices
    # Nothing that is held moves with them, and each is rigid: no length changes.
    answered = np.einsum("hij,hjq->hiq", system.unknowns.vertex_directions, unrestrained[held])
    assert np.abs(answered).max(initial=0.0) < 1e-12
    offset = MESH.vertices[:, None] - MESH.vertices
    stretch = np.einsum("abi,abiq->abq", offset, unrestrained[:, None] - unrestrained)
    assert np.abs(stretch).max(initial=0.0) < 1e-12


def test_a_solution_does_not_slide(rolling):
    system, left = rolling
    load = traction_column(
        system, np.flatnonzero(FACE == 1), np.tile([0.0, 0.0, 1.0], (np.sum(FACE == 1), 6, 1))
    )
    x = solve(factorise(system, 0.3), load.at(0.3))[:, 0]
    free = system.unknowns.free_vertices
    moved = x[: 3 * free.size].reshape(-1, 3)
    slid = np.einsum("vi,viq->q", moved, unrestrained_motions(system.surface)[free])
    assert slid.shape == (left,)
    assert np.abs(slid).max(initial=0.0) < 1e-10 * np.abs(moved).sum()


def test_what_is_eliminated_leaves_a_solution_of_every_equation(rolling):
    """The equations that were left out, those of points inside the support, hold as well."""
    system, _ = rolling
    material = Material(2.5, 0.3)
    right = boundary_data(system, linear_field(GENERAL, material), material)
    x = solve(factorise(system, 0.3), right)
    left = system_matrix(system, 0.3) @ x - right
    # Balances of force that no support answers are not equations of the object.
    assert np.abs(left[:-3]).max() < 1e-10 * np.abs(right).max()


def test_the_slope_of_the_solution(rolling):
    """What the reduced model rests on: (K + d K') (x + d x') = b to first order."""
    system, _ = rolling
    right = boundary_data(system, linear_field(GENERAL, Material(2.5, 0.3)), Material(2.5, 0.3))
    factorised = factorise(system, 0.3)
    x = solve(factorised, right)
    slope = solve(factorised, -matrix_and_slope(system, 0.3)[1].apply(x))
    step = 1e-4
    higher, lower = (solve(factorise(system, 0.3 + d), right) for d in (step, -step))
    # The central difference leaves the third derivative times 1e-8 / 6.
    np.testing.assert_allclose(
        (higher - lower) / (2 * step), slope, atol=1e-6 * np.abs(slope).max()
    )


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.499])
def test_a_block_that_stands_on_rollers_under_its_weight(nu):
    """On a bed without friction the stress is -weight (1 - z) along z alone, exactly."""
    material, weight = Material(40.0, nu), 7.0
    young = 2 * material.shear * (1 + nu)
    held = np.flatnonzero(FACE == 4)
    surface = make_surface(MESH, held, directions=np.tile(Z, (held.size, 1, 1)))
    system = boundary_system(surface, quadrature=FINE)
    body = body_force_columns(system, np.array([0.0, 0.0, -weight]), quadrature=FINE)
    x, y, z = (MESH.vertices - [0.5, 0.5, 0.0]).T
    down = -(z - 0.5 * z**2) + 0.5 * nu * (x**2 + y**2)
    exact = weight / young * np.column_stack([nu * (1 - z) * x, nu * (1 - z) * y, down])
    bed = support_columns(system, material.shear * exact[:, :, None])
    parts = solve(factorise(system, nu), np.hstack([body.right.at(nu), bed.at(nu)]))
    factor, count = dilation_factor(nu), 3 * system.unknowns.free_vertices.size
    displacement = (parts[:count] @ [1.0, factor, 1.0]).reshape(-1, 3) / material.shear
    displacement += factor * body.particular / material.shear
    bottom = system.unknowns.held_vertices
    displacement[bottom, 2] = exact[bottom, 2]
    unrestrained = unrestrained_motions(surface).reshape(exact.size, 3)
    away = (displacement - exact).ravel()
    away -= unrestrained @ np.linalg.lstsq(unrestrained, away, rcond=None)[0]
    # The displacement is quadratic and so are the elements: as for the glued block.
    assert np.abs(away).max() < 3e-7 * np.abs(exact).max()


@pytest.fixture
def for_small_bodies(monkeypatch):
    """Single precision at any size."""
    monkeypatch.setattr(factors, "_SMALLEST_SINGLE", 0)


def held_at_low(mesh, axis, share):
    """The system of a body held where it is low along an axis, with a load at its other end."""
    x = mesh.vertices[mesh.triangles][:, :, axis]
    held = np.flatnonzero(x.max(axis=1) < x.min() + share * np.ptp(x))
    system = boundary_system(make_surface(mesh, held))
    loaded = np.argsort(x.mean(axis=1))[-4:]
    return system, face_columns(system, loaded).at(NU)


def test_single_precision_is_good_to_a_hundred_thousandth(for_small_bodies):
    system, right = held_at_low(sphere(2), 2, 0.2)
    single, double = (CentredSystem(system, NU, single=in_single) for in_single in (True, False))
    assert single.factorised.lu.dtype == np.float32
    assert single.slope.flux.dtype == np.float32
    actual, wanted = (solve(centred.factorised, right) for centred in (single, double))
    assert actual.dtype == float
    np.testing.assert_allclose(actual, wanted, rtol=0, atol=1e-5 * np.abs(wanted).max())
    changed, change = (centred.slope.apply(wanted) for centred in (single, double))
    assert changed.dtype == float
    # Sums of some thousand products, each to 6e-8.
    np.testing.assert_allclose(changed, change, rtol=0, atol=1e-5 * np.abs(change).max())
    # It is single precision.
    assert np.abs(actual - wanted).max() > 1e-12 * np.abs(wanted).max()


def test_rollers_are_eliminated_in_single_precision(for_small_bodies):
    mesh = sphere(2)
    low = np.flatnonzero(mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.5)
    upwards = np.tile(np.diag([0.0, 0.0, 1.0]), (low.size, 1, 1))
    system = boundary_system(make_surface(mesh, low, directions=upwards))
    right = face_columns(system, np.arange(4)).at(NU)
    single, double = (
        CentredSystem(system, NU, single=in_single).factorised for in_single in (True, False)
    )
    assert single.elimination is not None
    assert single.lu.dtype == np.float32
    actual, wanted = (solve(factorised, right) for factorised in (single, double))
    np.testing.assert_allclose(actual, wanted, rtol=0, atol=1e-5 * np.abs(wanted).max())


@pytest.mark.slow
def test_a_thin_plate_is_solved_in_double_precision(for_small_bodies):
    system, right = held_at_low(box(size=(1.0, 0.6, 0.01), cells=6), 0, 0.25)
    chosen = CentredSystem(system, NU, single=True)
    assert chosen.factorised.lu.dtype == chosen.slope.flux.dtype == float
    double = CentredSystem(system, NU)
    np.testing.assert_array_equal(solve(chosen.factorised, right), solve(double.factorised, right))


def test_small_bodies_are_solved_in_double_precision():
    system, _ = held_at_low(sphere(1), 2, 0.4)
    assert CentredSystem(system, NU, single=True).factorised.lu.dtype == float


def low_part(mesh):
    """Triangles of the lower third."""
    return np.flatnonzero(mesh.vertices[mesh.triangles].mean(axis=1)[:, 2] < -0.4)


def on_rollers(mesh):
    """The same part, held upwards only."""
    held = low_part(mesh)
    return make_surface(mesh, held, directions=np.tile(np.diag([0, 0, 1.0]), (held.size, 1, 1)))


@pytest.fixture(scope="module")
def ball():
    mesh = sphere(1)
    return make_surface(mesh, low_part(mesh))


def factor_values(ball, folder, **options):
    return CentredSystem(boundary_system(ball, cache=folder, **options), NU).factorised.lu


@pytest.mark.parametrize("rolls", [False, True])
def test_factors_are_read_by_the_next_system_of_the_same_body(ball, rolls, tmp_path, monkeypatch):
    body = on_rollers(ball.mesh) if rolls else ball
    first = CentredSystem(boundary_system(body, cache=tmp_path), NU)
    assert (first.factorised.elimination is not None) == rolls
    monkeypatch.setattr(factors, "_factorise_with_slope", None)
    again = CentredSystem(boundary_system(body, cache=tmp_path), NU)
    vector = np.random.default_rng(0).normal(size=(first.system.size, 3))
    moved = matrix_and_slope(first.system, 0.3)[1].apply(vector)
    solved = solve(factorise(first.system, NU), moved)
    for centred in (first, again):
        np.testing.assert_array_equal(centred.slope.apply(vector), moved)
        np.testing.assert_array_equal(solve(centred.factorised, moved), solved)
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("damage", [lambda content: b"", lambda content: content[:1000]])
def test_a_file_that_is_not_as_it_was_written_is_computed_anew(ball, tmp_path, damage):
    computed = factor_values(ball, tmp_path)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    np.testing.assert_array_equal(factor_values(ball, tmp_path), computed)
    # And kept in its place.
    assert path.read_bytes() == whole


def test_all_that_matters_makes_another_file(ball, tmp_path):
    mesh, held = ball.mesh, low_part(ball.mesh)
    flat = make_surface(mesh, held, smooth=False)
    bodies = [ball, flat, make_surface(mesh, held[1:]), on_rollers(mesh)]
    for count, body in enumerate(bodies):
        values = factor_values(body, tmp_path)
        assert len(list(tmp_path.iterdir())) == count + 1
        np.testing.assert_array_equal(values, factor_values(body, None))
    factor_values(ball, tmp_path, quadrature=Quadrature(tolerance=1e-4))
    assert len(list(tmp_path.iterdir())) == len(bodies) + 1


def test_a_place_that_cannot_be_written_keeps_nothing(ball, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    np.testing.assert_array_equal(factor_values(ball, blocked), factor_values(ball, None))


def test_what_lies_in_the_place_of_the_cache_and_is_no_file_is_not_read(ball, tmp_path):
    """Reading a pipe would wait for ever."""
    values = factor_values(ball, tmp_path)
    (path,) = tmp_path.iterdir()
    path.unlink()
    os.mkfifo(path)
    np.testing.assert_array_equal(factor_values(ball, tmp_path), values)


@pytest.mark.parametrize("other", [(0.2, False), (NU, True)])
def test_factors_of_another_kind_are_others(ball, other, tmp_path, monkeypatch):
    """Another ratio, or another precision (which is what it asks for, not what it comes to)."""
    held = boundary_system(ball, cache=tmp_path)
    assert CentredSystem(held, NU).factorised.poisson_ratio == NU
    monkeypatch.setattr(factors, "_SMALLEST_SINGLE", 0)
    factorised = CentredSystem(held, *other).factorised
    assert factorised.poisson_ratio == other[0]
    assert factorised.lu.dtype == (np.float32 if other[1] else np.float64)


@pytest.mark.parametrize(
    ("size", "panel", "chunk"), [(1, 4, 4), (50, 7, 9), (64, 16, 16), (60, 80, 8), (51, 50, 1)]
)
def test_the_same_factors_as_lapack(size, panel, chunk):
    matrix = np.asfortranarray(np.random.default_rng(size).normal(size=(size, size)))
    expected, order = lu_factor(matrix)
    lu, pivots = lu_by_panels(matrix, panel=panel, chunk=chunk)
    assert lu is matrix
    assert np.array_equal(pivots, order)
    # Sums of up to 64 products in another order; no growth beyond a factor of ten.
    np.testing.assert_allclose(lu, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("kind", "error"), [(np.float64, 1e-11), (np.float32, 1e-3)])
def test_what_it_gives_solves(kind, error):
    rng = np.random.default_rng(1)
    matrix, right = rng.normal(size=(90, 90)).astype(kind), rng.normal(size=(90, 3)).astype(kind)
    lu, pivots = lu_by_panels(np.asfortranarray(matrix), panel=32, chunk=20)
    assert lu.dtype == kind
    # Rounding (1e-16, 6e-8) times 90 terms and the condition of the matrix, some hundreds.
    np.testing.assert_allclose(matrix @ lu_solve((lu, pivots), right), right, atol=error)


def test_large_systems_take_it(monkeypatch):
    mesh, face = cube_with_faces(2)
    system = held_part(mesh, face == 4)
    right = np.random.default_rng(2).normal(size=(system.size, 2))
    expected = solve(factorise(system, 0.3), right)
    taken = []

    def panels(matrix):
        taken.append(len(matrix))
        return lu_by_panels(matrix, panel=32)

    monkeypatch.setattr(factors, "lu_by_panels", panels)
    monkeypatch.setattr(factors, "_LARGEST_WHOLE", system.size - 1)
    np.testing.assert_allclose(
        solve(factorise(system, 0.3), right), expected, atol=1e-10 * np.abs(expected).max()
    )
    assert taken == [system.size]

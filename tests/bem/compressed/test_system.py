"""The compressed system against the dense one: its matrix, its right-hand sides, its solutions."""

import numpy as np
import pytest

from benchmarks.meshes import cube
from palpate.bem import (
    Compression,
    Quadrature,
    SurfaceSettings,
    boundary_system,
    compressed_system,
    face_columns,
    factorise,
    held_system,
    joined,
    make_elastic_map,
    make_reduced_model,
    make_springs,
    make_surface,
    reduced_basis,
    solve,
    support_columns,
    system_slope,
)
from palpate.bem.compressed import choice
from palpate.bem.compressed.preconditioner import cluster_inverse, solve_compressed
from palpate.bem.compressed.system import CompressedSystem
from palpate.bem.system.matrix import system_matrix
from palpate.errors import InputError

# The operator's own error of 1e-7, made larger by the condition of a beam that bends, some tens.
CLOSE = 1e-5


@pytest.fixture(scope="module")
def right(compressed):
    surface = compressed.surface
    middle = surface.mesh.vertices[surface.mesh.triangles].mean(axis=1)
    end = np.flatnonzero(middle[:, 0] > 5.0 - 1e-9)
    turn = np.cross(surface.mesh.vertices, [0.3, 0.2, 1.0])[:, :, None]
    return joined([face_columns(compressed, end), support_columns(compressed, turn)])


def unknown_vectors(system):
    return np.random.default_rng(0).normal(size=(system.size, 3))


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.4999])
def test_the_product_is_that_of_the_matrix(dense, compressed, nu):
    x = unknown_vectors(dense)
    wanted = system_matrix(dense, nu) @ x
    # The operator's error (`test_operator`).
    assert np.abs(compressed.product(nu, x) - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_the_slope_is_that_of_the_matrix(dense, compressed):
    x = unknown_vectors(dense)
    wanted = system_slope(dense).apply(x)
    assert np.abs(compressed.slope_product(x) - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_given_displacements_are_those_of_the_dense_system(dense, compressed):
    turn = np.cross(dense.surface.mesh.vertices, [0.3, 0.2, 1.0])[:, :, None]
    wanted, found = (support_columns(one, turn).terms for one in (dense, compressed))
    assert np.abs(found - wanted).max() < 1e-6 * np.abs(wanted).max()


@pytest.mark.parametrize("nu", [0.1, 0.4999])
def test_solutions_are_those_of_the_dense_system(dense, compressed, right, nu):
    found = solve_compressed(cluster_inverse(compressed, nu, max_points=128), right.at(nu))
    wanted = solve(factorise(dense, nu), right.at(nu))
    first = 3 * compressed.unknowns.free_vertices.size
    # The support that turns takes the body with it: no traction, the last column.
    for part in (np.s_[:first], np.s_[first:-3, :3]):
        error = np.abs(found.solution[part] - wanted[part]).max(axis=0)
        assert (error < CLOSE * np.abs(wanted[part]).max(axis=0)).all()
    # Many more would mean that the clusters' own equations are of no use.
    assert found.iterations < 50


def test_a_few_solutions_serve_every_ratio(compressed, dense, right):
    basis = reduced_basis(compressed, right.terms, poisson_range=(0.1, 0.45), tolerance=1e-6)
    for nu in (0.1, 0.23, 0.45):
        weights, residual = basis.coefficients(nu)
        assert residual <= 1e-6
        found = np.einsum("jkc,jc->kc", np.stack(basis.directions), weights)
        wanted = solve(factorise(dense, nu), right.at(nu))
        free = slice(0, 3 * compressed.unknowns.free_vertices.size)
        error = np.abs(found - wanted)[free].max(axis=0)
        # The residual that is allowed, times the condition.
        assert (error < 1e-4 * np.abs(wanted[free]).max(axis=0)).all()


@pytest.mark.slow
def test_the_residual_that_is_asked_for_decides_how_many_solutions_are_made(compressed, right):
    loose, tight = (
        make_reduced_model(compressed, right, poisson_range=(0.1, 0.45), tolerance=residual)
        for residual in (1e-3, 1e-6)
    )
    assert len(loose.ratios) < len(tight.ratios)
    assert max(loose.coefficients(nu)[1] for nu in np.linspace(0.1, 0.45, 9)) <= 1e-3


def test_linear_elements_on_flat_facets_are_served_too(long_surface):
    flat = make_surface(
        long_surface.mesh,
        np.flatnonzero(long_surface.held),
        settings=SurfaceSettings(smooth=False, quadratic=False),
    )
    found = compressed_system(flat, compression=Compression(leaf_size=(32, 64)))
    wanted = boundary_system(flat)
    x = unknown_vectors(wanted)
    product = system_matrix(wanted, 0.3) @ x
    assert np.abs(found.product(0.3, x) - product).max() < 1e-6 * np.abs(product).max()


@pytest.mark.slow
def test_rules_of_low_degree_alone_serve_too(long_surface):
    """The far field has a rule of its own, whichever are those of the near field."""
    low = Quadrature(tolerance=1e-4, degrees=(2, 4))
    found = compressed_system(
        long_surface, compression=Compression(leaf_size=(32, 64)), quadrature=low
    )
    wanted = boundary_system(long_surface, quadrature=low)
    x = unknown_vectors(wanted)
    product = system_matrix(wanted, 0.3) @ x
    # What is far differs by the errors of both rules, each within the tolerance of an integral.
    assert np.abs(found.product(0.3, x) - product).max() < 2e-4 * np.abs(product).max()


def test_size_chooses(monkeypatch):
    mesh, face = cube(2)
    held = np.flatnonzero(face == 4)
    surface = make_surface(mesh, held)
    assert not isinstance(held_system(surface), CompressedSystem)
    monkeypatch.setattr(choice, "LARGEST_DENSE", 20)
    assert isinstance(held_system(surface), CompressedSystem)
    assert not isinstance(held_system(surface, dense=True), CompressedSystem)
    along = np.tile(np.diag([0.0, 0.0, 1.0]), (held.size, 1, 1))
    rolls = make_surface(mesh, held, directions=along)
    assert not isinstance(held_system(rolls), CompressedSystem)


def test_rollers_are_refused(long_surface):
    held = np.flatnonzero(long_surface.held)
    along = np.tile(np.diag([1.0, 0.0, 0.0]), (held.size, 1, 1))
    with pytest.raises(InputError, match="hold all directions"):
        compressed_system(make_surface(long_surface.mesh, held, directions=along))


def test_springs_are_refused(compressed):
    held = np.flatnonzero(compressed.surface.held)
    springs = make_springs(compressed, [held], np.zeros(0, dtype=np.int64))
    with pytest.raises(InputError, match="rigid supports only"):
        make_elastic_map(
            compressed, shear_modulus=1.0, poisson_ratio=0.3, springs=springs,
            compliance=np.array([1.0]),
        )  # fmt: skip

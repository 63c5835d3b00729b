"""The compressed system against the dense one: its matrix, its right-hand sides, its solutions."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.meshes import cube
from palpate.bem import (
    boundary_system,
    check_memory,
    face_columns,
    factorise,
    held_system,
    make_elastic_map,
    make_solver,
    make_springs,
    make_surface,
    solve,
    support_columns,
)
from palpate.bem.compressed import system as compressed
from palpate.bem.compressed.iterative import cluster_inverse, solve_compressed
from palpate.bem.compressed.system import CompressedSystem, compressed_system, memory_needed
from palpate.bem.integrals.surface import Quadrature
from palpate.bem.loads.right_hand import joined
from palpate.bem.reduced_model import reduced_basis
from palpate.bem.system.matrix import matrix_and_slope, system_matrix
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
    wanted = matrix_and_slope(dense, 0.3)[1].apply(x)
    assert np.abs(compressed.slope_product(x) - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_given_displacements_are_those_of_the_dense_system(dense, compressed):
    turn = np.cross(dense.surface.mesh.vertices, [0.3, 0.2, 1.0])[:, :, None]
    wanted, actual = (support_columns(system, turn).terms for system in (dense, compressed))
    assert np.abs(actual - wanted).max() < 1e-6 * np.abs(wanted).max()


@pytest.mark.parametrize("nu", [0.1, 0.4999])
def test_solutions_are_those_of_the_dense_system(dense, compressed, right, nu):
    solved = solve_compressed(cluster_inverse(compressed, nu, max_points=128), right.at(nu))
    wanted = solve(factorise(dense, nu), right.at(nu))
    first = 3 * compressed.unknowns.free_vertices.size
    # The support that turns takes the body with it: no traction, the last column.
    for part in (np.s_[:first], np.s_[first:-3, :3]):
        error = np.abs(solved.solution[part] - wanted[part]).max(axis=0)
        assert (error < CLOSE * np.abs(wanted[part]).max(axis=0)).all()
    # Many more would mean that the clusters' own equations are of no use.
    assert solved.iterations < 50


def test_a_few_solutions_serve_every_ratio(compressed, dense, right):
    basis = reduced_basis(compressed, right.terms, poisson_range=(0.1, 0.45), tolerance=1e-6)
    for nu in (0.1, 0.23, 0.45):
        weights, residual = basis.coefficients(nu)
        assert residual <= 1e-6
        solution = np.einsum("jkc,jc->kc", np.stack(basis.directions), weights)
        wanted = solve(factorise(dense, nu), right.at(nu))
        free = slice(0, 3 * compressed.unknowns.free_vertices.size)
        error = np.abs(solution - wanted)[free].max(axis=0)
        # The residual that is allowed, times the condition.
        assert (error < 1e-4 * np.abs(wanted[free]).max(axis=0)).all()


@pytest.mark.slow
def test_the_residual_that_is_asked_for_decides_how_many_solutions_are_made(compressed, right):
    loose, tight = (
        make_solver(compressed).reduced_model(right, (0.1, 0.45), residual)
        for residual in (1e-3, 1e-6)
    )
    assert len(loose.directions) < len(tight.directions)
    assert max(loose.coefficients(nu)[1] for nu in np.linspace(0.1, 0.45, 9)) <= 1e-3


def test_linear_elements_on_flat_facets_are_served_too(long_surface):
    flat = make_surface(
        long_surface.mesh,
        np.flatnonzero(long_surface.held),
        smooth=False,
        quadratic=False,
    )
    system = compressed_system(flat, leaf_size=(32, 64))
    wanted = boundary_system(flat)
    x = unknown_vectors(wanted)
    product = system_matrix(wanted, 0.3) @ x
    assert np.abs(system.product(0.3, x) - product).max() < 1e-6 * np.abs(product).max()


@pytest.mark.slow
def test_rules_of_low_degree_alone_serve_too(long_surface):
    """The far field has a rule of its own, whichever are those of the near field."""
    low = Quadrature(tolerance=1e-4, degrees=(2, 4))
    system = compressed_system(long_surface, leaf_size=(32, 64), quadrature=low)
    wanted = boundary_system(long_surface, quadrature=low)
    x = unknown_vectors(wanted)
    product = system_matrix(wanted, 0.3) @ x
    # What is far differs by the errors of both rules, each within the tolerance of an integral.
    assert np.abs(system.product(0.3, x) - product).max() < 2e-4 * np.abs(product).max()


def test_size_chooses(monkeypatch):
    mesh, face = cube(2)
    held = np.flatnonzero(face == 4)
    surface = make_surface(mesh, held)
    assert not isinstance(held_system(surface), CompressedSystem)
    monkeypatch.setattr(compressed, "LARGEST_DENSE", 20)
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


def _on_springs(system, held, load):
    """Unknowns under a load, the support giving."""
    springs = make_springs(system, [held], np.zeros(0, dtype=np.int64))
    elastic = make_elastic_map(
        system, shear_modulus=1.0, poisson_ratio=0.3, springs=springs, compliance=np.array([1.0])
    ).springs
    return elastic.solve(
        load.on_springs(elastic.compliance, elastic.compliance_derivatives).at(0.3)
    )


def test_springs_take_dense_factors_whatever_the_size(compressed, dense):
    held = np.flatnonzero(compressed.surface.held)
    load = face_columns(dense, np.flatnonzero(~compressed.surface.held)[:1])
    actual, wanted = (_on_springs(system, held, load) for system in (compressed, dense))
    # The operator's own tolerance.
    np.testing.assert_allclose(actual, wanted, atol=1e-5 * np.abs(wanted).max())


def test_a_mesh_that_fits_is_let_through():
    check_memory(2562, available=24e9)


def test_a_mesh_that_does_not_fit_is_refused():
    # 16 doubles a pair and 540 vectors: 13.3 GB for 10 000 vertices; 90 % of 8 GB hold 7200.
    with pytest.raises(InputError, match=r"10000 vertices.* 13\.3 GB.* at most 7200 vertices"):
        check_memory(10_000, available=8e9, dense=True)


def test_what_needs_no_matrices_needs_less():
    check_memory(10_000, available=8e9)
    # 150 kB a vertex and 660 vectors of three: 166 kB; 90 % of 8 GB less the program hold 41 000.
    with pytest.raises(InputError, match=r"100000 vertices.* 19\.0 GB.* at most 36500 vertices"):
        check_memory(100_000, available=8e9)


def test_where_only_dense_matrices_fit_their_size_is_offered():
    # 90 % of 1.3 GB do not hold an operator for 5001 vertices, but matrices for 2400.
    with pytest.raises(InputError, match=r"at most 2400 vertices"):
        check_memory(6000, available=1.3e9)


def test_what_is_offered_fits():
    with pytest.raises(InputError) as refused:
        check_memory(500_000, 17, available=8e9)
    offered = int(str(refused.value).split("at most ")[1].split()[0])
    check_memory(offered, 17, available=8e9)
    with pytest.raises(InputError):
        check_memory(offered + 200, 17, available=8e9)


def test_the_machine_is_asked():
    with pytest.raises(InputError, match="simplify the surface"):
        check_memory(100_000_000)


def test_a_limit_of_the_process_counts():
    code = (
        "import resource, palpate.bem as b\n"
        "resource.setrlimit(resource.RLIMIT_AS, (4 << 30,) * 2)\n"
        "try: b.check_memory(6000, dense=True)\n"
        "except b.compressed.system.InputError as e: print(e)"
    )
    src = str(Path(__file__).parents[3] / "src")
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={"PYTHONPATH": src}
    ).stdout
    assert "3.9 GB can be used here" in said


def test_every_probing_needs_memory():
    # Six columns of 3 x 1000 unknowns, 90 vectors each.
    single, two = (memory_needed(1000, count, rollers=False) for count in (1, 2))
    assert two - single == 6 * 3000 * 90 * 8


@pytest.mark.parametrize(("vertices", "peak"), [(642, 0.526e9), (2562, 1.47e9)])
def test_what_is_said_is_what_a_fit_of_17_probings_took(vertices, peak):
    """Largest resident set of `palpate fit`, by `python -m benchmarks.run --only memory`."""
    # Balls need a tenth of the 80 basis vectors that are counted.
    assert 1.0 < memory_needed(vertices, 17) / peak < 1.4


def test_further_factors_take_a_matrix_each():
    single, three = (memory_needed(1000, 1, n_factors=count) for count in (1, 3))
    # At least the nine doubles of each pair of vertices.
    assert 2 * 9 * 8e6 <= three - single < 2 * 13 * 8e6

"""Laws that every elastic map obeys."""

import numpy as np
import pytest
from elastic_bodies import bump_load, held_part
from surfaces import sphere

from palpate.bem import (
    boundary_system,
    factorise,
    make_elastic_map,
    make_surface,
    solve,
    support_columns,
)
from palpate.bem.loads.surface_load import load_points
from palpate.bem.system import factors
from palpate.errors import InputError
from palpate.geometry import TriangleMesh, closest_points, interpolation_matrix

TOP = np.array([0.0, 0.0, 1.0])
SIDE = np.array([0.6, 0.0, 0.8])


def low(mesh):
    return mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.3


@pytest.fixture(scope="module")
def system():
    mesh = sphere(3)
    return held_part(mesh, low(mesh))


@pytest.fixture(scope="module")
def elastic_map(system):
    return make_elastic_map(system, shear_modulus=50.0, poisson_ratio=0.4)


def test_the_reaction_balances_the_load(elastic_map):
    mesh = elastic_map.system.surface.mesh
    forces = np.array([[0.3, -0.2, -1.0], [-2.0, 1.0, 0.5]])
    loads = [bump_load(mesh, TOP, 0.4), bump_load(mesh, SIDE, 0.5)]
    for state, force in zip(elastic_map.respond(loads, forces), forces, strict=True):
        # An equation of the system itself: round-off times its condition.
        np.testing.assert_allclose(state.reaction, -force, atol=1e-9)
        held = elastic_map.system.unknowns.held_vertices
        assert not state.displacement[held].any()


def test_displacement_falls_with_the_shear_modulus(system, elastic_map):
    load = bump_load(system.surface.mesh, TOP, 0.4)
    force = np.array([[0.3, -0.2, -1.0]])
    stiff = make_elastic_map(system, shear_modulus=150.0, poisson_ratio=0.4)
    soft, three = (m.respond([load], force)[0] for m in (elastic_map, stiff))
    np.testing.assert_allclose(soft.displacement, 3 * three.displacement, rtol=1e-12)
    np.testing.assert_allclose(soft.support_traction, three.support_traction, rtol=1e-9, atol=1e-12)


def test_loads_add_up(elastic_map):
    load = bump_load(elastic_map.system.surface.mesh, TOP, 0.4)
    a, b = np.array([1.0, 0.0, 2.0]), np.array([0.0, -3.0, 1.0])
    u, v, both = elastic_map.respond([load] * 3, np.stack([a, b, a + b]))
    np.testing.assert_allclose(u.displacement + v.displacement, both.displacement, atol=1e-13)


def test_two_loads_do_the_same_work_on_each_other(elastic_map):
    surface = elastic_map.system.surface
    loads = [bump_load(surface.mesh, TOP, 0.5), bump_load(surface.mesh, SIDE, 0.5)]
    forces = np.array([[0.5, 0.2, -1.0], [-1.0, 0.3, 0.2]])
    states = elastic_map.respond(loads, forces)
    work = []
    for load, force, other in zip(loads, forces, states[::-1], strict=True):
        points = load_points(surface, load)
        closest = closest_points(surface.mesh, points.position)
        matrix = interpolation_matrix(surface.displacement, closest.triangle, closest.barycentric)
        work.append(points.weight @ (matrix @ other.displacement) @ force)
    # Collocation keeps Betti's law only as well as it solves: half a per cent on 258 vertices.
    np.testing.assert_allclose(work[0], work[1], rtol=1e-2)


def test_a_support_that_moves_rigidly_takes_the_object_along(system):
    vertices = system.surface.mesh.vertices
    turn = np.array([0.2, -0.5, 0.3])
    rigid = np.cross(turn, vertices) + np.array([0.4, 0.1, -0.2])
    nu = 0.45
    x = solve(factorise(system, nu), support_columns(system, rigid[:, :, None]).at(nu))[:, 0]
    count = 3 * system.unknowns.free_vertices.size
    # Translations are exact by the rigid-body sum; a rotation is linear, held by the curved
    # elements as well as their positions are: what is left is the integrals' tolerance.
    free = rigid[system.unknowns.free_vertices]
    np.testing.assert_allclose(x[:count].reshape(-1, 3), free, atol=1e-8)
    assert np.abs(x[count:-3]).max() < 1e-7


def test_the_frame_does_not_matter(elastic_map):
    surface = elastic_map.system.surface
    q, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    q *= np.sign(np.linalg.det(q))
    turned = TriangleMesh(surface.mesh.vertices @ q.T + 2.0, surface.mesh.triangles)
    other = make_elastic_map(held_part(turned, surface.held), shear_modulus=50.0, poisson_ratio=0.4)
    force = np.array([0.3, -0.2, -1.0])
    (here,) = elastic_map.respond([bump_load(surface.mesh, SIDE, 0.5)], force[None])
    (there,) = other.respond([bump_load(turned, q @ SIDE + 2.0, 0.5)], (q @ force)[None])
    # Points fall into other blocks, which may use other rules of the same tolerance.
    scale = np.abs(here.displacement).max()
    np.testing.assert_allclose(there.displacement, here.displacement @ q.T, atol=1e-4 * scale)


@pytest.mark.parametrize(("shear", "nu"), [(-1.0, 0.3), (1.0, 0.6)])
def test_impossible_constants_are_refused(system, shear, nu):
    with pytest.raises(InputError, match="must be"):
        make_elastic_map(system, shear_modulus=shear, poisson_ratio=nu)


def test_the_next_map_of_the_same_object_and_material_factorises_nothing(tmp_path, monkeypatch):
    mesh = sphere(1)
    surface = make_surface(mesh, np.flatnonzero(low(mesh)))
    system = boundary_system(surface, cache=tmp_path)
    first = make_elastic_map(system, shear_modulus=2e4, poisson_ratio=0.3)
    monkeypatch.setattr(factors, "_factorise_with_slope", None)
    again = boundary_system(surface, cache=tmp_path)
    # Another modulus scales the same factors.
    other = make_elastic_map(again, shear_modulus=4e4, poisson_ratio=0.3)
    right = np.ones((system.size, 1))
    np.testing.assert_array_equal(other.solve(right), first.solve(right))

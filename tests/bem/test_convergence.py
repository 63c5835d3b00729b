"""Order of convergence on a manufactured field, and near incompressibility."""

import numpy as np
import pytest
from elastic_bodies import Material, held_part, point_source, solve_known
from surfaces import sphere

SOURCE, FORCE = np.array([0.4, -0.5, 1.7]), np.array([1.0, 2.0, -1.5])
LEVELS = (2, 3, 4)


@pytest.fixture(scope="module")
def balls():
    out = []
    for level in LEVELS:
        mesh = sphere(level)
        out.append(held_part(mesh, mesh.vertices[mesh.triangles][:, :, 2].mean(axis=1) < -0.6))
    return out


def error(system, nu):
    material = Material(1.0, nu)
    field = point_source(SOURCE, FORCE, material)
    displacement, _ = solve_known(system, field, material)
    exact = field.displacement(system.surface.mesh.vertices)
    return np.linalg.norm(displacement - exact) / np.linalg.norm(exact)


def test_displacement_converges_faster_than_second_order(balls):
    errors = [error(system, 0.3) for system in balls]
    order = -np.polyfit(LEVELS, np.log2(errors), 1)[0]
    # Quadratic elements of fitted midpoints: third order expected (3.4 to 3.6 here); linear
    # elements reach two.
    assert order > 3
    # 66 to 1026 vertices; the finest was at 5e-5.
    assert errors[-1] < 1e-4


@pytest.mark.slow
def test_linear_elements_on_facets_converge_to_second_order():
    errors = []
    for level in LEVELS:
        mesh = sphere(level)
        held = mesh.vertices[mesh.triangles][:, :, 2].mean(axis=1) < -0.6
        errors.append(error(held_part(mesh, held, smooth=False, quadratic=False), 0.3))
    order = -np.polyfit(LEVELS, np.log2(errors), 1)[0]
    # Second order is what the paper's elements are known for: this is how far ours are ahead.
    assert 1.6 < order < 2.6


@pytest.mark.slow
def test_nearly_incompressible_is_no_harder(balls):
    assert error(balls[-1], 0.499) < 1.5 * error(balls[-1], 0.45)

"""The known indentation under a tool corrects coarse elements."""

from dataclasses import replace

import numpy as np
import pytest
from elastic_bodies import held_part
from surfaces import box, sphere

from palpate.bem import (
    PressureDisc,
    SurfaceLoad,
    factorise,
    indentation_corrections,
    load_right_hand,
    missed_indentation,
    solve,
)
from palpate.bem.elastic_map import sorted_state
from palpate.bem.loads.local_indentation import correction_columns
from palpate.bem.system.matrix import system_matrix
from palpate.geometry import closest_points, interpolation_matrix

TOP = np.array([0.0, 0.0, 1.0])
RADIUS = 0.25
NU = 0.3
# A quarter from the edge x = 1 of a unit cube.
BESIDE_EDGE = np.array([0.75, 0.5, 1.0])


def smooth(s):
    return np.clip(1 - s**2, 0, None) ** 2


def top_load(mesh, point=TOP, radius=RADIUS):
    reach = np.linalg.norm(mesh.vertices[mesh.triangles] - point, axis=2).min(axis=1)
    triangles = np.flatnonzero(reach < 2 * radius)

    def density(triangle, barycentric, position):
        return smooth(np.linalg.norm(position - point, axis=1) / radius)

    return SurfaceLoad(triangles, density, PressureDisc(point, radius, smooth))


def ball(subdivisions, **options):
    mesh = sphere(subdivisions)
    return held_part(mesh, mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.3, **options)


def pressed(system, *, corrected):
    load = top_load(system.surface.mesh)
    (local,) = indentation_corrections(system.surface, [load]) if corrected else [None]
    return moved_by(system, load, local)


def moved_by(system, load, *corrections):
    """Displacement of the vertices under a load, corrected for its dip unless told otherwise."""
    right = load_right_hand(
        system, [load], corrections or indentation_corrections(system.surface, [load])
    )
    x = solve(factorise(system, NU), right.at(NU)) @ PUSH
    return sorted_state(system, x, 1.0).displacement


@pytest.fixture(scope="module")
def fine():
    system = ball(4)
    return system.surface.mesh.vertices, pressed(system, corrected=True)


@pytest.fixture(scope="module")
def coarse():
    return ball(2)


def test_the_correction_brings_a_coarse_mesh_closer_to_a_fine_one(fine, coarse):
    vertices, reference = fine
    coarse_vertices = coarse.surface.mesh.vertices
    same = np.linalg.norm(coarse_vertices[:, None] - vertices[None], axis=2).argmin(axis=1)
    exact = reference[same]
    with_correction, without = (
        np.linalg.norm(pressed(coarse, corrected=corrected) - exact) / np.linalg.norm(exact)
        for corrected in (True, False)
    )
    # The patch is narrower than an element here; half of the error at least must go.
    assert with_correction < 0.5 * without
    assert with_correction < 0.04


# Beside every vertex of the coarse mesh.
BETWEEN = np.array([0.11, 0.07, 1.0]) / np.linalg.norm([0.11, 0.07, 1.0])
PUSH = np.array([0.3, 0.0, -1.0])


def test_between_vertices_a_coarse_mesh_has_the_dip_of_a_fine_one():
    """At the vertices of the fine mesh, most of which lie between those of the coarse one."""
    fine, coarse = ball(4), ball(3)
    exact = moved_by(fine, top_load(fine.surface.mesh, BETWEEN))
    points = fine.surface.mesh.vertices
    about = np.linalg.norm(points - BETWEEN, axis=1) < 3 * RADIUS
    closest = closest_points(coarse.surface.mesh, points[about])
    where = closest.triangle, closest.barycentric
    load = top_load(coarse.surface.mesh, BETWEEN)
    at_points = interpolation_matrix(coarse.surface.displacement, *where)
    interpolated = at_points @ moved_by(coarse, load)
    (local,) = indentation_corrections(coarse.surface, [load])
    constant, slope = missed_indentation(coarse.surface, local.dip, *where)
    with_dip = interpolated + (constant + NU * slope) @ PUSH
    largest = np.linalg.norm(exact[about], axis=1).max()
    errors = []
    for displacement in (with_dip, interpolated):
        error = displacement - exact[about]
        # The rims of the two supports differ, so one ball has moved a little farther as a whole.
        errors.append(np.linalg.norm(error - error.mean(axis=0), axis=1).max() / largest)
    # The element is wider than the patch; the interpolation of what is smooth leaves 1 %.
    assert errors[0] < 0.015
    assert errors[1] > 0.1


def test_at_a_vertex_or_far_from_the_load_nothing_of_the_dip_is_missed(coarse):
    mesh = coarse.surface.mesh
    top = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 1.0).any(axis=1))
    at_top = np.isclose(mesh.vertices[mesh.triangles[top]][:, :, 2], 1.0).astype(float)
    (local,) = indentation_corrections(coarse.surface, [top_load(mesh, BETWEEN)])
    assert np.abs(missed_indentation(coarse.surface, local.dip, top, at_top)).max() < 1e-12
    beside = np.argmin(np.abs(mesh.vertices[mesh.triangles].mean(axis=1)[:, 2]))
    middle = np.full((1, 3), 1 / 3)
    assert not missed_indentation(coarse.surface, local.dip, np.array([beside]), middle).any()
    assert missed_indentation(coarse.surface, local.dip, top[:1], middle).any()


def test_without_a_disc_or_on_facets_nothing_is_added(coarse):
    load = top_load(coarse.surface.mesh)
    assert indentation_corrections(coarse.surface, [SurfaceLoad(load.triangles, load.density)]) == [
        None
    ]
    facets = ball(2, smooth=False).surface
    assert indentation_corrections(facets, [load]) == [None]


def test_across_the_rim_of_the_support_nothing_is_added(coarse):
    mesh, surface = coarse.surface.mesh, coarse.surface
    cut = surface.sides.cut[surface.sides.edge].any(axis=1) & ~surface.held
    corner = mesh.triangles[np.flatnonzero(cut)[0]]
    load = top_load(mesh, mesh.vertices[corner].mean(axis=0))
    assert indentation_corrections(surface, [load]) == [None]


def pressed_cube(cells, *, corrected):
    """Corner displacement of a cube that a patch presses beside its edge."""
    mesh = box(cells=cells)
    system = held_part(mesh, np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    load = top_load(mesh, BESIDE_EDGE, 0.22)
    (local,) = indentation_corrections(system.surface, [load]) if corrected else [None]
    right = load_right_hand(system, [load], [local])
    x = solve(factorise(system, NU), right.at(NU)) @ np.array([0.0, 0.0, -1.0])
    return mesh.vertices, sorted_state(system, x, 1.0).displacement


@pytest.mark.slow
def test_the_correction_holds_up_to_an_edge_of_the_object():
    vertices, exact = pressed_cube(12, corrected=True)
    coarse_vertices, with_correction = pressed_cube(4, corrected=True)
    same = np.linalg.norm(coarse_vertices[:, None] - vertices[None], axis=2).argmin(axis=1)
    _, without = pressed_cube(4, corrected=False)
    errors = [
        np.linalg.norm(displacement - exact[same]) / np.linalg.norm(exact[same])
        for displacement in (with_correction, without)
    ]
    # A half space knows nothing of the edge: what that changes stays, a little more than half.
    assert errors[0] < 0.75 * errors[1]


@pytest.mark.parametrize(("radius", "crosses"), [(0.24, False), (0.26, True)])
def test_a_patch_crosses_an_edge_that_is_nearer_than_its_radius(radius, crosses):
    mesh = box(cells=4)
    surface = held_part(
        mesh, np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1)
    ).surface
    (local,) = indentation_corrections(surface, [top_load(mesh, BESIDE_EDGE, radius)])
    assert (local is None) == crosses


def test_only_midside_nodes_around_the_patch_are_corrected(coarse):
    surface = coarse.surface
    (local,) = indentation_corrections(surface, [top_load(surface.mesh)])
    row = surface.displacement.element[:, 3:] - surface.displacement.n_nodes
    position = np.empty((surface.displacement.weights.shape[0], 3))
    position[row.ravel()] = surface.element_nodes[:, 3:].reshape(-1, 3)
    # 2.5 edges of at most 0.6 beyond the radius.
    assert np.linalg.norm(position[local.midside_nodes] - TOP, axis=1).max() < RADIUS + 2.5 * 0.6
    assert (position[local.midside_nodes][:, 2] > 0).all()


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.5])
def test_the_correction_is_what_the_matrix_would_have_with_quadratic_elements(coarse, nu):
    """Linear elements with the quadratic midside nodes as `correction` are quadratic elements."""
    linear = ball(2, quadratic=False)
    rng = np.random.default_rng(0)
    vertices = coarse.surface.mesh.vertices
    fields = np.zeros((2, *vertices.shape))
    fields[:, coarse.unknowns.free_vertices] = rng.normal(
        size=(2, coarse.unknowns.free_vertices.size, 3)
    )
    change = coarse.surface.displacement.weights - linear.surface.displacement.weights
    correction = np.zeros((2, change.shape[0], 3, 3))
    correction[..., 1] = np.stack([change @ field for field in fields])
    (some,) = indentation_corrections(coarse.surface, [top_load(coarse.surface.mesh)])
    every = replace(some, midside_nodes=np.arange(change.shape[0]), correction=correction)
    columns = correction_columns(linear, [every]).at(nu)
    assert not columns[:, [0, 2]].any()
    count = 3 * coarse.unknowns.free_vertices.size
    field = (fields[0] + nu * fields[1])[coarse.unknowns.free_vertices].ravel()
    difference = system_matrix(coarse, nu)[:, :count] - system_matrix(linear, nu)[:, :count]
    # Sums of products of order one, by two orders of summation.
    np.testing.assert_allclose(columns[:, 1], -difference @ field, atol=1e-10)

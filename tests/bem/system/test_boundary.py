"""As many equations as unknowns, and collocation points where they belong."""

import numpy as np
import pytest
from elastic_bodies import cube_with_faces

from palpate.bem import SurfaceSettings, make_surface
from palpate.bem.system.boundary import find_unknowns, place_collocation
from palpate.geometry import closest_points

CELLS = 3
FACE = (CELLS + 1) ** 2
ALL = 6 * CELLS**2 + 2
EDGE = CELLS + 1


def bounded(faces):
    mesh, face = cube_with_faces(CELLS)
    surface = make_surface(mesh, np.flatnonzero(np.isin(face, faces)))
    unknowns = find_unknowns(surface)
    return surface, unknowns, place_collocation(surface, unknowns)


@pytest.mark.parametrize(
    ("faces", "held_vertices", "held_sides"),
    [
        ([4], FACE, FACE),
        ([4, 5], 2 * FACE, 2 * FACE),
        ([0, 4], 2 * FACE - EDGE, 2 * FACE),
        ([0, 2, 4], 3 * FACE - 3 * EDGE + 1, 3 * FACE),
    ],
)
def test_counts_on_a_cube(faces, held_vertices, held_sides):
    _, unknowns, collocation = bounded(faces)
    assert unknowns.held_vertices.size == held_vertices
    assert unknowns.free_vertices.size == ALL - held_vertices
    assert unknowns.held_sides.size == held_sides
    assert collocation.point.shape[0] == unknowns.free_vertices.size + held_sides


def test_every_vertex_with_one_held_side_or_none_has_its_own_equation():
    surface, unknowns, collocation = bounded([0, 4])
    shared = np.flatnonzero((surface.mesh.vertices[:, [0, 2]] == 0).all(axis=1))
    at_vertices = collocation.vertex[collocation.vertex >= 0]
    assert np.array_equal(np.sort(np.concatenate([at_vertices, shared])), np.arange(ALL))
    assert np.array_equal(collocation.point[: at_vertices.size], surface.mesh.vertices[at_vertices])
    assert unknowns.held_sides.size == np.unique(unknowns.held_sides).size


def test_shifted_points_lie_in_held_faces_near_their_vertex():
    surface, _, collocation = bounded([0, 2, 4])
    inside = collocation.vertex < 0
    assert surface.held[collocation.triangle[inside]].all()
    place = closest_points(surface.mesh, collocation.point[inside])
    # On the surface up to round-off, and off every edge so that the polar coordinates work.
    assert place.distance.max() < 1e-15
    assert np.array_equal(place.triangle, collocation.triangle[inside])
    np.testing.assert_allclose(place.barycentric, collocation.barycentric[inside], atol=1e-12)
    # One point for each of the three faces at the common corner.
    corner = np.linalg.norm(collocation.point[inside], axis=1) < 0.25 * np.sqrt(2) / CELLS
    assert corner.sum() == 3


def test_rim_vertices_have_one_unknown_side():
    surface, unknowns, _ = bounded([4])
    vertex = surface.sides.vertex[unknowns.held_sides]
    assert np.array_equal(np.sort(vertex), unknowns.held_vertices)


def test_flat_facets_have_flat_midpoints():
    mesh, face = cube_with_faces(2)
    surface = make_surface(mesh, np.flatnonzero(face == 4), settings=SurfaceSettings(smooth=False))
    corner = mesh.vertices[mesh.triangles]
    middle = 0.5 * (corner + np.roll(corner, -1, axis=1))
    np.testing.assert_allclose(surface.element_nodes[:, 3:], middle, atol=1e-15)

"""Bodies of tetrahedra: volume, shape, sizes, the same bytes twice, and every refusal."""

from dataclasses import replace

import numpy as np
import pytest
from surfaces import box, joined, sphere

from palpate.errors import InputError, MeshError
from palpate.geometry import TriangleMesh, closest_points, enclosed_volume
from palpate.lab.specimens import cylinder
from palpate.solids.finite_elements import quadratic_basis
from palpate.solids.tetrahedra import EDGES, boundary_surface, make_solid, quadratic_solid


def filled(mesh, **options):
    return make_solid(mesh, **options)


def volume(solid):
    return float(quadratic_basis(solid).dx.sum())


def edge_lengths(solid):
    corner = solid.nodes[solid.elements[:, :4]]
    return np.linalg.norm(corner[:, EDGES[:, 0]] - corner[:, EDGES[:, 1]], axis=2)


def l_shape():
    """A block with a re-entrant edge: a 2 by 2 by 1 box less a quarter, welded by hand."""
    corner = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], dtype=float)
    vertices = np.concatenate([np.column_stack([corner, np.full(6, z)]) for z in (0.0, 1.0)])
    cap = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    i = np.arange(6)
    j = (i + 1) % 6
    sides = np.concatenate([np.column_stack([i, j, j + 6]), np.column_stack([i, j + 6, i + 6])])
    return TriangleMesh(vertices, np.concatenate([cap[:, ::-1], cap + 6, sides]))


def test_a_block_keeps_its_volume_and_its_faces():
    mesh = box((0.06, 0.05, 0.04))
    solid = filled(mesh, edge=0.01)
    # Flat faces and straight edges: nothing but rounding.
    assert volume(solid) == pytest.approx(enclosed_volume(mesh), rel=1e-12)
    assert solid.deviation < 1e-15
    for corner in mesh.vertices:
        assert np.linalg.norm(solid.nodes - corner, axis=1).min() < 1e-15


def test_elements_follow_walls_inside():
    mesh, wall = box((0.06, 0.05, 0.04)), box((0.02, 0.015, 0.012), origin=(0.018, 0.017, 0.011))
    low, high = wall.vertices.min(axis=0), wall.vertices.max(axis=0)

    def cut(solid):
        """Share of the wall's volume in elements with a centre inside that stick out of it."""
        corner = solid.nodes[solid.elements[:, :4]]
        beyond = np.maximum(low - corner, corner - high).max(axis=2)
        centre = corner.mean(axis=1)
        within = np.all((centre > low) & (centre < high), axis=1)
        size = np.abs(np.linalg.det(np.diff(corner, axis=1))) / 6.0
        assert size.sum() == pytest.approx(enclosed_volume(mesh), rel=1e-12)
        return size[within & (beyond.max(axis=1) > 1e-9)].sum() / enclosed_volume(wall)

    # Some tetrahedra at its edges bridge two faces: one in thirty; of others a third is cut.
    assert cut(make_solid(mesh, edge=0.004, walls=[wall])) < 0.06
    assert cut(make_solid(mesh, edge=0.004)) > 0.2


def test_the_tip_of_a_cone_is_kept():
    # No edge of a cone of many sides is sharp, its tip is.
    around = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
    rim = np.column_stack([np.cos(around), np.sin(around), np.zeros(48)])
    vertices = np.concatenate([rim, [[0.0, 0.0, 2.0], [0.0, 0.0, 0.0]]])
    i = np.arange(48)
    j = (i + 1) % 48
    side = np.column_stack([i, j, np.full(48, 48)])
    base = np.column_stack([j, i, np.full(48, 49)])
    solid = make_solid(TriangleMesh(vertices, np.concatenate([side, base])), edge=0.3)
    assert np.linalg.norm(solid.nodes - vertices[48], axis=1).min() < 1e-15
    assert solid.deviation < 0.05


def test_where_a_sharp_edge_turns_a_corner_is_kept():
    """The rim of a flat double pyramid: two sharp edges meet in each corner, at 60 degrees."""
    angle = np.arange(6) * np.pi / 3
    corner = 0.05 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(6)])
    # Rim points between the corners are as close together as those that are kept are not.
    share = np.arange(7)[:, None] / 7
    ends = zip(corner, np.roll(corner, -1, axis=0), strict=True)
    rim = np.vstack([start + share * (end - start) for start, end in ends])
    count = len(rim)
    vertices = np.vstack([rim, [[0.0, 0.0, 0.018], [0.0, 0.0, -0.018]]])
    k = np.arange(count)
    upper = np.column_stack([k, (k + 1) % count, np.full(count, count)])
    lower = np.column_stack([(k + 1) % count, k, np.full(count, count + 1)])
    solid = filled(TriangleMesh(vertices, np.vstack([upper, lower])), edge=0.013)
    for tip in corner:
        assert np.linalg.norm(solid.nodes - tip, axis=1).min() < 1e-12


def test_a_reentrant_edge_is_kept():
    mesh = l_shape()
    solid = filled(mesh, edge=0.3)
    assert volume(solid) == pytest.approx(enclosed_volume(mesh), rel=1e-12)
    assert solid.deviation < 1e-12


def test_a_round_body_is_met_with_the_order_of_bent_elements():
    mesh = sphere(5, 0.03)
    ratio = []
    for edge in (0.012, 0.006):
        solid = filled(mesh, edge=edge)
        ratio.append(abs(volume(solid) / enclosed_volume(mesh) - 1.0))
    # Straight elements would lose edge^2; bent ones stand at edge^3 to edge^4.
    assert ratio[1] < 2e-4
    assert np.log2(ratio[0] / ratio[1]) > 2.7


def shapes(solid):
    """Volume of each element over that of a regular one with the same mean square edge."""
    corner = solid.nodes[solid.elements[:, :4]]
    side = corner[:, 1:] - corner[:, :1]
    size = np.einsum("ma,ma->m", side[:, 0], np.cross(side[:, 1], side[:, 2]))
    return np.sqrt(2.0) * size / np.mean(edge_lengths(solid) ** 2, axis=1) ** 1.5


def test_elements_have_the_asked_size_and_a_good_shape():
    solid = filled(box((0.06, 0.05, 0.04)), edge=0.008)
    length = edge_lengths(solid)
    assert length.mean() == pytest.approx(0.008, rel=0.15)
    assert length.max() < 2.5 * 0.008
    # 1 is regular; typical bodies have a median of 0.9 and one element in a hundred below 0.4.
    assert np.median(shapes(solid)) > 0.8
    assert np.percentile(shapes(solid), 1) > 0.3


def test_a_wall_that_is_straight_one_way_has_no_flat_elements():
    """Four points of a cylinder's wall may lie in one plane; a flat element between them is
    infinitely stiff against bending, and one in twenty of them cost 2 % of a body's motion."""
    solid = filled(cylinder(radius=0.02, height=0.06, edge=2e-3), edge=8e-3)
    assert np.mean(shapes(solid) < 0.05) < 1e-3


def test_a_fine_place_is_fine_and_the_rest_is_not():
    mesh, spot = box((0.06, 0.06, 0.06)), np.array([0.03, 0.03, 0.06])
    solid = filled(mesh, edge=0.012, fine=((spot, 0.004, 0.001),))
    length = edge_lengths(solid)
    centre = solid.nodes[solid.elements[:, :4]].mean(axis=1)
    distance = np.linalg.norm(centre - spot, axis=1)
    assert length[distance < 0.003].mean() == pytest.approx(0.001, rel=0.25)
    assert length[distance > 0.05].mean() == pytest.approx(0.012, rel=0.25)
    assert volume(solid) == pytest.approx(enclosed_volume(mesh), rel=1e-12)


def test_faces_point_outward_and_close():
    solid = filled(sphere(3, 0.03), edge=0.01)
    surface = boundary_surface(solid.nodes, solid.facets)
    assert enclosed_volume(surface) == pytest.approx(volume(solid), rel=0.02)
    ends = np.stack([surface.triangles, np.roll(surface.triangles, -1, axis=1)], axis=2)
    _, count = np.unique(np.sort(ends.reshape(-1, 2), axis=1), axis=0, return_counts=True)
    assert (count == 2).all()


def test_faces_know_their_triangle():
    mesh = box((0.06, 0.05, 0.04))
    solid = filled(mesh, edge=0.01)
    middle = solid.nodes[solid.facets[:, :3]].mean(axis=1)
    assert np.array_equal(closest_points(mesh, middle).triangle, solid.facet_triangle)


def test_the_same_surface_gives_the_same_bytes():
    mesh = sphere(3, 0.03)
    first, second = (filled(mesh, edge=0.01) for _ in range(2))
    for name in ("nodes", "elements", "facets", "facet_triangle"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


def test_open_crossing_and_double_surfaces_are_refused():
    mesh = box()
    with pytest.raises(MeshError, match="open"):
        make_solid(replace(mesh, triangles=mesh.triangles[1:]), edge=0.2)
    with pytest.raises(MeshError):
        filled(joined(mesh, box(origin=(0.5, 0.5, 0.5))), edge=0.2)


@pytest.mark.parametrize("edge", [0.0, -1.0, np.nan])
def test_bad_edges_are_refused(edge):
    with pytest.raises(InputError, match="edge is"):
        filled(box(), edge=edge)
    with pytest.raises(InputError, match="edge of a fine place is"):
        filled(box(), edge=0.2, fine=((np.zeros(3), 0.1, edge),))


def test_bad_fine_places_are_refused():
    with pytest.raises(InputError, match="radius of a fine place is -1"):
        filled(box(), edge=0.2, fine=((np.zeros(3), -1.0, 0.1),))
    with pytest.raises(InputError, match="point of a fine place"):
        filled(box(), edge=0.2, fine=((np.array([0.0, np.nan, 0.0]), 0.1, 0.1),))


def test_too_large_an_edge_is_refused():
    with pytest.raises(MeshError, match="leaves no point inside"):
        filled(box(), edge=3.0)


def test_walls_thinner_than_the_elements_are_refused():
    with pytest.raises(MeshError, match=r"use a smaller edge"):
        filled(box((1.0, 1.0, 0.02)), edge=0.3)


def test_tetrahedra_far_from_the_surface_or_without_volume_are_refused():
    points = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    flat = np.concatenate([np.zeros((1, 3)), np.eye(3)[:2], [[1.0, 1.0, 0.0]]])
    cell = np.array([[0, 1, 2, 3]])
    mesh = TriangleMesh(points, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    assert volume(quadratic_solid(points, cell[:, ::-1], mesh=mesh)) == pytest.approx(1 / 6)
    with pytest.raises(MeshError, match="no volume"):
        quadratic_solid(flat, cell, mesh=mesh)
    with pytest.raises(MeshError, match="miss the surface"):
        quadratic_solid(0.5 * points, cell, mesh=mesh, largest=0.1)


def test_a_solid_is_fixed():
    solid = filled(box(), edge=0.5)
    with pytest.raises(ValueError, match="read-only"):
        solid.nodes[0] = 1.0
    with pytest.raises(InputError, match="nodes has 1 entries that are not finite"):
        replace(solid, nodes=np.concatenate([[[np.nan, 0.0, 0.0]], solid.nodes[1:]]))

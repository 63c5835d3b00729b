"""Triangle surfaces, their sides, and the order of points."""

import numpy as np
import pytest
from surfaces import box, sphere

from palpate.errors import InputError, MeshError
from palpate.geometry import (
    TriangleMesh,
    area_vectors,
    bounding_diagonal,
    cut_distance,
    enclosed_volume,
    morton_order,
    split_sides,
    triangle_areas,
    unit_normals,
)
from palpate.geometry.triangle_mesh import connected_components, half_edges

CELLS = 3


def test_box_has_the_volume_and_area_of_a_box():
    mesh = box(size=(0.1, 0.03, 0.02), cells=3, origin=(5.0, -2.0, 1.0))
    # Sums of a hundred products: 1e-12 leaves a thousand roundings.
    assert enclosed_volume(mesh) == pytest.approx(0.1 * 0.03 * 0.02, rel=1e-12)
    area = 2 * (0.1 * 0.03 + 0.03 * 0.02 + 0.02 * 0.1)
    assert triangle_areas(mesh).sum() == pytest.approx(area, rel=1e-12)
    assert bounding_diagonal(mesh) == pytest.approx(np.sqrt(0.1**2 + 0.03**2 + 0.02**2), rel=1e-12)


def test_volume_of_a_sphere_converges_at_second_order():
    levels = np.array([2, 3, 4])
    error = [1.0 - enclosed_volume(sphere(n)) / (4.0 * np.pi / 3.0) for n in levels]
    rate = np.polyfit(np.log(0.5**levels), np.log(error), 1)[0]
    # Facets of a sphere lose volume as h^2; the coarsest level bends the rate by under 0.1.
    assert rate == pytest.approx(2.0, abs=0.1)


def test_normals_of_a_sphere_point_outward_and_close():
    mesh = sphere(2)
    centre = mesh.vertices[mesh.triangles].mean(axis=1)
    assert np.einsum("ea,ea->e", unit_normals(mesh), centre).min() > 0.9
    # The area vectors of a closed surface sum to zero, up to rounding of 128 terms of size 0.1.
    assert np.abs(area_vectors(mesh).sum(axis=0)).max() < 1e-14


def test_volume_changes_sign_with_the_orientation():
    mesh = sphere(1)
    turned = TriangleMesh(mesh.vertices, mesh.triangles[:, ::-1])
    assert enclosed_volume(turned) == -enclosed_volume(mesh)


def test_arrays_are_read_only_copies():
    vertices = np.array(box().vertices)
    mesh = TriangleMesh(vertices, box().triangles)
    vertices[0] = 7.0
    assert not np.any(mesh.vertices == 7.0)
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0, 0] = 1.0


def test_index_out_of_range_is_refused():
    with pytest.raises(MeshError, match="indices 0 to 3, but there are 3"):
        TriangleMesh(np.eye(3), np.array([[0, 1, 3]]))


def test_mesh_without_triangles_is_refused():
    with pytest.raises(MeshError, match="no triangles"):
        TriangleMesh(np.eye(3), np.zeros((0, 3), dtype=np.int64))


def test_vertices_that_are_not_finite_are_refused():
    with pytest.raises(InputError, match="1 entries that are not finite, the first at index"):
        TriangleMesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, np.nan, 0]]), np.array([[0, 1, 2]]))


def test_normal_of_a_flat_triangle_is_refused():
    mesh = TriangleMesh(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]]))
    with pytest.raises(MeshError, match="zero area"):
        unit_normals(mesh)


def test_half_edges_of_a_tetrahedron():
    halves = half_edges(np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]))
    head = halves.tail[halves.following]
    assert halves.tail.tolist() == [0, 1, 2, 0, 3, 1, 0, 2, 3, 1, 3, 2]
    assert head.tolist() == [1, 2, 0, 3, 1, 0, 2, 3, 0, 3, 2, 1]
    assert halves.ends.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    assert np.array_equal(np.sort([halves.tail, head], axis=0).T, halves.ends[halves.edge])
    opposite = halves.opposite()
    assert np.array_equal(halves.tail[opposite], head)
    assert np.array_equal(opposite[opposite], np.arange(12))


def test_a_rim_runs_between_what_is_chosen_and_what_is_not():
    halves = half_edges(np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]))
    assert halves.rim(np.array([True, False, False, False])).tolist() == [[0, 1], [0, 2], [1, 2]]
    two = np.array([True, True, False, False])
    assert halves.rim(two).tolist() == [[0, 2], [0, 3], [1, 2], [1, 3]]
    assert halves.rim(~two).tolist() == halves.rim(two).tolist()
    assert not len(halves.rim(np.ones(4, dtype=bool)))


def test_pairs_leave_out_edges_of_one_and_of_three_triangles():
    halves = half_edges(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4], [3, 2, 1]]))
    count = dict(zip(map(tuple, halves.ends.tolist()), halves.count.tolist(), strict=True))
    assert (count[0, 1], count[1, 2], count[1, 3], count[0, 4]) == (3, 2, 2, 1)
    assert halves.pairs().tolist() == [[1, 10], [5, 11]]


def test_groups_hang_together_by_their_links():
    count, group = connected_components(np.array([[0, 3], [3, 1], [4, 5]]), 6)
    assert count == 3
    assert group.tolist() == [0, 0, 1, 0, 2, 2]


def no_region(mesh):
    return np.zeros(mesh.triangles.shape[0], dtype=np.int64)


def test_a_cube_has_three_sides_a_corner_two_an_edge():
    mesh = box(cells=CELLS)
    sides = split_sides(mesh, no_region(mesh))
    count = np.bincount(sides.vertex)
    on = (np.isclose(mesh.vertices, 0) | np.isclose(mesh.vertices, 1)).sum(axis=1)
    assert np.array_equal(count, on)
    assert sides.cut.sum() == 12 * CELLS
    assert sides.vertex.size == 6 * (CELLS + 1) ** 2


def test_a_sphere_has_one_side_a_vertex():
    mesh = sphere(2)
    sides = split_sides(mesh, no_region(mesh))
    assert not sides.cut.any()
    assert np.array_equal(np.sort(sides.vertex), np.arange(mesh.vertices.shape[0]))


def test_a_region_cuts_its_rim():
    mesh = sphere(2)
    region = (mesh.vertices[mesh.triangles].mean(axis=1)[:, 2] < 0).astype(np.int64)
    sides = split_sides(mesh, region)
    count = np.bincount(sides.vertex)
    # The octahedron's equator: 4 edges, each cut in four.
    assert sides.cut.sum() == 16
    assert np.array_equal(count == 2, np.isclose(mesh.vertices[:, 2], 0))
    assert count.max() == 2
    side_region = np.full(sides.vertex.size, -1)
    side_region[sides.corner.ravel()] = np.repeat(region, 3)
    assert np.array_equal(side_region[sides.corner], np.repeat(region[:, None], 3, axis=1))


@pytest.mark.parametrize(("degrees", "cut"), [(60.0, True), (80.0, False)])
def test_the_crease_angle_decides(degrees, cut):
    # Facets of the octahedron meet at 70.5 degrees.
    mesh = sphere(0)
    sides = split_sides(mesh, no_region(mesh), crease_angle=np.radians(degrees))
    assert sides.cut.all() == cut
    assert sides.cut.any() == cut


def test_edges_and_twins_belong_together():
    mesh = box(cells=2)
    sides = split_sides(mesh, no_region(mesh))
    half = np.arange(sides.edge.size)
    twin = sides.twin.ravel()
    assert np.array_equal(twin[twin], half)
    assert (twin != half).all()
    assert np.array_equal(sides.edge.ravel()[twin], sides.edge.ravel())
    tail = mesh.triangles.ravel()
    head = np.roll(mesh.triangles, -1, axis=1).ravel()
    assert np.array_equal(tail[twin], head)
    assert np.array_equal(head[twin], tail)
    assert np.array_equal(sides.vertex[sides.corner], mesh.triangles)


def test_the_distance_of_an_edge_is_that_of_its_nearest_point():
    mesh = box((1.0, 2.0, 3.0), cells=CELLS)
    sides = split_sides(mesh, no_region(mesh))
    every = np.arange(len(mesh.triangles))
    # On the face z = 3: beside an edge, not its line; beyond a corner, that corner.
    assert cut_distance(mesh, sides, every, np.array([0.5, 1.9, 3.0])) == pytest.approx(0.1)
    beyond = cut_distance(mesh, sides, every, np.array([-3.0, -4.0, 0.0]))
    assert beyond == pytest.approx(5.0)
    inner = np.flatnonzero(~sides.cut[sides.edge].any(axis=1))
    assert cut_distance(mesh, sides, inner, np.zeros(3)) == np.inf


def test_a_cube_is_ordered_by_interleaved_bits():
    grid = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    code = sum(((grid >> bit) & 1) @ [1, 2, 4] << (3 * bit) for bit in range(2))
    # Cells of 1 / 1023 of the longest side: thirds of it differ in the highest two bits alike.
    assert np.array_equal(morton_order(grid.astype(float)), np.argsort(code))


def test_place_and_size_do_not_matter_and_points_without_a_place_come_last():
    points = np.random.default_rng(0).random((50, 3))
    order = morton_order(points)
    assert np.array_equal(np.sort(order), np.arange(50))
    assert np.array_equal(morton_order(0.25 * points - 3.0), order)
    points[7] = np.nan
    assert morton_order(points)[-1] == 7


def test_points_at_one_place_keep_their_order():
    assert np.array_equal(morton_order(np.ones((4, 3))), np.arange(4))


def test_neighbours_on_a_grid_stay_together():
    grid = np.stack([*np.divmod(np.arange(256), 16), np.zeros(256)], axis=1)
    block = grid[morton_order(grid)].reshape(16, 16, 3)
    # Sixteen points in a square of four by four.
    assert np.all(np.ptp(block, axis=1)[:, :2] == 3)

"""Smooth sides: cut at creases and where a region ends, nowhere else."""

import numpy as np
import pytest
from surfaces import box, sphere

from palpate.geometry import cut_distance, split_sides

CELLS = 3


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

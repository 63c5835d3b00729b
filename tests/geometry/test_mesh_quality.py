"""Every way in which a surface can fail to bound a solid, and what the messages say."""

import time

import numpy as np
import pytest
from surfaces import box, joined, sphere

from palpate.errors import MeshError
from palpate.geometry import (
    TriangleMesh,
    checked_mesh,
    enclosed_volume,
    mesh_quality,
    unit_normals,
    wall_thickness,
    welded,
)
from palpate.geometry.mesh_quality import intersecting_pairs


@pytest.mark.parametrize("mesh", [box(cells=1), box(cells=4), sphere(0), sphere(3)])
def test_good_surfaces_pass_untouched(mesh):
    checked, notes = checked_mesh(mesh)
    assert checked is mesh
    assert notes == ()


def test_inward_mesh_is_turned_and_said():
    mesh = sphere(1)
    checked, notes = checked_mesh(TriangleMesh(mesh.vertices, mesh.triangles[:, ::-1]))
    assert enclosed_volume(checked) == pytest.approx(enclosed_volume(mesh), rel=1e-14)
    assert notes == ("All triangles of the mesh faced inward; they were turned outward.",)


@pytest.mark.parametrize("wrong", [[0], [3, 7, 8], list(range(20))])
def test_single_inward_triangles_are_turned_and_counted(wrong):
    mesh = sphere(1)
    triangles = np.array(mesh.triangles)
    triangles[wrong] = triangles[wrong][:, ::-1]
    checked, notes = checked_mesh(TriangleMesh(mesh.vertices, triangles))
    np.testing.assert_allclose(unit_normals(checked), unit_normals(mesh), atol=1e-15)
    assert (
        f"{len(wrong)} of 32 triangles of the mesh faced inward, the first: [{wrong[0]}"
        in (notes[0])
    )


def test_two_components_are_counted_with_their_sizes():
    far = box(origin=(5.0, 0.0, 0.0))
    with pytest.raises(MeshError, match=r"2 separate components of \[32, 12\] triangles"):
        checked_mesh(joined(sphere(1), far))


def test_duplicate_faces_are_named():
    mesh = box()
    triangles = np.concatenate([mesh.triangles, mesh.triangles[4:5, [1, 2, 0]]])
    with pytest.raises(MeshError, match=r"2 triangles share all three vertices .* \[4, 12\]"):
        checked_mesh(TriangleMesh(mesh.vertices, triangles))


def test_degenerate_triangle_is_named():
    mesh = box()
    vertices = np.concatenate([mesh.vertices, [[0.0, 0.0, 0.5]]])
    a, b = 0, 1
    triangles = np.concatenate([mesh.triangles, [[a, b, len(mesh.vertices)]]])
    flat = vertices.copy()
    flat[-1] = 0.5 * (vertices[a] + vertices[b])
    with pytest.raises(MeshError, match=r"1 triangles are degenerate .* \[12\]"):
        checked_mesh(TriangleMesh(flat, triangles))


def test_unused_vertices_are_named():
    mesh = box()
    with pytest.raises(MeshError, match=r"1 vertices belong to no triangle, the first: \[8\]"):
        checked_mesh(TriangleMesh(np.concatenate([mesh.vertices, [[9.0, 9, 9]]]), mesh.triangles))


def test_edge_of_four_triangles_is_named():
    beside = box(origin=(1.0, 1.0, 0.0))
    mesh = welded(joined(box(), beside))
    with pytest.raises(MeshError, match="1 edges belong to more than two triangles"):
        checked_mesh(mesh)


def test_vertex_where_two_parts_touch_is_named():
    mesh = welded(joined(box(), box(origin=(1.0, 1.0, 1.0))))
    corner = int(np.flatnonzero((mesh.vertices == 1.0).all(axis=1))[0])
    with pytest.raises(MeshError, match=rf"at 1 vertices separate parts .* \[{corner}\]"):
        checked_mesh(mesh)


def test_one_sided_surface_is_refused():
    """The projective plane on six vertices: closed, every edge twice, no consistent side."""
    listed = "012 023 034 045 051 124 235 341 452 513"
    triangles = np.array([[int(v) for v in word] for word in listed.split()])
    vertices = np.random.default_rng(3).normal(size=(6, 3))
    with pytest.raises(MeshError, match="one-sided"):
        checked_mesh(TriangleMesh(vertices, triangles))


def test_surface_through_itself_is_named():
    mesh = sphere(2)
    vertices = np.array(mesh.vertices)
    # One vertex is pulled through the opposite side.
    vertices[int(vertices[:, 2].argmax())] = [0.1, 0.13, -1.5]
    with pytest.raises(MeshError, match=r"intersects itself: .* pairs of triangles"):
        checked_mesh(TriangleMesh(vertices, mesh.triangles))


def test_interlocked_parts_intersect_and_distant_ones_do_not():
    a, b = box(cells=2), box(cells=3, origin=(0.45, 0.4, 0.35))
    pairs = intersecting_pairs(joined(a, b))
    assert len(pairs) > 0
    assert (pairs[:, 0] < len(a.triangles)).all()
    assert (pairs[:, 1] >= len(a.triangles)).all()
    assert len(intersecting_pairs(joined(a, box(origin=(1.001, 0.0, 0.0))))) == 0


def test_parts_that_touch_face_to_face_intersect():
    assert len(intersecting_pairs(joined(box(), box(origin=(1.0, 0.25, 0.25))))) > 0


def test_parts_that_touch_in_a_point_intersect():
    """The tip of an octahedron on a face of a box, and a hair above it."""
    tip = sphere(0)
    for lift, touching in ((0.0, True), (1e-6, False)):
        lifted = TriangleMesh(tip.vertices + np.array([0.4, 0.3, 2.0 + lift]), tip.triangles)
        assert (len(intersecting_pairs(joined(box(), lifted))) > 0) == touching


def test_triangles_folded_flat_onto_each_other_intersect():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, 0.7, 0]])
    folded = TriangleMesh(vertices, np.array([[0, 1, 2], [1, 0, 3]]))
    assert intersecting_pairs(folded).tolist() == [[0, 1]]
    opened = np.array(vertices)
    opened[3] = [0.5, -0.7, 0.0]
    assert len(intersecting_pairs(TriangleMesh(opened, folded.triangles))) == 0


def test_neighbours_at_a_vertex_that_cross_are_found():
    vertices = np.array([[0.0, 0, 0], [1, -1, 0], [1, 1, 0], [1, 0.1, -1], [1, 0.1, 1]])
    mesh = TriangleMesh(vertices, np.array([[0, 1, 2], [0, 3, 4]]))
    assert intersecting_pairs(mesh).tolist() == [[0, 1]]
    aside = np.array(vertices)
    aside[3:, 1] = 1.5
    assert len(intersecting_pairs(TriangleMesh(aside, mesh.triangles))) == 0


def _edge_hits(a, b):
    """True where an edge of `a` passes through triangle `b`, by signed volumes."""

    def volume(p, q, r, s):
        return np.einsum("na,na->n", np.cross(q - p, r - p), s - p)

    hit = np.zeros(len(a), dtype=bool)
    for i in range(3):
        p, q = a[:, i], a[:, (i + 1) % 3]
        sides = volume(b[:, 0], b[:, 1], b[:, 2], p) * volume(b[:, 0], b[:, 1], b[:, 2], q) < 0
        turns = [volume(p, q, b[:, k], b[:, (k + 1) % 3]) > 0 for k in range(3)]
        hit |= sides & (turns[0] == turns[1]) & (turns[1] == turns[2])
    return hit


def test_verdict_on_random_pairs_is_that_of_signed_volumes():
    """Another method: two triangles in general position cross where an edge pierces a face."""
    rng = np.random.default_rng(11)
    corner = rng.normal(size=(3000, 2, 3, 3))
    expected = _edge_hits(corner[:, 0], corner[:, 1]) | _edge_hits(corner[:, 1], corner[:, 0])
    # Pairs are set far apart, so that each meets its partner only.
    corner = corner + 100.0 * np.arange(3000)[:, None, None, None] * np.array([1.0, 0.0, 0.0])
    mesh = TriangleMesh(corner.reshape(-1, 3), np.arange(18000).reshape(-1, 3))
    crossing = np.zeros(3000, dtype=bool)
    crossing[intersecting_pairs(mesh)[:, 0] // 2] = True
    assert 300 < expected.sum() < 2700
    # The bounding box is 3e5 long, so contacts closer than 3e-5 count as touching: a few in 3000.
    assert (crossing != expected).sum() <= 3


def test_rotation_and_size_do_not_change_the_verdict():
    """Rounding of rotated coordinates must not make flat faces cross each other."""
    rng = np.random.default_rng(5)
    for scale in (1e-3, 1.0, 1e3):
        rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        mesh = box(size=(1.0, 0.3, 0.2), cells=5)
        turned = TriangleMesh(scale * (mesh.vertices @ rotation.T) + scale, mesh.triangles)
        checked_mesh(turned)


def test_five_thousand_triangles_are_checked_within_a_second():
    mesh = box(cells=21)
    assert len(mesh.triangles) > 5000
    start = time.process_time()
    checked_mesh(mesh)
    assert time.process_time() - start < 1.5


def test_needles_are_mentioned():
    _, notes = checked_mesh(box(size=(1.0, 1.0, 0.02)))
    assert "sharpest triangle of the mesh has an angle of 1.1 degrees" in notes[0]


def test_quality_of_a_cube_has_the_closed_form():
    quality = mesh_quality(box(size=(0.2, 0.2, 0.2), cells=2))
    assert (quality.vertices, quality.triangles) == (26, 48)
    # Right isosceles triangles of leg 0.1: hypotenuse over height is 2, angle 45 degrees.
    assert quality.worst_aspect == pytest.approx(2.0, rel=1e-12)
    assert quality.smallest_angle == pytest.approx(np.pi / 4.0, rel=1e-12)
    assert quality.edge_shortest == pytest.approx(0.1, rel=1e-12)
    assert quality.edge_longest == pytest.approx(0.1 * np.sqrt(2.0), rel=1e-12)
    assert quality.edge_mean == pytest.approx(0.1 * (2.0 + np.sqrt(2.0)) / 3.0, rel=1e-12)
    assert quality.volume == pytest.approx(0.008, rel=1e-12)
    assert quality.area == pytest.approx(0.24, rel=1e-12)
    assert quality.size == pytest.approx((0.2, 0.2, 0.2), rel=1e-12)


def test_a_slab_is_as_thick_as_it_is() -> None:
    mesh = box((1.0, 1.0, 0.1), (10, 10, 1))
    thickness = wall_thickness(mesh)
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    top = np.isclose(middle[:, 2], 0.1) | np.isclose(middle[:, 2], 0.0)
    # Centres of triangles face each other, or lie a third of an edge of 0.1 beside.
    assert np.all(thickness[top] >= 0.1 - 1e-12)
    assert np.all(thickness[top] <= 0.1 * np.hypot(1.0, 0.5))


def test_a_ball_has_no_walls() -> None:
    assert np.isinf(wall_thickness(sphere(3))).all()

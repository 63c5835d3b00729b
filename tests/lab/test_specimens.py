"""Specimens: closed forms for volume, what lies on the plane, what is refused."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from palpate.errors import InputError
from palpate.geometry import checked_mesh, enclosed_volume, mesh_quality
from palpate.lab.specimens import SHAPES, block, cylinder, glued_ball, half_ball, toy

LENGTHS = {
    "half-ball": {"radius": 0.04},
    "glued-ball": {"radius": 0.04, "patch_radius": 0.02},
    "block": {"length": 0.06, "width": 0.04, "height": 0.03},
    "cylinder": {"radius": 0.03, "height": 0.04},
    "toy": {"radius": 0.035},
}
_DEEP = 0.04 + np.sqrt(0.04**2 - 0.02**2)
VOLUMES = {
    "half-ball": 2.0 / 3.0 * np.pi * 0.04**3,
    # A ball less the cap under the patch: pi h^2 (3 r - h) / 3.
    "glued-ball": np.pi * _DEEP**2 * (3 * 0.04 - _DEEP) / 3.0,
    "cylinder": np.pi * 0.03**2 * 0.04,
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("edge", [0.003, 0.006])
def test_surfaces_are_closed_outward_and_even(name, edge):
    mesh = SHAPES[name].make(edge=edge, **LENGTHS[name])
    checked, notes = checked_mesh(mesh)
    assert notes == ()
    np.testing.assert_array_equal(checked.triangles, mesh.triangles)
    quality = mesh_quality(mesh)
    # Equilateral triangles have sides of `edge`; the toy's ears stretch them.
    assert quality.edge_mean == pytest.approx(edge, rel=0.25)
    assert quality.edge_longest < (3.0 if name == "toy" else 2.0) * edge
    assert quality.worst_aspect < 5.0


@pytest.mark.parametrize("name", VOLUMES)
def test_volume_approaches_the_round_body_by_the_square_of_the_edge(name):
    lost = [
        1.0 - enclosed_volume(SHAPES[name].make(edge=edge, **LENGTHS[name])) / VOLUMES[name]
        for edge in (0.006, 0.003)
    ]
    # Vertices lie on the body, so chords cut it off; rings are of whole numbers of vertices.
    assert 0.0 < lost[1] < 0.004
    assert 1.6 < np.log2(lost[0] / lost[1]) < 2.4


def test_block_is_exact():
    mesh = block(edge=0.004, **LENGTHS["block"])
    assert enclosed_volume(mesh) == pytest.approx(0.06 * 0.04 * 0.03, rel=1e-13)
    np.testing.assert_allclose(mesh.vertices.min(axis=0), [-0.03, -0.02, 0.0], atol=1e-17)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [0.03, 0.02, 0.03], atol=1e-17)


def test_round_bodies_have_their_vertices_on_the_sphere():
    vertices = half_ball(radius=0.04, edge=0.004).vertices
    dome = vertices[vertices[:, 2] > 0.0]
    np.testing.assert_allclose(np.linalg.norm(dome, axis=1), 0.04, rtol=1e-14)
    vertices = glued_ball(radius=0.04, patch_radius=0.02, edge=0.004).vertices
    middle = [0.0, 0.0, np.sqrt(0.04**2 - 0.02**2)]
    ball = vertices[vertices[:, 2] > 0.0]
    np.testing.assert_allclose(np.linalg.norm(ball - middle, axis=1), 0.04, rtol=1e-14)


@pytest.mark.parametrize("name", SHAPES)
def test_base_is_flat_and_on_the_plane(name):
    mesh = SHAPES[name].make(edge=0.004, **LENGTHS[name])
    height = mesh.vertices[:, 2]
    assert height.min() == pytest.approx(0.0, abs=1e-17)
    flat = (np.abs(height[mesh.triangles]) < 1e-12).all(axis=1)
    area = np.linalg.norm(
        np.cross(*(mesh.vertices[mesh.triangles[flat, k]] - mesh.vertices[mesh.triangles[flat, 0]]
                   for k in (1, 2))), axis=1,
    ).sum() / 2.0  # fmt: skip
    asked = {
        "half-ball": np.pi * 0.04**2,
        "glued-ball": np.pi * 0.02**2,
        "block": 0.06 * 0.04,
        "cylinder": np.pi * 0.03**2,
        "toy": np.pi * 0.021**2,
    }
    # A polygon of some 30 vertices instead of a circle.
    assert area == pytest.approx(asked[name], rel=0.02)


def test_toy_is_not_convex():
    mesh = toy(radius=0.035, edge=0.003)
    # Of a convex body these are the same, up to rounding.
    assert ConvexHull(mesh.vertices).volume > 1.05 * enclosed_volume(mesh)
    ears = mesh.vertices[:, 2] > 2.0 * 0.035
    assert (mesh.vertices[ears, 0] > 0.01).any()
    assert (mesh.vertices[ears, 0] < -0.01).any()
    assert not (np.abs(mesh.vertices[ears, 0]) < 0.002).any()


@pytest.mark.parametrize(
    ("make", "lengths", "text"),
    [
        (half_ball, {"radius": 0.0, "edge": 0.01}, "radius is 0 m; must be positive"),
        (half_ball, {"radius": 0.04, "edge": np.nan}, "edge is nan m; must be positive"),
        (cylinder, {"radius": 0.04, "height": 0.01, "edge": 0.02}, "longer than the height of 0.0"),
        (glued_ball, {"radius": 0.04, "patch_radius": 0.04, "edge": 0.01}, "less than the ball's"),
    ],
)
def test_impossible_lengths_are_refused(make, lengths, text):
    with pytest.raises(InputError, match=text):
        make(**lengths)

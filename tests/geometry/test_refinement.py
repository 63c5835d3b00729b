"""The smooth surface between the vertices, as finer triangles."""

import numpy as np
import pytest

from palpate.errors import InputError
from palpate.geometry import TriangleMesh, enclosed_volume, refined_surface
from tests.surfaces import box, sphere


def _off_sphere(vertices: np.ndarray) -> float:
    return float(np.abs(np.linalg.norm(vertices, axis=1) - 1.0).max())


def test_a_ball_comes_close_to_its_sphere() -> None:
    """Quadratic elements are third order in position, so far nearer than the flat facets."""
    mesh = sphere(3)
    flat = 1.0 - np.linalg.norm(mesh.vertices[mesh.triangles].mean(axis=1), axis=1).min()
    fine, _ = refined_surface(mesh, pieces=4)
    assert _off_sphere(fine) < 0.05 * flat


def test_flat_parts_of_finer_triangles_shrink_with_the_square_of_the_pieces() -> None:
    """What is left between the corners of the parts is their own sagitta: 1 / pieces^2."""
    mesh = sphere(2)
    gaps = []
    for pieces in (2, 4):
        vertices, triangles = refined_surface(mesh, pieces=pieces)
        middle = vertices[triangles].mean(axis=1)
        on = np.linalg.norm(vertices[triangles], axis=2).mean(axis=1)
        gaps.append(float((on - np.linalg.norm(middle, axis=1)).max()))
    assert gaps[0] / gaps[1] == pytest.approx(4.0, rel=0.1)


def test_a_box_stays_a_box() -> None:
    mesh = box((1.0, 2.0, 3.0), 2)
    vertices, triangles = refined_surface(mesh, pieces=3)
    inside = (vertices > mesh.vertices.min(axis=0) - 1e-12).all()
    assert inside
    assert (vertices < mesh.vertices.max(axis=0) + 1e-12).all()
    assert len(triangles) == 9 * len(mesh.triangles)
    # Corners are not merged, so the volume is summed over triangles; rounding only.
    assert enclosed_volume(TriangleMesh(vertices, triangles)) == pytest.approx(6.0, rel=1e-12)


def test_one_piece_is_the_mesh_itself() -> None:
    mesh = sphere(1)
    vertices, triangles = refined_surface(mesh, pieces=1)
    assert np.allclose(vertices[triangles], mesh.vertices[mesh.triangles], atol=1e-15)


def test_no_pieces_are_refused() -> None:
    with pytest.raises(InputError, match="pieces is 0"):
        refined_surface(sphere(1), pieces=0)

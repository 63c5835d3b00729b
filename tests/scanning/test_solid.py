"""The part of a solid above a plane, such as the support."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from palpate.geometry import TriangleMesh, half_edges
from palpate.scanning.plane import Plane
from palpate.scanning.solid import above


@pytest.mark.slow
def test_a_cut_lies_in_its_plane_however_close_it_passes_by_vertices():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    rng = np.random.default_rng(0)
    vertices = Rotation.random(random_state=0).apply(ball.vertices)
    mesh = TriangleMesh(vertices, np.asarray(ball.faces, dtype=np.int64))
    for height in rng.uniform(-0.02, 0.02, 40):
        plane = Plane(np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 1.0]))
        skin = above(mesh, plane)
        away = plane.heights(skin.vertices)
        # In the plane, or so far that no triangle of the cut has a corner above it.
        assert away.min() > -1e-12
        assert not ((away > 1e-9) & (away < 1e-5)).any()
        flat = (away < 1e-9)[skin.triangles].all(axis=1)
        at_rim = np.bincount(half_edges(skin.triangles).rim(flat).ravel())
        assert set(at_rim.tolist()) == {0, 2}

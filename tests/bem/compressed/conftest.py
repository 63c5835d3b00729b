"""A long body, so that some of it is far from other parts, solved both ways."""

import numpy as np
import pytest

from benchmarks.meshes import sheet
from palpate.bem import boundary_system, make_surface
from palpate.bem.compressed.system import compressed_system

SIZE, CELLS = np.array([5.0, 1.0, 1.0]), (20, 4, 4)
# Small clusters, close together: as much as can be is far at this size.
FINE = (32, 64)


@pytest.fixture(scope="package")
def long_surface():
    """A beam of 354 vertices, held at one end: with edges and corners where collocation points lie
    inside triangles."""
    mesh = sheet(SIZE, CELLS)
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    return make_surface(mesh, np.flatnonzero(middle[:, 0] < 1e-9))


@pytest.fixture(scope="package")
def dense(long_surface):
    return boundary_system(long_surface)


@pytest.fixture(scope="package")
def compressed(long_surface):
    return compressed_system(long_surface, leaf_size=FINE)

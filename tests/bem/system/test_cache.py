"""What is read back is what was computed, and nothing else is."""

import os

import numpy as np
import pytest
from surfaces import sphere

from palpate.bem import Quadrature, SurfaceSettings, cached_system, make_surface
from palpate.bem.system import cache as module
from palpate.bem.system.cache import content_hash
from palpate.errors import InputError, RecordError


def low_part(mesh):
    """Triangles of the lower third."""
    return np.flatnonzero(mesh.vertices[mesh.triangles].mean(axis=1)[:, 2] < -0.4)


@pytest.fixture(scope="module")
def surface():
    mesh = sphere(1)
    return make_surface(mesh, low_part(mesh))


def test_the_second_time_it_is_read(surface, tmp_path, monkeypatch):
    computed = cached_system(surface, tmp_path)
    monkeypatch.setattr(module, "assemble_system", None)
    read = cached_system(surface, tmp_path)
    np.testing.assert_array_equal(read.traction_kernel.values, computed.traction_kernel.values)
    kernels = (read.displacement_kernel, computed.displacement_kernel)
    np.testing.assert_array_equal(kernels[0].values, kernels[1].values)
    assert read.size == computed.size
    assert read.traction_length == computed.traction_length
    assert [path.suffix for path in tmp_path.iterdir()] == [".npz"]


def test_a_broken_file_is_computed_anew(surface, tmp_path):
    computed = cached_system(surface, tmp_path)
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:1000])
    again = cached_system(surface, tmp_path)
    np.testing.assert_array_equal(again.traction_kernel.values, computed.traction_kernel.values)


def test_all_that_matters_changes_the_hash(surface):
    mesh = surface.mesh
    held = low_part(mesh)
    flat = make_surface(mesh, held, settings=SurfaceSettings(smooth=False))
    fewer = make_surface(mesh, held[1:])
    default = Quadrature()
    hashes = {
        content_hash(surface, default),
        content_hash(flat, default),
        content_hash(fewer, default),
        content_hash(surface, Quadrature(tolerance=1e-5)),
    }
    assert len(hashes) == 4


def test_a_cache_that_cannot_be_written_is_said(surface, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    with pytest.raises(InputError, match="the cache cannot be written"):
        cached_system(surface, blocked)


def test_what_lies_in_the_place_of_the_cache_and_is_no_file_is_said(surface, tmp_path):
    """Reading a pipe would wait for ever."""
    os.mkfifo(tmp_path / f"system-{content_hash(surface, Quadrature())}.npz")
    with pytest.raises(RecordError, match="no regular file"):
        cached_system(surface, tmp_path)

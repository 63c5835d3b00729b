"""What is read back is what was computed, and nothing else is."""

import os

import numpy as np
import pytest
from surfaces import sphere

from palpate.bem import Quadrature, SurfaceSettings, cached_system, make_surface
from palpate.bem.system import cache as module
from palpate.bem.system.cache import content_hash
from palpate.bem.system.system import assemble_system
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


def _emptied(path):
    path.write_bytes(b"")


def _cut_off(path):
    path.write_bytes(path.read_bytes()[:1000])


def _packed(change):
    """Damage: the arrays are others, in a file that is whole."""

    def damage(path):
        with np.load(path) as stored:
            arrays = dict(stored)
        np.savez(path, **{name: change(name, array) for name, array in arrays.items()})

    return damage


def _values(change):
    return _packed(lambda name, array: change(array) if name == "traction_values" else array)


@pytest.mark.parametrize(
    "damage",
    [
        _emptied,
        _cut_off,
        _values(lambda array: array[:1]),
        _values(lambda array: np.full_like(array, np.nan)),
        _values(lambda array: 1.1 * array),
        _packed(lambda name, array: array[:1] if array.ndim else array),
        _packed(lambda name, array: np.array("") if name == "sha256" else array),
    ],
)
def test_a_file_that_is_not_as_it_was_written_is_computed_anew(surface, tmp_path, damage):
    computed = cached_system(surface, tmp_path)
    (path,) = tmp_path.iterdir()
    damage(path)
    again = cached_system(surface, tmp_path)
    np.testing.assert_array_equal(again.traction_kernel.values, computed.traction_kernel.values)
    # And kept in its place.
    with np.load(path) as stored:
        values = stored["traction_values"]
    np.testing.assert_array_equal(values, computed.traction_kernel.values)


def test_integrals_of_another_surface_are_computed_anew(surface, tmp_path):
    mesh = surface.mesh
    other = make_surface(mesh, low_part(mesh), settings=SurfaceSettings(smooth=False))
    cached_system(other, tmp_path)
    (path,) = tmp_path.iterdir()
    path.rename(tmp_path / f"system-{content_hash(surface, Quadrature())}.npz")
    values = cached_system(surface, tmp_path).traction_kernel.values
    np.testing.assert_array_equal(values, assemble_system(surface).traction_kernel.values)


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
        content_hash(surface, Quadrature(tolerance=1e-4)),
    }
    assert len(hashes) == 4


def test_a_cache_that_cannot_be_written_is_said(surface, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    with pytest.raises(InputError, match="cannot be written"):
        cached_system(surface, blocked)


def test_a_full_disk_leaves_no_empty_folder(surface, tmp_path, monkeypatch):
    def full(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module.np, "savez", full)
    with pytest.raises(InputError, match="No space left"):
        cached_system(surface, tmp_path / "kept" / "here")
    assert not list(tmp_path.iterdir())


def test_what_lies_in_the_place_of_the_cache_and_is_no_file_is_said(surface, tmp_path):
    """Reading a pipe would wait for ever."""
    os.mkfifo(tmp_path / f"system-{content_hash(surface, Quadrature())}.npz")
    with pytest.raises(RecordError, match="no regular file"):
        cached_system(surface, tmp_path)

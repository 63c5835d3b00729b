"""What is read back is what was computed, and nothing else is."""

import os

import numpy as np
import pytest
from surfaces import sphere

from palpate.bem import (
    SurfaceSettings,
    cached_system,
    factorise,
    make_surface,
    solve,
    system_slope,
)
from palpate.bem.system import CentredSystem, cache as module, centred_system
from palpate.bem.system.system import assemble_system


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
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("damage", [lambda content: b"", lambda content: content[:1000]])
def test_a_file_that_is_not_as_it_was_written_is_computed_anew(surface, tmp_path, damage):
    computed = cached_system(surface, tmp_path)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    again = cached_system(surface, tmp_path)
    np.testing.assert_array_equal(again.traction_kernel.values, computed.traction_kernel.values)
    # And kept in its place.
    assert path.read_bytes() == whole


def test_all_that_matters_makes_another_file(surface, tmp_path, monkeypatch):
    mesh, held = surface.mesh, low_part(surface.mesh)
    flat = make_surface(mesh, held, settings=SurfaceSettings(smooth=False))
    rolling = make_surface(mesh, held, directions=np.tile(np.diag([0, 0, 1.0]), (held.size, 1, 1)))
    for count, other in enumerate([surface, flat, make_surface(mesh, held[1:]), rolling]):
        values = cached_system(other, tmp_path).traction_kernel.values
        assert len(list(tmp_path.iterdir())) == count + 1
        np.testing.assert_array_equal(values, assemble_system(other).traction_kernel.values)


def test_a_place_that_cannot_be_written_keeps_nothing(surface, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    values = cached_system(surface, blocked).traction_kernel.values
    np.testing.assert_array_equal(values, assemble_system(surface).traction_kernel.values)


def test_what_lies_in_the_place_of_the_cache_and_is_no_file_is_not_read(surface, tmp_path):
    """Reading a pipe would wait for ever."""
    values = cached_system(surface, tmp_path).traction_kernel.values
    (path,) = tmp_path.iterdir()
    path.unlink()
    os.mkfifo(path)
    again = cached_system(surface, tmp_path).traction_kernel.values
    np.testing.assert_array_equal(again, values)


@pytest.mark.parametrize("rolls", [False, True])
def test_factors_are_read_by_the_next_system_of_the_same_body(
    surface, rolls, tmp_path, monkeypatch
):
    if rolls:
        held = low_part(surface.mesh)
        upwards = np.tile(np.diag([0, 0, 1.0]), (held.size, 1, 1))
        surface = make_surface(surface.mesh, held, directions=upwards)
    first = CentredSystem(cached_system(surface, tmp_path), 0.3)
    assert (first.factorised.elimination is not None) == rolls
    monkeypatch.setattr(centred_system, "factorise", None)
    again = CentredSystem(cached_system(surface, tmp_path), 0.3)
    vector = np.random.default_rng(0).normal(size=(first.system.size, 3))
    moved = system_slope(first.system).apply(vector)
    solved = solve(factorise(first.system, 0.3), moved)
    for one in (first, again):
        np.testing.assert_array_equal(one.slope.apply(vector), moved)
        np.testing.assert_array_equal(solve(one.factorised, moved), solved)


@pytest.mark.parametrize("other", [(0.2, False), (0.3, True)])
def test_factors_of_another_kind_are_others(surface, other, tmp_path, monkeypatch):
    """Another ratio, or another precision (which is what it asks for, not what it comes to)."""
    held = cached_system(surface, tmp_path)
    assert CentredSystem(held, 0.3).factorised.poisson_ratio == 0.3
    monkeypatch.setattr(centred_system, "_SMALLEST_SINGLE", 0)
    found = CentredSystem(held, *other).factorised
    assert found.poisson_ratio == other[0]
    assert found.lu.dtype == (np.float32 if other[1] else np.float64)

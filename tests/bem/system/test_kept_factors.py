"""What is kept of a body is what was computed, and nothing else is read."""

import os

import numpy as np
import pytest
from surfaces import sphere

from palpate.bem import (
    CentredSystem,
    Quadrature,
    SurfaceSettings,
    boundary_system,
    factorise,
    make_surface,
    solve,
    system_slope,
)
from palpate.bem.system import centred_system

NU = 0.3


def low_part(mesh):
    """Triangles of the lower third."""
    return np.flatnonzero(mesh.vertices[mesh.triangles].mean(axis=1)[:, 2] < -0.4)


def rolling(mesh):
    """The same part, held upwards only."""
    held = low_part(mesh)
    return make_surface(mesh, held, directions=np.tile(np.diag([0, 0, 1.0]), (held.size, 1, 1)))


@pytest.fixture(scope="module")
def surface():
    mesh = sphere(1)
    return make_surface(mesh, low_part(mesh))


def factors(surface, folder, **options):
    return CentredSystem(boundary_system(surface, cache=folder, **options), NU).factorised.lu


@pytest.mark.parametrize("rolls", [False, True])
def test_factors_are_read_by_the_next_system_of_the_same_body(
    surface, rolls, tmp_path, monkeypatch
):
    body = rolling(surface.mesh) if rolls else surface
    first = CentredSystem(boundary_system(body, cache=tmp_path), NU)
    assert (first.factorised.elimination is not None) == rolls
    monkeypatch.setattr(centred_system, "factorise_with_slope", None)
    again = CentredSystem(boundary_system(body, cache=tmp_path), NU)
    vector = np.random.default_rng(0).normal(size=(first.system.size, 3))
    moved = system_slope(first.system).apply(vector)
    solved = solve(factorise(first.system, NU), moved)
    for one in (first, again):
        np.testing.assert_array_equal(one.slope.apply(vector), moved)
        np.testing.assert_array_equal(solve(one.factorised, moved), solved)
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("damage", [lambda content: b"", lambda content: content[:1000]])
def test_a_file_that_is_not_as_it_was_written_is_computed_anew(surface, tmp_path, damage):
    computed = factors(surface, tmp_path)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    np.testing.assert_array_equal(factors(surface, tmp_path), computed)
    # And kept in its place.
    assert path.read_bytes() == whole


def test_all_that_matters_makes_another_file(surface, tmp_path):
    mesh, held = surface.mesh, low_part(surface.mesh)
    flat = make_surface(mesh, held, settings=SurfaceSettings(smooth=False))
    bodies = [surface, flat, make_surface(mesh, held[1:]), rolling(mesh)]
    for count, body in enumerate(bodies):
        found = factors(body, tmp_path)
        assert len(list(tmp_path.iterdir())) == count + 1
        np.testing.assert_array_equal(found, factors(body, None))
    factors(surface, tmp_path, quadrature=Quadrature(tolerance=1e-4))
    assert len(list(tmp_path.iterdir())) == len(bodies) + 1


def test_a_place_that_cannot_be_written_keeps_nothing(surface, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    np.testing.assert_array_equal(factors(surface, blocked), factors(surface, None))


def test_what_lies_in_the_place_of_the_cache_and_is_no_file_is_not_read(surface, tmp_path):
    """Reading a pipe would wait for ever."""
    values = factors(surface, tmp_path)
    (path,) = tmp_path.iterdir()
    path.unlink()
    os.mkfifo(path)
    np.testing.assert_array_equal(factors(surface, tmp_path), values)


@pytest.mark.parametrize("other", [(0.2, False), (NU, True)])
def test_factors_of_another_kind_are_others(surface, other, tmp_path, monkeypatch):
    """Another ratio, or another precision (which is what it asks for, not what it comes to)."""
    held = boundary_system(surface, cache=tmp_path)
    assert CentredSystem(held, NU).factorised.poisson_ratio == NU
    monkeypatch.setattr(centred_system, "_SMALLEST_SINGLE", 0)
    found = CentredSystem(held, *other).factorised
    assert found.poisson_ratio == other[0]
    assert found.lu.dtype == (np.float32 if other[1] else np.float64)

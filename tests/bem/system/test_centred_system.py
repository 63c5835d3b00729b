"""A system factorised at one Poisson's ratio: single precision where it is good enough, alone."""

import numpy as np
import pytest
from surfaces import box, sphere

from palpate.bem import CentredSystem, boundary_system, face_columns, make_surface, solve
from palpate.bem.system import centred_system as module

NU = 0.3


@pytest.fixture
def for_small_bodies(monkeypatch):
    """Single precision at any size."""
    monkeypatch.setattr(module, "_SMALLEST_SINGLE", 0)


def held_at_low(mesh, axis, share):
    """The system of a body held where it is low along an axis, with a load at its other end."""
    x = mesh.vertices[mesh.triangles][:, :, axis]
    held = np.flatnonzero(x.max(axis=1) < x.min() + share * np.ptp(x))
    system = boundary_system(make_surface(mesh, held))
    loaded = np.argsort(x.mean(axis=1))[-4:]
    return system, face_columns(system, loaded).at(NU)


def test_single_precision_is_good_to_a_hundred_thousandth(for_small_bodies):
    system, right = held_at_low(sphere(2), 2, 0.2)
    single, double = (CentredSystem(system, NU, single=each) for each in (True, False))
    assert single.factorised.lu.dtype == np.float32
    assert single.slope.flux.dtype == np.float32
    found, wanted = (solve(each.factorised, right) for each in (single, double))
    assert found.dtype == float
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-5 * np.abs(wanted).max())
    changed, change = (each.slope.apply(wanted) for each in (single, double))
    assert changed.dtype == float
    # Sums of some thousand products, each to 6e-8.
    np.testing.assert_allclose(changed, change, rtol=0, atol=1e-5 * np.abs(change).max())
    # It is single precision.
    assert np.abs(found - wanted).max() > 1e-12 * np.abs(wanted).max()


def test_rollers_are_eliminated_in_single_precision(for_small_bodies):
    mesh = sphere(2)
    low = np.flatnonzero(mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.5)
    upwards = np.tile(np.diag([0.0, 0.0, 1.0]), (low.size, 1, 1))
    system = boundary_system(make_surface(mesh, low, directions=upwards))
    right = face_columns(system, np.arange(4)).at(NU)
    single, double = (CentredSystem(system, NU, single=each).factorised for each in (True, False))
    assert single.elimination is not None
    assert single.lu.dtype == np.float32
    found, wanted = (solve(each, right) for each in (single, double))
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-5 * np.abs(wanted).max())


@pytest.mark.slow
def test_a_thin_plate_is_solved_in_double_precision(for_small_bodies):
    system, right = held_at_low(box(size=(1.0, 0.6, 0.01), cells=6), 0, 0.25)
    chosen = CentredSystem(system, NU, single=True)
    assert chosen.factorised.lu.dtype == chosen.slope.flux.dtype == float
    double = CentredSystem(system, NU)
    np.testing.assert_array_equal(solve(chosen.factorised, right), solve(double.factorised, right))


def test_small_bodies_are_solved_in_double_precision():
    system, _ = held_at_low(sphere(1), 2, 0.4)
    assert CentredSystem(system, NU, single=True).factorised.lu.dtype == float

"""The contract of a kernel: fields and parts against closed forms and the laws of elasticity."""

import numpy as np
import pytest

from palpate.bem.integrals.kelvin import (
    DISPLACEMENT,
    LANES,
    TRACTION,
    add_point_fields,
    check_material,
    displacement_parts,
    lane_fields,
    traction_parts,
)
from palpate.errors import InputError

SHEAR = 3.0
RATIOS = (-0.5, 0.0, 0.3, 0.5)


def papkovich(r, force, nu):
    """Displacement of a point force from its Papkovich-Neuber potentials, fit for complex r."""
    # 2 G u = 4 (1 - nu) B - grad(r.B), B = force / (8 pi (1 - nu) |r|).
    square = r @ r
    d = np.sqrt(square)
    b = force / (8 * np.pi * (1 - nu) * d)
    gradient = b - r * (r @ b) / square
    return (4 * (1 - nu) * b - gradient) / (2 * SHEAR)


def gradient_by_complex_step(r, force, nu):
    step = 1e-30
    columns = [papkovich(r + 1j * step * np.eye(3)[j], force, nu).imag / step for j in range(3)]
    return np.stack(columns, axis=1)


def some_vectors(count=5):
    rng = np.random.default_rng(3)
    r = rng.normal(size=(count, 3))
    normal = rng.normal(size=(count, 3))
    return r, normal / np.linalg.norm(normal, axis=1)[:, None]


def fields_at(n_fields, r, normal, weight=1.0):
    """Fields of the load points -r seen from the origin, (fields, n)."""
    out = np.zeros((len(r), n_fields))
    for k in range(len(r)):
        source = np.concatenate([r[k], normal[k]])
        add_point_fields(n_fields, np.zeros(3), source, weight, np.ones(1), out[k : k + 1])
    return out.T


def displacement_kernel(r, nu):
    """Component j at r of a unit force along i at the origin, (n, i, j)."""
    constant, slope = displacement_parts(fields_at(DISPLACEMENT, r, np.eye(3)[[0] * len(r)]))
    return np.moveaxis(constant + nu * slope, 2, 0) / (8 * np.pi * SHEAR * (1 - nu))


def traction_kernel(r, normal, nu):
    a, b = traction_parts(fields_at(TRACTION, r, normal))
    return np.moveaxis((1 - 2 * nu) * a + b, 2, 0) / (8 * np.pi * (1 - nu))


@pytest.mark.parametrize("nu", RATIOS)
def test_displacement_is_that_of_the_potentials(nu):
    r, _ = some_vectors()
    kernel = displacement_kernel(r, nu)
    expected = np.stack([[papkovich(x, force, nu) for force in np.eye(3)] for x in r])
    # Round-off only: both are closed forms.
    np.testing.assert_allclose(kernel, expected, rtol=1e-13, atol=1e-16)


@pytest.mark.parametrize("nu", [-0.5, 0.0, 0.3, 0.499])
def test_traction_is_the_stress_of_the_displacement(nu):
    r, normal = some_vectors()
    kernel = traction_kernel(r, normal, nu)
    for x, n, tensor in zip(r, normal, kernel, strict=True):
        for i, force in enumerate(np.eye(3)):
            gradient = gradient_by_complex_step(x, force, nu)
            lame = 2 * SHEAR * nu / (1 - 2 * nu)
            stress = SHEAR * (gradient + gradient.T) + lame * np.trace(gradient) * np.eye(3)
            # lame is 500 G at 0.499 and multiplies a dilation that cancels to 1 / 500: 3 digits
            # lost of 16.
            np.testing.assert_allclose(tensor[i], stress @ n, rtol=1e-11, atol=1e-12)


def test_traction_over_a_closed_surface_balances_the_force():
    # Product rule on the sphere: exact for the polynomials of degree 4 that the kernel is there.
    z, w = np.polynomial.legendre.leggauss(8)
    phi = 2 * np.pi * np.arange(16) / 16
    ring = np.sqrt(1 - z**2)[:, None]
    n = np.stack([ring * np.cos(phi), ring * np.sin(phi), np.tile(z[:, None], 16)], axis=-1)
    weight = np.repeat(w * 2 * np.pi / 16, 16)
    total = np.einsum("n,nij->ij", weight, traction_kernel(n.reshape(-1, 3), n.reshape(-1, 3), 0.3))
    np.testing.assert_allclose(total, -np.eye(3), atol=1e-13)


def test_a_force_here_moves_that_point_as_a_force_there_moves_this_one():
    r, normal = some_vectors()
    for n_fields, sign in ((DISPLACEMENT, 1), (TRACTION, -1)):
        here, there = fields_at(n_fields, r, normal), fields_at(n_fields, -r, normal)
        # Betti: the displacement kernel is even in r, the traction on a plane odd. Round-off.
        np.testing.assert_allclose(there, sign * here, rtol=1e-14)
    kernel = displacement_kernel(r, 0.3)
    np.testing.assert_allclose(kernel, kernel.transpose(0, 2, 1), rtol=1e-14)


@pytest.mark.parametrize(("n_fields", "power"), [(DISPLACEMENT, -1), (TRACTION, -2)])
def test_fields_fall_with_the_distance_and_grow_with_the_weight(n_fields, power):
    r, normal = some_vectors()
    base = fields_at(n_fields, r, normal)
    np.testing.assert_allclose(fields_at(n_fields, 4 * r, normal), 4.0**power * base, rtol=1e-14)
    np.testing.assert_allclose(fields_at(n_fields, r, normal, 2.5), 2.5 * base, rtol=1e-14)
    np.testing.assert_allclose(fields_at(n_fields, r, 2.5 * normal), 2.5 * base, rtol=1e-14)


def test_factors_multiply_the_fields_and_are_added():
    r, normal = some_vectors(1)
    factor, source = np.array([0.5, -2.0]), np.concatenate([r[0], normal[0]])
    for n_fields in (DISPLACEMENT, TRACTION):
        out = np.ones((2, n_fields))
        add_point_fields(n_fields, np.zeros(3), source, 1.0, factor, out)
        expected = 1 + np.outer(factor, fields_at(n_fields, r, normal)[:, 0])
        np.testing.assert_allclose(out, expected, rtol=1e-14)


@pytest.mark.parametrize("n_fields", [TRACTION, DISPLACEMENT])
def test_lanes_are_the_fields_of_each_point(n_fields):
    points = np.random.default_rng(4).normal(size=(LANES, 3)) + 3
    sources = np.random.default_rng(5).normal(size=(4, 6))
    out = np.empty(4 * n_fields * LANES)
    lane_fields(n_fields, np.ascontiguousarray(points.T).ravel(), sources, out)
    values = out.reshape(4, n_fields, LANES)
    for q, source in enumerate(sources):
        normal = np.tile(source[3:], (LANES, 1))
        expected = fields_at(n_fields, source[:3] - points, normal)
        # The reciprocal root is good to 5e-15 and enters to the fifth power; small fields are
        # differences.
        np.testing.assert_allclose(values[q], expected, rtol=1e-11, atol=1e-15)


@pytest.mark.parametrize("shear", [0.0, -1.0, np.nan, np.inf])
def test_impossible_shear_modulus_is_refused(shear):
    with pytest.raises(InputError, match=r"shear_modulus is .* must be positive"):
        check_material(shear, 0.3)


@pytest.mark.parametrize("nu", [-1.0, 0.500001, np.nan])
def test_impossible_poisson_ratio_is_refused(nu):
    with pytest.raises(InputError, match=r"poisson_ratio is .* must be in \(-1, 0.5\]"):
        check_material(1.0, nu)

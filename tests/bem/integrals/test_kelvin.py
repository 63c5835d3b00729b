"""Kelvin's kernels against an independent derivation."""

import numpy as np
import pytest

from palpate.bem.integrals.kelvin import (
    DISPLACEMENT_FIELDS,
    LANES,
    TRACTION_FIELDS,
    check_material,
    displacement_fields,
    kelvin_displacement,
    kelvin_traction,
    traction_fields,
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


@pytest.mark.parametrize("nu", RATIOS)
def test_displacement_is_that_of_the_potentials(nu):
    r, _ = some_vectors()
    kernel = kelvin_displacement(r, SHEAR, nu)
    expected = np.stack([[papkovich(x, force, nu) for force in np.eye(3)] for x in r])
    # Round-off only: both are closed forms.
    np.testing.assert_allclose(kernel, expected, rtol=1e-13, atol=1e-16)


@pytest.mark.parametrize("nu", [-0.5, 0.0, 0.3, 0.499])
def test_traction_is_the_stress_of_the_displacement(nu):
    r, normal = some_vectors()
    kernel = kelvin_traction(r, normal, nu)
    for x, n, found in zip(r, normal, kernel, strict=True):
        for i, force in enumerate(np.eye(3)):
            gradient = gradient_by_complex_step(x, force, nu)
            lame = 2 * SHEAR * nu / (1 - 2 * nu)
            stress = SHEAR * (gradient + gradient.T) + lame * np.trace(gradient) * np.eye(3)
            # lame is 500 G at 0.499 and multiplies a dilation that cancels to 1 / 500: 3 digits
            # lost of 16.
            np.testing.assert_allclose(found[i], stress @ n, rtol=1e-11, atol=1e-12)


def test_traction_over_a_closed_surface_balances_the_force():
    # Product rule on the sphere: exact for the polynomials of degree 4 that the kernel is there.
    z, w = np.polynomial.legendre.leggauss(8)
    phi = 2 * np.pi * np.arange(16) / 16
    ring = np.sqrt(1 - z**2)[:, None]
    n = np.stack([ring * np.cos(phi), ring * np.sin(phi), np.tile(z[:, None], 16)], axis=-1)
    weight = np.repeat(w * 2 * np.pi / 16, 16)
    total = np.einsum("n,nij->ij", weight, kelvin_traction(n.reshape(-1, 3), n.reshape(-1, 3), 0.3))
    np.testing.assert_allclose(total, -np.eye(3), atol=1e-13)


def lanes_of(source):
    rng = np.random.default_rng(4)
    points = rng.normal(size=(LANES, 3)) + 3
    return points, np.ascontiguousarray(points.T).ravel(), source


def test_lane_fields_make_up_the_traction_kernel():
    area = 0.37
    normal = np.array([2.0, -1.0, 2.0]) / 3
    place = np.array([0.3, -0.2, 0.5])
    points, flat, source = lanes_of(np.concatenate([place, area * normal]))
    out = np.empty(TRACTION_FIELDS * LANES)
    traction_fields(flat, source, out)
    x, y, z, xx, yy, zz, yz, zx, xy = out.reshape(TRACTION_FIELDS, LANES)
    skew = np.stack([[0 * x, z, -y], [-z, 0 * x, x], [y, -x, 0 * x]]).transpose(2, 0, 1)
    b = -np.stack([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]]).transpose(2, 0, 1)
    a = skew + np.trace(b, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    nu = 0.2
    expected = area * kelvin_traction(place - points, np.tile(normal, (LANES, 1)), nu)
    # The reciprocal root is good to 5e-15 and enters to the fifth power; fields of size 1e-2
    # cancel.
    np.testing.assert_allclose(
        ((1 - 2 * nu) * a + b) / (8 * np.pi * (1 - nu)), expected, rtol=1e-11, atol=1e-15
    )


def test_lane_fields_make_up_the_displacement_kernel():
    area = 0.37
    normal = np.array([2.0, -1.0, 2.0]) / 3
    place = np.array([0.3, -0.2, 0.5])
    points, flat, source = lanes_of(np.concatenate([place, area * normal]))
    out = np.empty(DISPLACEMENT_FIELDS * LANES)
    displacement_fields(flat, source, out)
    xx, yy, zz, yz, zx, xy = out.reshape(DISPLACEMENT_FIELDS, LANES)
    tensor = np.stack([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]]).transpose(2, 0, 1)
    nu = 0.2
    whole = (3 - 4 * nu) * np.trace(tensor, axis1=1, axis2=2)[:, None, None] * np.eye(3) + tensor
    expected = area * kelvin_displacement(place - points, SHEAR, nu)
    np.testing.assert_allclose(
        whole / (16 * np.pi * SHEAR * (1 - nu)), expected, rtol=1e-12, atol=1e-16
    )


@pytest.mark.parametrize("shear", [0.0, -1.0, np.nan, np.inf])
def test_impossible_shear_modulus_is_refused(shear):
    with pytest.raises(InputError, match=r"shear_modulus is .* must be positive"):
        check_material(shear, 0.3)


@pytest.mark.parametrize("nu", [-1.0, 0.500001, np.nan])
def test_impossible_poisson_ratio_is_refused(nu):
    with pytest.raises(InputError, match=r"poisson_ratio is .* must be in \(-1, 0.5\]"):
        kelvin_displacement(np.ones((1, 3)), 1.0, nu)

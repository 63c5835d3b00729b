"""The compressed operator against the dense matrices, part by part."""

import numba
import numpy as np
import pytest

from palpate.bem.compressed.far_field import KernelWeights
from palpate.bem.system.system import for_each_block

PARTS = {
    "A": KernelWeights(1.0, 0.0, 0.0, 0.0),
    "B": KernelWeights(0.0, 1.0, 0.0, 0.0),
    "constant": KernelWeights(0.0, 0.0, 1.0, 0.0),
    "slope": KernelWeights(0.0, 0.0, 0.0, 1.0),
}


def vectors(system, columns=4):
    rng = np.random.default_rng(5)
    displacement = rng.normal(size=(len(system.surface.mesh.vertices), 3, columns))
    traction = rng.normal(size=(system.unknowns.held_sides.size, 3, columns))
    return displacement, traction


def dense_product(system, weights, displacement, traction):
    """Written from the fields, as `traction_parts` and `displacement_parts` define them."""
    out = np.empty((system.n_points, 3, displacement.shape[2]))

    def add(rows, h, g):
        product = block_product(h, g, weights, displacement, traction)
        out[system.order[rows]] = product

    for_each_block(system, add)
    return out


def block_product(h, g, weights, displacement, traction):
    """The same for some rows, (rows, 3, c)."""
    sx, sy, sz, xx, yy, zz, yz, zx, xy = np.moveaxis(h, 1, 0)
    flux, none = (xx + yy + zz) / 3, np.zeros_like(xx)
    a = np.array([[-flux, sz, -sy], [-sz, -flux, sx], [sy, -sx, -flux]])
    b = -np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])
    xx, yy, zz, yz, zx, xy = np.moveaxis(g, 1, 0)
    trace, none = xx + yy + zz, np.zeros_like(xx)
    tensor = np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])
    ball = np.array([[trace, none, none], [none, trace, none], [none, none, trace]])
    c = 1.5 * ball + 0.5 * tensor
    product = np.einsum(
        "ijnl,njc->lic", weights.skew * a + weights.rest * b, displacement, optimize=True
    )
    return product + np.einsum(
        "ijnl,njc->lic",
        weights.constant * c - 2.0 * weights.slope * ball,
        traction,
        optimize=True,
    )


def test_enough_is_far(compressed):
    tree, far = compressed.operator.far.receivers, compressed.operator.far
    pairs = sum(
        (tree.stop[k] - tree.start[k])
        * (far.sources.stop[far_clusters] - far.sources.start[far_clusters]).sum()
        for k, far_clusters in enumerate(far.far)
    )
    every = len(compressed.collocation.point) * len(compressed.surface.mesh.triangles)
    assert pairs > 0.1 * every


@pytest.mark.parametrize("part", PARTS)
def test_every_part_is_that_of_the_dense_matrices(dense, compressed, part):
    displacement, traction = vectors(dense)
    wanted = dense_product(dense, PARTS[part], displacement, traction)
    applied = compressed.operator.apply(PARTS[part], displacement, traction)
    error = np.linalg.norm(applied - wanted, axis=(0, 1)) / np.linalg.norm(wanted, axis=(0, 1))
    # Single precision leaves 3e-8, 250 charges at two radii 5e-8 of the sum.
    assert error.max() < 2e-7


def test_rigid_translations_give_no_traction(compressed):
    displacement = np.tile(np.eye(3), (len(compressed.surface.mesh.vertices), 1, 1))
    no_traction = np.zeros((compressed.unknowns.held_sides.size, 3, 3))
    for part in ("A", "B"):
        applied = compressed.operator.apply(PARTS[part], displacement, no_traction)
        # Rounding of sums whose terms are of the order of 4 pi.
        assert np.abs(applied).max() < 1e-12


def test_the_number_of_threads_changes_nothing(compressed):
    displacement, traction = vectors(compressed)
    weights = KernelWeights(0.4, 1.0, -1.0, -0.3)
    threads = numba.get_num_threads()
    errors = []
    try:
        for count in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(count)
            errors.append(compressed.operator.apply(weights, displacement, traction))
    finally:
        numba.set_num_threads(threads)
    assert np.array_equal(*errors)

"""Assembled fields: rigid-body sums, threads, blocks, and rows against plain sums."""

from dataclasses import replace

import numba
import numpy as np
import pytest
from surfaces import sphere

from palpate.bem import make_surface
from palpate.bem.integrals.assembly import (
    Collocation,
    add_rigid_body_sum,
    kernel_integrals,
    make_patches,
)
from palpate.bem.integrals.kelvin import DISPLACEMENT, LANES, TRACTION
from palpate.bem.integrals.surface import Quadrature, triangle_rule
from palpate.geometry import QuadraticNodes, element_points, free_nodes, quadratic_shapes, quartered

DEFAULT = Quadrature()
INSIDE = np.array([[0.2, 0.3, 0.5], [0.8, 0.1, 0.1]])


@pytest.fixture(scope="module")
def surface():
    mesh = sphere(2)
    low = np.flatnonzero(mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.5)
    return make_surface(mesh, low)


@pytest.fixture(scope="module")
def collocation(surface):
    """Every vertex, then two points inside triangles: 68 rows, no multiple of the lanes."""
    mesh = surface.mesh
    triangle = np.array([3, 40])
    inner = np.einsum("ak,kai->ki", quadratic_shapes(INSIDE), surface.element_nodes[triangle])
    n = mesh.vertices.shape[0]
    return Collocation(
        np.concatenate([mesh.vertices, inner]),
        np.concatenate([np.arange(n), [-1, -1]]),
        np.concatenate([np.full(n, -1), triangle]),
        np.concatenate([np.zeros((n, 3)), INSIDE]),
    )


def assembled(surface, collocation, kernel, quadrature=DEFAULT):
    nodes = surface.displacement
    integrals = kernel_integrals(surface, collocation, nodes, kernel, quadrature=quadrature)
    return integrals.all_blocks()


def by_row(blocks):
    """(rows, nodes, fields) in the order of the collocation points."""
    out = np.empty((blocks.n_rows, *blocks.values.shape[1:3]))
    for values, rows in zip(blocks.values, blocks.rows, strict=True):
        out[rows] = values.transpose(2, 0, 1)
    return out


def completed(surface, collocation, blocks):
    """The blocks of the traction kernel with the rigid-body sum."""
    values = blocks.values.copy()
    for block, rows in zip(values, blocks.rows, strict=True):
        add_rigid_body_sum(block, rows, collocation, surface.displacement)
    return replace(blocks, values=values)


def test_a_translation_gives_no_traction(surface, collocation):
    blocks = assembled(surface, collocation, TRACTION)
    total = completed(surface, collocation, blocks).values.sum(axis=1)
    # Round-off of 66 nodes with entries up to 2 pi.
    assert np.abs(total).max() < 1e-12


def solid_angles_of_others(surface, levels):
    """Solid angle, from each vertex, of all triangles that do not touch it, as flat facets."""
    triangle = np.arange(surface.held.size)
    cells = np.tile(np.eye(3), (triangle.size, 1, 1))
    for _ in range(levels):
        triangle, cells = quartered(triangle, cells)
    corner = element_points(surface.element_nodes[triangle], cells)[:, :, :3]
    angles = []
    for vertex, position in enumerate(surface.mesh.vertices):
        other = (surface.mesh.triangles[triangle] != vertex).all(axis=1)
        a, b, c = np.moveaxis(corner[other] - position, 1, 0)
        x, y, z = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        # Van Oosterom and Strackee (1983), eq. 8.
        volume = (np.cross(a, b) * c).sum(axis=1)
        rest = x * y * z + (a * b).sum(1) * z + (b * c).sum(1) * x + (c * a).sum(1) * y
        angles.append(2 * np.arctan2(volume, rest).sum())
    return np.array(angles)


def test_the_sum_puts_the_solid_angle_on_the_diagonal(surface, collocation):
    # 3 r.n / r^3 integrates to 3 * 2 pi over a smooth surface seen from itself, with opposite sign
    # on the diagonal.
    quadrature = Quadrature(tolerance=1e-8)
    blocks = assembled(surface, collocation, TRACTION, quadrature)
    raw = by_row(blocks)
    diagonal = np.arange(66)
    flux = raw[:66, :, 3:6].sum(axis=2).sum(axis=1)
    # The value at the point itself is left out in its own triangles. The others are seen at a solid
    # angle that depends on the rim between them alone: here its curved edges in four and in eight
    # chords, whose error falls with the square and is extrapolated.
    coarse, fine = (solid_angles_of_others(surface, levels) for levels in (2, 3))
    np.testing.assert_allclose(flux / 3, fine + (fine - coarse) / 3, rtol=2e-5)
    whole = by_row(completed(surface, collocation, blocks))
    np.testing.assert_allclose(
        whole[diagonal, diagonal, 3:6].sum(axis=1),
        raw[diagonal, diagonal, 3:6].sum(axis=1) - flux,
        atol=1e-12,
    )


def test_threads_do_not_change_a_bit(surface, collocation):
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        single = assembled(surface, collocation, TRACTION).values
        numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
        several = assembled(surface, collocation, TRACTION).values
    finally:
        numba.set_num_threads(before)
    assert np.array_equal(single, several)


@pytest.mark.parametrize("kernel", [TRACTION, DISPLACEMENT])
def test_one_block_is_as_among_all(surface, collocation, kernel):
    every = assembled(surface, collocation, kernel).values
    by_block = kernel_integrals(surface, collocation, surface.displacement, kernel)
    for number, block in enumerate(every):
        assert np.array_equal(by_block.block(number), block)


def test_blocks_hold_every_row_and_pad_with_the_last(surface, collocation):
    blocks = assembled(surface, collocation, DISPLACEMENT)
    flat = blocks.rows.ravel()
    assert blocks.rows.shape == (3, LANES)
    assert np.array_equal(np.sort(flat[:68]), np.arange(68))
    assert (flat[68:] == flat[67]).all()
    padded = blocks.values[-1][:, :, 68 % LANES :]
    assert np.array_equal(padded, np.repeat(blocks.values[-1][:, :, 3:4], LANES - 4, axis=2))


@pytest.mark.parametrize("kernel", [TRACTION, DISPLACEMENT])
def test_a_row_does_not_depend_on_its_block(surface, collocation, kernel):
    together = by_row(assembled(surface, collocation, kernel))
    for row in (0, 31, 66, 67):
        alone = Collocation(
            *(part[row : row + 1] for part in (
                collocation.point, collocation.vertex, collocation.triangle, collocation.barycentric
            ))
        )  # fmt: skip
        single = by_row(assembled(surface, alone, kernel))[0]
        # Alone a point gets the coarsest rule that meets the tolerance of 1e-6, in a block a finer
        # one.
        assert np.abs(single - together[row]).max() < 2e-5 * np.abs(together[row]).max()


@pytest.mark.parametrize("kernel", [TRACTION, DISPLACEMENT])
def test_a_far_row_is_a_plain_sum(surface, kernel):
    point = np.array([[0.3, -2.0, 1.5]])
    off = Collocation(point, np.array([-1]), np.array([-1]), np.zeros((1, 3)))
    integrals = by_row(assembled(surface, off, kernel, Quadrature(tolerance=1e-9)))[0]
    barycentric, weight = triangle_rule(13)
    sources = element_points(surface.element_nodes, barycentric)
    r = sources[..., :3] - point
    d = np.linalg.norm(r, axis=2)
    x, y, z = np.moveaxis(r, 2, 0)
    pairs = np.stack([x * x, y * y, z * z, y * z, z * x, x * y], axis=2) / d[..., None] ** 3
    normal = sources[..., 3:]
    if kernel == DISPLACEMENT:
        fields = pairs * np.linalg.norm(normal, axis=2)[..., None]
    else:
        flux = 3 * (r * normal).sum(axis=2) / d**2
        fields = np.concatenate(
            [np.cross(r, normal) / d[..., None] ** 3, pairs * flux[..., None]], 2
        )
    local = np.einsum("q,aq,mqf->maf", weight, quadratic_shapes(barycentric), fields)
    nodes = surface.displacement
    at_nodes = np.zeros((nodes.n_nodes + nodes.weights.shape[0], kernel))
    np.add.at(at_nodes, nodes.element, local)
    expected = at_nodes[: nodes.n_nodes] + nodes.weights.T @ at_nodes[nodes.n_nodes :]
    # The tolerance asked for, of the largest entry.
    assert np.abs(integrals - expected).max() < 1e-8 * np.abs(expected).max()


@pytest.fixture(scope="module")
def refined_sphere():
    mesh = sphere(2)
    return make_surface(mesh, np.arange(20))


def distributed(patches, integrals, n_nodes):
    """The sums of the kernel, by plain loops: integrals (m, 6) of each triangle's own nodes."""
    out = np.zeros(n_nodes)
    for p, size in enumerate(patches.size):
        sums = np.zeros(size)
        members = slice(patches.triangles[p], patches.triangles[p + 1])
        np.add.at(sums, patches.number[members], integrals[patches.order[members]])
        for s in range(patches.sums[p], patches.sums[p + 1]):
            terms = slice(patches.terms[s], patches.terms[s + 1])
            out[patches.node[s]] += patches.weight[terms] @ sums[patches.own[terms]]
    return out


def all_integrals(nodes, integrals):
    """The same with one vector of all nodes and midside nodes."""
    total = np.zeros(nodes.n_nodes + nodes.weights.shape[0])
    np.add.at(total, nodes.element, integrals)
    return total[: nodes.n_nodes] + nodes.weights.T @ total[nodes.n_nodes :]


@pytest.mark.parametrize("kind", ["displacement", "traction", "free"])
def test_sums_are_those_of_the_weights(refined_sphere, kind):
    displacement = refined_sphere.displacement
    nodes = free_nodes(displacement) if kind == "free" else getattr(refined_sphere, kind)
    centre = refined_sphere.element_nodes[:, :3].mean(axis=1)
    patches = make_patches(centre, nodes)
    assert patches.size.size > 1
    np.testing.assert_array_equal(np.sort(patches.order), np.arange(len(centre)))
    integrals = np.random.default_rng(0).normal(size=(len(centre), 6))
    np.testing.assert_allclose(
        distributed(patches, integrals, nodes.n_nodes),
        all_integrals(nodes, integrals),
        rtol=1e-13,
        atol=1e-13,
    )


def test_no_triangles(refined_sphere):
    nodes = refined_sphere.displacement
    none = QuadraticNodes(nodes.element[:0], nodes.n_nodes, nodes.weights)
    patches = make_patches(np.empty((0, 3)), none)
    assert patches.size.size == patches.node.size == 0
    assert patches.terms.tolist() == [0]

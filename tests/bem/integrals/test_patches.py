"""Patches: every triangle once, and sums that distribute integrals as the nodes' weights do."""

import numpy as np
import pytest
from surfaces import sphere

from palpate.bem import make_surface
from palpate.bem.integrals.patches import make_patches
from palpate.geometry import QuadraticNodes, free_nodes


@pytest.fixture(scope="module")
def surface():
    mesh = sphere(2)
    return make_surface(mesh, np.arange(20))


def distributed(patches, integrals, n_nodes):
    """The sums of the kernel, by plain loops: integrals (m, 6) of each triangle's own nodes."""
    out = np.zeros(n_nodes)
    for p, size in enumerate(patches.size):
        own = np.zeros(size)
        members = slice(patches.triangles[p], patches.triangles[p + 1])
        np.add.at(own, patches.number[members], integrals[patches.order[members]])
        for s in range(patches.sums[p], patches.sums[p + 1]):
            terms = slice(patches.terms[s], patches.terms[s + 1])
            out[patches.node[s]] += patches.weight[terms] @ own[patches.own[terms]]
    return out


def all_integrals(nodes, integrals):
    """The same with one vector of all nodes and midside nodes."""
    total = np.zeros(nodes.n_nodes + nodes.weights.shape[0])
    np.add.at(total, nodes.element, integrals)
    return total[: nodes.n_nodes] + nodes.weights.T @ total[nodes.n_nodes :]


@pytest.mark.parametrize("kind", ["displacement", "traction", "free"])
def test_sums_are_those_of_the_weights(surface, kind):
    displacement = surface.displacement
    nodes = free_nodes(displacement) if kind == "free" else getattr(surface, kind)
    centre = surface.element_nodes[:, :3].mean(axis=1)
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


def test_no_triangles(surface):
    nodes = surface.displacement
    none = QuadraticNodes(nodes.element[:0], nodes.n_nodes, nodes.weights)
    patches = make_patches(np.empty((0, 3)), none)
    assert patches.size.size == patches.node.size == 0
    assert patches.terms.tolist() == [0]

"""Surfaces in a map of moduli against closed forms."""

import numpy as np
import pytest
from surfaces import box

from palpate.geometry import enclosed_volume
from palpate.records import ModulusMap
from palpate.solids import make_solid

CENTRE, RADIUS, RATIO = np.array([0.021, 0.016, 0.014]), 8e-3, 5.0


def map_of(log_modulus, edge, known=lambda x: x[:, 0] > -1.0):
    """A map over a block from a function of place."""
    solid = make_solid(box((0.04, 0.03, 0.03), 4), edge=edge)
    used, corners = np.unique(solid.elements[:, :4], return_inverse=True)
    nodes, tetrahedra = solid.nodes[used], corners.reshape(-1, 4)
    middle = nodes[tetrahedra].mean(axis=1)
    count = len(tetrahedra)
    return ModulusMap(
        nodes, tetrahedra, log_modulus(middle), np.full(count, 0.1), known(middle),
        np.zeros((0, count)),
    )  # fmt: skip


def ball(x):
    return np.where(np.linalg.norm(x - CENTRE, axis=1) < RADIUS, np.log(RATIO), 0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_ball_has_the_surface_of_a_ball(sign):
    """Elements of 2.5 mm lie in it or not by their middles: 1 % of its volume, 0.4 mm of its
    surface."""
    modulus = map_of(lambda x: sign * ball(x), 2.5e-3)
    assert modulus.rest == 1.0
    surface = modulus.isosurface(RATIO ** (0.5 * sign))
    # It faces lower values: outward of a stiff ball, inward of a soft one.
    volume = sign * enclosed_volume(surface)
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * RADIUS**3, rel=0.04)
    distance = np.linalg.norm(surface.vertices - CENTRE, axis=1)
    assert np.abs(distance - RADIUS).mean() < 0.4e-3
    np.testing.assert_allclose(surface.vertices.mean(axis=0), CENTRE, atol=0.2e-3)


def test_a_surface_ends_where_the_modulus_is_not_known():
    modulus = map_of(ball, 4e-3, known=lambda x: x[:, 0] < CENTRE[0])
    surface = modulus.isosurface(RATIO**0.5)
    # Half an element's edge beyond its middle, at most.
    assert surface.vertices[:, 0].max() < CENTRE[0] + 4e-3
    assert surface.vertices[:, 0].min() < CENTRE[0] - 0.8 * RADIUS
    assert modulus.isosurface(2.0 * RATIO) is None


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("share", [0.3, 0.7, 1.0])
def test_faces_enclose_the_elements_on_the_near_side(axis, share):
    modulus = map_of(ball, 0.01)
    corner = modulus.nodes[modulus.tetrahedra]
    near_side = corner.mean(axis=1)[:, axis] <= share * float(modulus.nodes[:, axis].max())
    surface, element = modulus.boundary(near_side)
    assert near_side[element].all()
    volume = np.abs(np.linalg.det(corner[:, 1:] - corner[:, :1]))[near_side].sum() / 6.0
    # Gauss: outward faces give the volume.
    assert enclosed_volume(surface) == pytest.approx(volume, rel=1e-9)

"""The inside of an object, cut open."""

import numpy as np
import pytest
from surfaces import box

from palpate.records import ModulusMap
from palpate.solids.tetrahedra import make_solid
from palpate.viewer.stage import cut_faces, modulus_colours


@pytest.fixture(scope="module")
def modulus():
    solid = make_solid(box((0.04, 0.03, 0.02), 4), edge=0.01)
    used, corners = np.unique(solid.elements[:, :4], return_inverse=True)
    count = len(solid.elements)
    log_modulus = np.linspace(-1.0, 0.5, count)
    return ModulusMap(
        solid.nodes[used], corners.reshape(-1, 4), log_modulus, np.full(count, 0.1),
        np.arange(count) % 3 > 0, np.zeros((0, count)),
    )  # fmt: skip


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("share", [0.3, 0.7, 1.0])
def test_faces_enclose_the_elements_on_the_near_side(modulus, axis, share):
    corner = modulus.nodes[modulus.tetrahedra]
    at = share * float(modulus.nodes[:, axis].max())
    kept = corner.mean(axis=1)[:, axis] <= at
    volumes = np.abs(np.linalg.det(corner[:, 1:] - corner[:, :1])) / 6.0
    faces, element = cut_faces(modulus, axis, at)
    assert kept[element].all()
    # Gauss: outward faces give the volume, and their areas add up to nothing.
    normal = 0.5 * np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    enclosed = float(np.einsum("fi,fi->", normal, faces.mean(axis=1))) / 3.0
    assert enclosed == pytest.approx(volumes[kept].sum(), rel=1e-9)
    np.testing.assert_allclose(normal.sum(axis=0), 0.0, atol=1e-12)


def test_stiffer_is_red_softer_blue_and_what_is_not_known_grey(modulus):
    colours = modulus_colours(modulus).astype(int)
    known = modulus.is_known
    assert np.ptp(colours[~known], axis=0).max() == 0
    softest, stiffest = colours[known][0], colours[known][-1]
    assert softest[2] > softest[0]
    assert stiffest[0] > stiffest[2]

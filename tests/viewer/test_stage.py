"""Colours of the inside of an object."""

import numpy as np
import pytest
from surfaces import box

from palpate.records import ModulusMap
from palpate.solids.tetrahedra import make_solid
from palpate.viewer.stage import modulus_colours


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


def test_stiffer_is_red_softer_blue_and_what_is_not_known_grey(modulus):
    colours = modulus_colours(modulus).astype(int)
    known = modulus.is_known
    assert np.ptp(colours[~known], axis=0).max() == 0
    softest, stiffest = colours[known][0], colours[known][-1]
    assert softest[2] > softest[0]
    assert stiffest[0] > stiffest[2]

"""Parts of a body that differ from the rest, from fields that are known."""

import numpy as np
import pytest
from surfaces import box

from palpate.field import FieldPosterior
from palpate.solids import make_graded_body, make_solid

CENTRE, RADIUS = np.array([0.02, 0.02, 0.025]), 0.01


@pytest.fixture(scope="module")
def body():
    solid = make_solid(box(size=(0.04, 0.04, 0.04), cells=4), edge=5e-3)
    return make_graded_body(solid, np.zeros(len(solid.nodes), dtype=bool))


def posterior(body, ratio, std):
    """One coefficient for a ball, another for the rest."""
    inside = np.linalg.norm(body.means(body.points.reshape(-1, 3)) - CENTRE, axis=1) < RADIUS
    fields = np.stack([inside, ~inside], axis=1).astype(float)
    coefficients = np.array([np.log(ratio), 0.0])
    return FieldPosterior(body.solid, body.volume, fields, coefficients, std**2 * np.eye(2))


@pytest.mark.parametrize("ratio", [4.0, 0.25])
def test_a_ball_is_found_where_it_is(body, ratio):
    (part,) = posterior(body, ratio, 0.1).parts()
    # To half the edge of an element.
    assert np.linalg.norm(np.array(part.centre) - CENTRE) < 2.5e-3
    assert part.size == pytest.approx(2 * RADIUS, rel=0.15)
    assert part.ratio == pytest.approx(ratio)
    # Two independent coefficients of 0.1.
    assert np.log(part.high / part.low) == pytest.approx(2 * 1.96 * 0.1 * np.sqrt(2))
    assert ("stiff" if ratio > 1.0 else "soft") in part.sentence


def test_nothing_is_found_where_nothing_is_known(body):
    found = posterior(body, 4.0, 0.6)
    assert found.parts() == ()
    assert found.known_share == 0.0
    assert not found.map().is_known.any()


def test_the_map_has_every_element(body):
    shown = posterior(body, 4.0, 0.1).map()
    corner = shown.nodes[shown.tetrahedra]
    volume = np.linalg.det(corner[:, 1:] - corner[:, :1]) / 6.0
    assert volume.sum() == pytest.approx(0.04**3, rel=1e-9)
    assert shown.is_known.all()

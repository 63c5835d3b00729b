"""Parts of a body that differ from the rest, from fields that are known."""

from dataclasses import replace

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


def centres(body):
    return body.means(body.points.reshape(-1, 3))


def depth(body):
    """Below the top."""
    return 0.04 - centres(body)[:, 2]


def posterior(body, ratio, std):
    """One coefficient for a ball, another for the rest."""
    inside = np.linalg.norm(centres(body) - CENTRE, axis=1) < RADIUS
    fields = np.stack([inside, ~inside], axis=1).astype(float)
    coefficients, covariance = np.array([np.log(ratio), 0.0]), std**2 * np.eye(2)
    return FieldPosterior(body.solid, body.volume, fields, coefficients, covariance, 0, depth(body))


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


def test_the_outermost_layer_is_told_from_what_lies_in_it(body):
    """A ball, and a layer of 10 mm three times as stiff."""
    ball = posterior(body, 4.0, 0.1)
    outer = (depth(body) < 0.01).astype(float)
    whole = replace(
        ball,
        fields=np.column_stack([ball.fields, outer]),
        coefficients=np.append(ball.coefficients, np.log(3.0)),
        covariance=0.01 * np.eye(3),
        layers=1,
    )
    layer, part = whole.parts()
    assert layer.depth == pytest.approx(0.01, abs=1.5e-3)
    # The ball is in both, but more of it in the rest.
    within, beyond = (
        np.average(ball.fields[:, 0], weights=body.volume * (outer == is_outer))
        for is_outer in (1.0, 0.0)
    )
    assert layer.ratio == pytest.approx(3.0 * 4.0 ** (within - beyond))
    assert "outermost 10 mm or so is at least 2." in layer.sentence
    assert np.linalg.norm(np.array(part.centre) - CENTRE) < 2.5e-3
    assert part.ratio == pytest.approx(4.0)
    assert part.depth == 0.0


def test_a_layer_that_may_be_no_other_is_none(body):
    ball = posterior(body, 1.0, 0.1)
    fields = np.column_stack([ball.fields, (depth(body) < 0.01).astype(float)])
    coefficients = np.array([0.0, 0.0, 0.1])
    nearly = replace(
        ball, fields=fields, coefficients=coefficients, covariance=0.01 * np.eye(3), layers=1
    )
    assert nearly.parts() == ()


def test_nothing_is_found_where_nothing_is_known(body):
    modulus = posterior(body, 4.0, 0.6)
    assert modulus.parts() == ()
    assert modulus.known_share == 0.0
    assert not modulus.map().is_known.any()


def test_the_map_has_every_element(body):
    shown = posterior(body, 4.0, 0.1).map()
    corner = shown.nodes[shown.tetrahedra]
    volume = np.linalg.det(corner[:, 1:] - corner[:, :1]) / 6.0
    assert volume.sum() == pytest.approx(0.04**3, rel=1e-9)
    assert shown.is_known.all()

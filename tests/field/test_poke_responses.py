"""Tools that go in against elements that resolve the contact, and derivatives of the responses."""

from pathlib import Path

import numpy as np
import pytest
from surfaces import box

from palpate.estimation import ProbeObservations, ResponseTerms, Settlement
from palpate.field import PokeResponse, dents, growths, make_poke_model
from palpate.field.field_responses import smooth_prior
from palpate.records import TOOLS, Contact, Probing, Session
from palpate.solids import (
    held_nodes,
    make_graded_body,
    make_solid,
    pressure_load,
    surface_values,
    with_moduli,
)

RATIO, SIZE = 0.45, (0.04, 0.04, 0.02)
# In the middle, and 6 mm from two walls.
PLACES = ((0.02, 0.02, 0.02), (0.006, 0.034, 0.02))


def session(radius=1.5e-3, shape="flat"):
    mesh = box(size=SIZE, cells=8)
    held = np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] < 1e-9).all(axis=1))
    down, tool = np.array([0.0, 0.0, -0.2]), TOOLS[shape](radius)
    probings = tuple(
        Probing(f"p{k}", Contact(np.array(at), radius, "flat", tool=tool), down, None,
                np.array([0.0, 0.0, -1e-3]), np.full(3, 1e-5), None, None)
        for k, at in enumerate(PLACES)
    )  # fmt: skip
    return Session("block", Path(), mesh, held, probings, None, None, None, ())


@pytest.fixture(scope="module")
def model():
    return make_poke_model(session(shape="sphere"), elements=300)


def observed(given, model, modulus):
    force = np.stack([probing.force for probing in given.probings])
    growth = growths(given)
    points = np.array(PLACES)
    return ProbeObservations(
        "pokes", points, np.full_like(points, -1e-3), None, np.zeros(3), np.zeros(3), None, None,
        PokeResponse(force, lambda nu: model.regular(nu) + dents(given, modulus, nu)),
        settlement=Settlement(
            modulus, PokeResponse(force, lambda nu: growth * dents(given, modulus, nu)).value
        ),
    )  # fmt: skip


def predicted(seen, coefficients):
    """Displacement times the modulus, by the response and its errors."""
    value = seen.response.value(RATIO)
    (field,) = seen.nuisances
    terms = ResponseTerms(np.arange(len(value)), value[:, None], RATIO)
    return (value + (field.effects(terms) @ coefficients)[:, 0])[:, 3]


def test_beside_its_field_the_error_of_the_response_is_of_second_order(model):
    given, modulus = session(shape="sphere"), 5e3
    rng = np.random.default_rng(3)
    about, step = 0.5 * rng.normal(size=(2, model.modes.modes.shape[1]))
    none = model.moved(0.0 * about, RATIO)
    prior = smooth_prior(np.eye(len(about)))

    model = model.under(given, [observed(given, model, modulus)])

    def at(coefficients):
        return model.expanded(coefficients, RATIO, none).observations(prior)[0]

    here, errors = at(about), []
    np.testing.assert_allclose(
        predicted(at(0.0 * about), 0.0 * about),
        observed(given, model, modulus).response.value(RATIO)[:, 3],
    )
    for size in (0.1, 0.05):
        there = about + size * step
        errors.append(np.linalg.norm(predicted(here, there) - predicted(at(there), there)))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("layered", [False, True])
def test_a_tool_goes_in_as_with_elements_that_resolve_it(layered):
    """A flat face of 1.5 mm under uniform strain of its pressure, on elements of 4 mm: within 1.5 %
    of the whole for one modulus; within 3 % where the modulus doubles within the body."""
    given = session()
    model = make_poke_model(given, elements=3000)

    def field(x):
        return 0.7 * np.tanh((x[:, 0] - 0.013) / 6e-3) if layered else np.zeros(len(x))

    places = model.body.points.reshape(-1, 3)
    stiffness = with_moduli(model.body, field(places), RATIO)
    seen = (model.load * stiffness.displacements(model.load)).sum(axis=0)
    local = np.exp(-(model.near @ model.body.means(field(places)[:, None])[:, 0]))
    compliance = seen + local * (dents(given, 1.0, RATIO) - (1.0 - RATIO) * model.spread)
    for k, point in enumerate(np.array(PLACES)):
        assert compliance[k] == pytest.approx(
            _resolved(given, point, field), rel=0.03 if layered else 0.015
        )


def _resolved(given, point, field):
    """Compliance under a rigid flat face: its pressure, and the mean displacement with it."""
    radius = 1.5e-3
    solid = make_solid(given.mesh, edge=4e-3, fine=[(point, 1.3 * radius, 0.3e-3)])
    body = make_graded_body(solid, held_nodes(solid, given.held_triangles))
    stiffness = with_moduli(body, field(body.points.reshape(-1, 3)), RATIO)
    share = pressure_load(
        solid, point, radius, lambda s: 1.0 / np.sqrt(np.clip(1.0 - s**2, 1e-3, None))
    )
    load = np.outer(share, [0.0, 0.0, -1.0]).ravel()[:, None]
    moved = stiffness.displacements(load)[:, 0].reshape(-1, 3)
    around = point + 0.5 * radius * np.array(
        [[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]
    )
    return -float((surface_values(solid, around) @ moved)[:, 2].mean())

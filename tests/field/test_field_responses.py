"""Responses with a field against bodies that are solved with it, and the loads' resultants."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from field.caused import session as pushed_cube

from palpate.errors import InputError
from palpate.estimation import ProbeObservations, ResponseTerms
from palpate.field.elements import no_field_reason
from palpate.field.field_responses import PushModel, at_points, make_field_model, smooth_prior
from palpate.records import Support

RATIO, PUSHES = 0.3, (((0.02, 0.02, 0.04), (0.3, 0.1, -1.0)), ((0.01, 0.0, 0.025), (0.0, 2.0, 0.5)))


@dataclass(frozen=True, eq=False)
class Rigid:
    """The response of a body that does not move."""

    rows: int

    def value(self, poisson_ratio):
        return np.zeros((self.rows, 4))


def session():
    return pushed_cube(PUSHES, cells=4)


@pytest.fixture(scope="module")
def model():
    return make_field_model(session(), elements=300)


def observations(points):
    zero = np.zeros(3)
    return [
        ProbeObservations(f"n{k}", points, np.zeros_like(points), None, np.array(force), zero, None,
                          None, Rigid(points.size))
        for k, (_, force) in enumerate(PUSHES)
    ]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Solved:
    """The homogeneous body's response: that of the elements, and a dent that they miss."""

    model: PushModel
    points: np.ndarray
    index: int
    dent: np.ndarray

    def value(self, ratio):
        force = np.array(PUSHES[self.index][1])
        none = np.zeros(self.model.modes.modes.shape[1])
        moved = self.model.moved(none, ratio)[:, self.index]
        columns = np.zeros((self.points.size, 4))
        moved_points = at_points(self.model.body.solid, self.points) @ moved + self.dent
        columns[:, :3] = np.outer(moved_points, force / (force @ force))
        return columns


def with_dents(model, points):
    """The model under observations whose homogeneous response has dents, and these."""
    seen, dents = observations(points), []
    for k, probe in enumerate(seen):
        dents.append(10.0 * np.random.default_rng(k).normal(size=points.size))
        seen[k] = replace(probe, response=Solved(model, points, k, dents[k]))
    return model.under(session(), seen), dents


def drawn(model, seed):
    return 0.5 * np.random.default_rng(seed).normal(size=model.modes.modes.shape[1])


def predicted(seen, ratio, coefficients):
    """Displacement times the modulus, by the response and its errors."""
    value = seen.response.value(ratio)
    terms = ResponseTerms(np.arange(len(value)), value[:, None], ratio)
    (field,) = seen.nuisances
    value = value + (field.effects(terms) @ coefficients)[:, 0]
    return value[:, :3] @ seen.force


def test_forces_are_those_of_the_probings(model):
    resultant = model.load.reshape(-1, 3, len(PUSHES)).sum(axis=0).T
    assert np.allclose(resultant, [force for _, force in PUSHES], rtol=1e-12)


def test_about_its_field_the_response_is_that_of_the_body_with_it(model):
    """And what elements miss of a dent goes with the modulus under the tool."""
    points, about = np.array([[0.03, 0.03, 0.04], [0.0, 0.02, 0.03]]), drawn(model, 1)
    model, dents = with_dents(model, points)
    none = model.moved(0.0 * about, RATIO)
    expansion = model.expanded(about, RATIO, none).with_slope()
    softer = np.exp(-model.under_loads @ about)
    assert np.ptp(softer) > 0.1
    for k, seen in enumerate(expansion.observations(smooth_prior(np.eye(len(about))))):
        for ratio in (RATIO, RATIO + 0.01):
            from_nodes = at_points(model.body.solid, points)
            expected = from_nodes @ model.moved(about, ratio)[:, k] + softer[k] * dents[k]
            change = (
                from_nodes @ (model.moved(about, ratio) - model.moved(0.0 * about, ratio))[:, k]
            )
            # A step of 0.01 of nu changes the difference by 1 %; its derivative leaves a hundredth.
            off = predicted(seen, ratio, about) - expected
            assert np.abs(off).max() < 1e-3 * np.abs(change).max()


def test_beside_its_field_the_error_of_the_response_is_of_second_order(model):
    solid = model.body.solid
    corners = np.unique(solid.facets[:, :3])
    nodes = solid.nodes[corners[~model.body.held[corners]][::9]]
    model, dents = with_dents(model, nodes)
    about, step = drawn(model, 2), drawn(model, 3)
    expansion = model.expanded(about, RATIO, model.moved(0.0 * about, RATIO))
    seen = expansion.observations(smooth_prior(np.eye(len(about))))[0]
    errors = []
    for size in (0.1, 0.05):
        there = about + size * step
        softer = np.exp(-model.under_loads[0] @ there)
        moved = at_points(solid, nodes) @ model.moved(there, RATIO)[:, 0] + softer * dents[0]
        off = predicted(seen, RATIO, there) - moved
        errors.append(np.linalg.norm(off))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)


def test_what_has_no_field_says_why():
    given = session()
    assert no_field_reason(given) == ""
    first = given.probings[0]
    harder = replace(first, name="harder", force=2.0 * first.force)
    for one_place in ((first,), (first, harder)):
        assert "several" in no_field_reason(replace(given, probings=one_place))
    aside = replace(first, name="aside", force=first.force[[1, 2, 0]])
    assert no_field_reason(replace(given, probings=(first, aside))) == ""
    springs = replace(given, supports=(Support(given.held_triangles, stiffness=1e6),))
    assert "springs" in no_field_reason(springs)
    with pytest.raises(InputError, match="--material homogeneous"):
        make_field_model(springs)

"""Where to push next: places that can be reached, and information that adds up."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from surfaces import box

from palpate.errors import InputError
from palpate.estimation import cramer_rao_bound
from palpate.geometry import closest_points
from palpate.pipeline import (
    NextProbings,
    graded_observations,
    make_object_model,
    plan_next,
    session_observations,
)
from palpate.pipeline.planning import next_probings
from palpate.records import Contact, DisplacementField, Probing, Session

SHEAR, NU, RADIUS = 2e4, 0.3, 5e-3


def _session(depth: float = 1.0) -> Session:
    """A glued cube of 4 cm, pressed from above, seen on its free faces."""
    mesh = box((0.04, 0.04, 0.04), 6)
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    points = mesh.vertices[mesh.vertices[:, 2] > 1e-6]
    place = closest_points(mesh, points)
    contact = Contact(np.array([0.02, 0.02, 0.04]), RADIUS, "smooth")
    force, std = np.array([0.0, 0.0, -1.0]), np.full_like(points, 2e-5)
    field = DisplacementField(points, np.zeros_like(points), std, None, place, "")
    probing = Probing("n", contact, force, np.full(3, 5e-3), None, None, field, None)
    still = Session("cube", Path(), mesh, held, (probing,), None, None, None, ())
    (seen,) = session_observations(still, make_object_model(still))
    moved = (seen.response.value(NU)[:, :4] @ np.append(force, 1.0) / SHEAR).reshape(-1, 3)
    rng = np.random.default_rng(0)
    moved = depth * moved + 2e-5 * rng.normal(size=moved.shape)
    field = DisplacementField(points, moved, std, None, place, "")
    probing = Probing("n", contact, force, np.full(3, 5e-3), None, None, field, None)
    return Session("cube", Path(), mesh, held, (probing,), None, None, None, ())


@pytest.fixture(scope="module")
def found() -> NextProbings:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(next_probings, "_CANDIDATES", 10)
        return plan_next(_session(), count=3)


def test_places_can_be_reached(found: NextProbings) -> None:
    assert len(found.point) == 10
    # Off the edges of the cube, its foot, and the place that is measured; never from below.
    beside = np.sort(np.minimum(found.point, 0.04 - found.point), axis=1)
    assert (beside[:, 1] > 1.3 * RADIUS - 1e-12).all()
    assert (np.linalg.norm(found.point - [0.02, 0.02, 0.04], axis=1) > RADIUS).all()
    assert (found.inward[:, 2] < 0.1).all()
    # Inward on a flat face.
    np.testing.assert_allclose(np.abs(found.inward).max(axis=1), 1.0, atol=1e-12)


def test_each_push_tells_more(found: NextProbings) -> None:
    for name in ("poisson_ratio", "shear_modulus", "young_modulus"):
        sd = [found.now[name], *(one[name] for one in found.after)]
        assert all(b < a for a, b in itertools.pairwise(sd))
    assert len(set(found.chosen)) == 3
    # The first is the best of all alone.
    determinant = [np.linalg.det(found.information.of([0, 1 + k])) for k in range(10)]
    assert found.chosen[0] == int(np.argmax(determinant))


def test_information_is_that_of_the_bound(found: NextProbings) -> None:
    """One probing by itself, at the constants that were found."""
    session = _session()
    observed = graded_observations(session)
    of_one = cramer_rao_bound(
        observed,
        poisson_ratio=found.information.poisson_ratio,
        shear_modulus=found.information.shear_modulus,
    )
    for name, value in found.now.items():
        # The plan's mesh has more vertices at the edges.
        assert value == pytest.approx(of_one[name], rel=0.1)


def test_what_cannot_be_planned() -> None:
    session = _session()
    with pytest.raises(InputError, match="count is 0"):
        plan_next(session, count=0)

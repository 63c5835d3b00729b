"""Plans keep what they promise, and are refused where they could not."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lab.lab_configs import HALF_BALL
from lab.planned_sessions import planned_session
from surfaces import box

from palpate.checkpoints import Memory
from palpate.errors import InputError
from palpate.estimation import fisher_information
from palpate.field.field_responses import at_points, make_field_model
from palpate.geometry import closest_points
from palpate.lab import choose_variant, make_session, read_lab_config
from palpate.pipeline import (
    PREDICTION,
    Material,
    NextProbings,
    fit_session,
    fitted_body,
    graded_observations,
    make_object_model,
    places,
    plan_measurement,
    plan_next,
    planning,
    session_observations,
    with_pictures_measured,
)
from palpate.records import Contact, DisplacementField, Probing, Session, read_session
from palpate.solids import with_moduli

GUESS = {"young_modulus": 52e3, "poisson_ratio": 0.21}
SHEAR, NU, RADIUS = 2e4, 0.3, 5e-3


@pytest.fixture(scope="module")
def variant():
    pytest.importorskip("mitsuba", reason="needs Mitsuba, the extra `lab`, which is not installed")
    return choose_variant()


@pytest.fixture(scope="module")
def session(tmp_path_factory, variant):
    """What the facility measured, in finite elements, with a texture and noise of its own."""
    folder = tmp_path_factory.mktemp("plan")
    (folder / "config.toml").write_text(HALF_BALL.replace("steps = 2", "steps = 1"))
    made = folder / "made"
    made.mkdir()
    make_session(read_lab_config(folder / "config.toml"), made, variant=variant)
    return read_session(made)


@pytest.fixture(scope="module")
def shown():
    return {}


@pytest.fixture(scope="module")
def plan(session, variant, shown):
    return plan_measurement(session, variant=variant, show=shown.__setitem__, **GUESS)


def test_a_plan_keeps_what_it_promises(session, plan):
    fields = [probing.displacement for probing in with_pictures_measured(session).probings]
    for planned, field in zip(plan.probings, fields, strict=True):
        measured = np.isfinite(field.displacement).all(axis=1)
        # What is asked of a plan.
        assert planned.seen == pytest.approx(measured.sum(), rel=0.25)
        sigma = np.median(np.sqrt((field.std[measured] ** 2).mean(axis=1)))
        assert planned.sigma == pytest.approx(sigma, rel=0.25)
        moved = np.median(np.linalg.norm(field.displacement[measured], axis=1))
        # A deep press on a coarse mesh: the facility's body is finer.
        assert planned.displacement == pytest.approx(moved, rel=0.25)


def test_the_precision_is_that_of_small_pictures(plan):
    assert plan.precision == plan.probings[0].precision
    # Pictures of a thumbnail's size: E to some per cent, nu to some hundredths.
    assert 0.007 < plan.precision["young_modulus"] / GUESS["young_modulus"] < 0.1
    assert 0.002 < plan.precision["poisson_ratio"] < 0.05


def test_every_picture_is_shown_with_its_tool(plan, shown):
    assert set(shown) == {f"{a}_{b}" for a in ("rest", "n01") for b in ("c0", "c1", "c2")}
    # Dark where the object was: the tool.
    hidden = (shown["rest_c0"] > 100) & (shown["n01_c0"] < 40)
    assert hidden.sum() > 50
    assert plan.visible.keys() == {"c0", "c1", "c2"}
    assert all(0.6 < share < 1.0 for share in plan.visible.values())


def test_what_cannot_be_planned_is_refused(session, tmp_path, variant):
    asked = {**GUESS, "variant": variant}
    with pytest.raises(InputError, match=r"young_modulus is 0 Pa"):
        plan_measurement(session, young_modulus=0.0, poisson_ratio=0.2, variant=variant)
    blind = tuple(replace(probing, images=None) for probing in session.probings)
    without = replace(session, rig=None, probings=blind)
    with pytest.raises(InputError, match="has no cameras"):
        plan_measurement(without, **asked)
    folder = planned_session(tmp_path)
    text = (folder / "rig.toml").read_text()
    (folder / "rig.toml").write_text(text.replace("size = [200, 160]\n", "", 1))
    with pytest.raises(InputError, match="camera 'c0' has no size"):
        plan_measurement(read_session(folder), **asked)


def test_cameras_that_look_away_are_refused(tmp_path, variant):
    folder = planned_session(tmp_path)
    text = (folder / "rig.toml").read_text()
    lines = [
        f"t = [9.0,{line.partition(',')[2]}" if line.startswith("t = ") else line
        for line in text.splitlines()
    ]
    (folder / "rig.toml").write_text("\n".join(lines))
    with pytest.raises(InputError, match="no vertex of the object is seen by two cameras"):
        plan_measurement(read_session(folder), variant=variant, **GUESS)


def _session(depth: float = 1.0) -> Session:
    """A glued cube of 4 cm, pressed from above, seen on its free faces."""
    mesh = box((0.04, 0.04, 0.04), 6)
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    points = mesh.vertices[mesh.vertices[:, 2] > 1e-6]
    surface = closest_points(mesh, points)
    contact = Contact(np.array([0.02, 0.02, 0.04]), RADIUS, "smooth")
    force, std = np.array([0.0, 0.0, -1.0]), np.full_like(points, 2e-5)
    field = DisplacementField(points, np.zeros_like(points), std, None, surface, "")
    probing = Probing("n", contact, force, np.full(3, 5e-3), None, None, field, None)
    still = Session("cube", Path(), mesh, held, (probing,), None, None, None, ())
    (seen,) = session_observations(still, make_object_model(still))
    moved = (seen.response.value(NU)[:, :4] @ np.append(force, 1.0) / SHEAR).reshape(-1, 3)
    rng = np.random.default_rng(0)
    moved = depth * moved + 2e-5 * rng.normal(size=moved.shape)
    field = DisplacementField(points, moved, std, None, surface, "")
    probing = Probing("n", contact, force, np.full(3, 5e-3), None, None, field, None)
    return Session("cube", Path(), mesh, held, (probing,), None, None, None, ())


@pytest.fixture(scope="module")
def found() -> NextProbings:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(places, "MOST_PLACES", 10)
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
        sd = [found.now[name], *(precision[name] for precision in found.after)]
        assert all(b < a for a, b in itertools.pairwise(sd))
    assert len(set(found.chosen)) == 3
    # The first is the best of all alone.
    determinant = [np.linalg.det(found.information.of([0, 1 + k])) for k in range(10)]
    assert found.chosen[0] == int(np.argmax(determinant))


def test_information_is_that_of_the_bound(found: NextProbings) -> None:
    """One probing by itself, at the constants that were found."""
    session = _session()
    observed = graded_observations(session)
    of_one = fisher_information(
        observed,
        poisson_ratio=found.information.poisson_ratio,
        shear_modulus=found.information.shear_modulus,
    ).bound()
    for name, value in found.now.items():
        # The plan's mesh has more vertices at the edges.
        assert value == pytest.approx(of_one[name], rel=0.1)


def test_a_plan_goes_on_from_another(found: NextProbings) -> None:
    """After a push at the best place the rest is compared as if nothing had been known."""
    session = _session()
    (first,) = session.probings
    best = found.chosen[0]
    contact = replace(first.contact, point=found.point[best])
    second = replace(first, name="m", contact=contact, force=found.force * found.inward[best])
    session = replace(session, probings=(first, second))
    fitted = fitted_body(fit_session(session))
    memory = Memory()
    after = plan_next(session, fitted=fitted, known=found, cache=memory)
    # Only the place that was measured is left out; the mesh's surface and its factors are kept.
    np.testing.assert_array_equal(after.point, np.delete(found.point, best, axis=0))
    assert len(memory) == 2
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planning, "reachable_places", lambda *_, **__: (after.point, after.inward))
        anew = plan_next(session, fitted=fitted)
    for updated, other in zip(after.alone, anew.alone, strict=True):
        # Both have the same forces, contacts and points: what differs is rounding in the models.
        assert updated == pytest.approx(other, rel=1e-6)
    assert after.chosen == anew.chosen


def test_what_is_kept_in_memory_changes_no_bit() -> None:
    """Surfaces and factors of the fit before, with other forces."""
    session, memory = _session(), Memory()
    (first,) = session.probings
    other = replace(session, probings=(replace(first, force=1.1 * first.force),))
    fit_session(other, cache=memory, material=Material.AUTO)
    before = dict(memory)
    estimate = fit_session(session, cache=memory, material=Material.AUTO).estimate
    # All was there: five surfaces, of four meshes and two kinds of fits, and the factors of all but
    # the given one, whose faces are one element wide.
    assert memory.keys() == before.keys()
    assert len(before) == 9
    anew = fit_session(session, material=Material.AUTO).estimate
    assert estimate.young_modulus == anew.young_modulus
    assert estimate.poisson_ratio == anew.poisson_ratio


def _two_halves() -> Session:
    """The cube, pressed on top and from three sides; one half is three times as stiff."""
    plain, side = _session(), 0.04
    pressed = (
        ([0.02, 0.02, side], [0.0, 0.0, -1.0]),
        ([0.0, 0.015, 0.025], [1.0, 0.0, 0.0]),
        ([side, 0.02, 0.03], [-1.0, 0.0, 0.0]),
        ([0.025, 0.0, 0.02], [0.0, 1.0, 0.0]),
    )
    (first,) = plain.probings
    probings = tuple(
        replace(
            first, name=f"n{k}", contact=replace(first.contact, point=np.array(point)),
            force=np.array(force),
        )
        for k, (point, force) in enumerate(pressed)
    )  # fmt: skip
    session = replace(plain, probings=probings)
    model = make_field_model(session, elements=600)
    log_modulus = np.where(model.body.points[..., 0].ravel() > 0.5 * side, np.log(3.0), 0.0)
    nodes = with_moduli(model.body, log_modulus, NU).displacements(model.load) / SHEAR
    moved = (at_points(model.body.solid, first.displacement.points) @ nodes).T
    rng = np.random.default_rng(1)
    fields = [
        replace(
            first.displacement,
            displacement=u.reshape(-1, 3) + 2e-5 * rng.normal(size=(len(u) // 3, 3)),
        )
        for u in moved
    ]
    pairs = zip(probings, fields, strict=True)
    return replace(session, probings=tuple(replace(a, displacement=b) for a, b in pairs))


@pytest.mark.slow
def test_of_a_body_of_two_materials_pushes_tell_what_others_will_do(monkeypatch):
    monkeypatch.setattr(places, "MOST_PLACES", 6)
    next_pushes = plan_next(_two_halves(), count=2)
    sd = [next_pushes.now[PREDICTION], *(precision[PREDICTION] for precision in next_pushes.after)]
    assert all(after < before for before, after in itertools.pairwise(sd))
    alone = [precision[PREDICTION] for precision in next_pushes.alone]
    assert next_pushes.chosen[0] == int(np.argmin(alone))


def test_what_cannot_be_planned() -> None:
    session = _session()
    with pytest.raises(InputError, match="count is 0"):
        plan_next(session, count=0)

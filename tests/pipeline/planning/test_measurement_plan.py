"""Plans: precision follows noise, stiffness and the number of probings, as theory has it."""

from dataclasses import replace

import numpy as np
import pytest
from lab.planned_sessions import SESSION, planned_session

from palpate.errors import InputError
from palpate.pipeline import plan_measurement
from palpate.records import EXACT, read_rig, read_session
from palpate.vision import project, triangulate

GUESS = {"young_modulus": 5e4, "poisson_ratio": 0.2}


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    return read_session(planned_session(tmp_path_factory.mktemp("plan")))


@pytest.fixture(scope="module")
def plan(session):
    return plan_measurement(session, **GUESS)


def test_probings_together_tell_more_than_each(plan):
    assert [one.name for one in plan.probings] == ["n01", "n02"]
    for name, value in plan.precision.items():
        assert value < min(one.precision[name] for one in plan.probings)
    # E / (2 (1 + nu)): half a ball pressed by half a newton at 50 kPa is told to a few percent.
    assert 0.007 * 5e4 < plan.precision["young_modulus"] < 0.03 * 5e4
    assert 0.002 < plan.precision["poisson_ratio"] < 0.02


def test_without_other_errors_the_bound_follows_the_matches(session, monkeypatch):
    monkeypatch.setattr("palpate.pipeline.planning.measurement_plan.SCALE_ERROR", 0.0)
    exact = replace(
        session,
        errors=EXACT,
        probings=tuple(replace(one, force_std=np.full(3, 1e-9)) for one in session.probings),
    )
    fine, rough = (plan_measurement(exact, matching_noise=noise, **GUESS) for noise in (0.01, 0.02))
    for name, value in rough.precision.items():
        assert value == pytest.approx(2.0 * fine.precision[name], rel=1e-6)
    for one, other in zip(fine.probings, rough.probings, strict=True):
        assert other.sigma == pytest.approx(2.0 * one.sigma, rel=1e-12)
        assert other.displacement == one.displacement


def test_twice_as_stiff_moves_half_as_far(session, plan):
    stiff = plan_measurement(session, young_modulus=1e5, poisson_ratio=0.2)
    for one, other in zip(plan.probings, stiff.probings, strict=True):
        assert other.displacement == pytest.approx(0.5 * one.displacement, rel=1e-9)
        assert other.seen == one.seen


def test_sigma_is_that_of_a_triangulation(session, plan):
    rig = read_rig(session.rig)
    vertices = session.mesh.vertices
    # Around the pole all three cameras see everything.
    top = vertices[vertices[:, 2] > 0.036]
    pixels = np.stack([project(camera, top) for camera in rig.cameras])
    found = triangulate(rig, pixels, 0.01)
    sigma = np.sqrt(np.trace(found.covariance, axis1=1, axis2=2) / 3.0)
    # A camera that drops out elsewhere costs some.
    assert np.median(sigma) <= plan.probings[0].sigma < 1.4 * np.median(sigma)


def test_cameras_on_one_side_see_less_than_the_dome(plan):
    assert set(plan.visible) == {"c0", "c1", "c2"}
    assert all(0.6 < share < 1.0 for share in plan.visible.values())


def test_the_tool_hides_its_place(session, plan):
    wide = SESSION.replace("radius = 0.004", "radius = 0.012")
    folder = session.path.parent.parent / "wide"
    folder.mkdir()
    hidden = plan_measurement(read_session(planned_session(folder, wide)), **GUESS)
    assert all(a.seen < b.seen for a, b in zip(hidden.probings, plan.probings, strict=True))


def test_what_cannot_be_planned_is_refused(session, tmp_path):
    with pytest.raises(InputError, match=r"young_modulus is 0 Pa"):
        plan_measurement(session, young_modulus=0.0, poisson_ratio=0.2)
    with pytest.raises(InputError, match=r"matching_noise is -1 px; must be positive"):
        plan_measurement(session, matching_noise=-1.0, **GUESS)
    wide = replace(session.probings[0].contact, radius=1.0)
    covered = replace(session, probings=(replace(session.probings[0], contact=wide),))
    with pytest.raises(InputError, match="all that two cameras see lies under the tool"):
        plan_measurement(covered, **GUESS)
    blind = tuple(replace(one, images=None) for one in session.probings)
    without = replace(session, rig=None, probings=blind)
    with pytest.raises(InputError, match="has no cameras"):
        plan_measurement(without, **GUESS)
    folder = planned_session(tmp_path)
    text = (folder / "rig.toml").read_text()
    (folder / "rig.toml").write_text(text.replace("size = [200, 160]\n", "", 1))
    with pytest.raises(InputError, match="camera 'c0' has no size"):
        plan_measurement(read_session(folder), **GUESS)


def test_cameras_that_look_away_are_refused(session, tmp_path):
    folder = planned_session(tmp_path)
    text = (folder / "rig.toml").read_text()
    lines = [
        f"t = [9.0,{line.partition(',')[2]}" if line.startswith("t = ") else line
        for line in text.splitlines()
    ]
    (folder / "rig.toml").write_text("\n".join(lines))
    with pytest.raises(InputError, match="no vertex of the object is seen by two cameras"):
        plan_measurement(read_session(folder), **GUESS)

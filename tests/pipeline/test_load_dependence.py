"""Pushes of unlike force at one place: a stiffening object is told from a linear one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from surfaces import box

from palpate.estimation import FitSettings, joint_minimum
from palpate.geometry import closest_points
from palpate.pipeline import graded_session, make_object_model, session_observations
from palpate.pipeline.load_dependence import is_shown, load_dependence
from palpate.records import Contact, DisplacementField, Probing, Session

SHEAR, NU, NOISE = 2e4, 0.3, 0.02
PLACES = ([0.02, 0.02, 0.04], [0.04, 0.02, 0.03])
INWARD = ([0.0, 0.0, -1.0], [-1.0, 0.0, 0.0])
FORCES = (0.3, 0.6, 1.2)


@pytest.fixture(scope="module")
def pushed():
    """A cube pressed at two places with three forces each, and the model's observations of it with
    what a linear object moves by."""
    mesh = box(size=(0.04, 0.04, 0.04), cells=6)
    held = np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] < 1e-9).all(axis=1))
    seen = np.flatnonzero(mesh.vertices[:, 2] > 0.005)
    points = mesh.vertices[seen]
    field = DisplacementField(
        points, np.zeros_like(points), None, seen, closest_points(mesh, points), ""
    )
    probings = tuple(
        Probing(
            name=f"{spot}{force}", contact=Contact(np.array(PLACES[spot]), 0.006, "smooth"),
            force=force * np.array(INWARD[spot]), force_std=np.full(3, 0.01 * force),
            tip_displacement=None, tip_displacement_std=None, displacement=field, images=None,
        )
        for spot in range(2) for force in FORCES
    )  # fmt: skip
    nothing = (None, None, None)
    session = Session("cube", Path("cube"), mesh, held, probings, *nothing, ())
    session = graded_session(session)
    return session, session_observations(session, make_object_model(session))


def drawn(pushed, seed: int, exponent: float = 0.0, **noise: float):
    """The dependence found in one draw of noise and of forces that are off."""
    return load_dependence(pushed[0], fitted(pushed, seed, exponent, **noise))


def fitted(pushed, seed: int, exponent: float, **noise: float):
    """One modulus fitted to such a draw."""
    _, observations = pushed
    rng = np.random.default_rng(seed)
    probes = []
    for seen in observations:
        size = float(np.linalg.norm(seen.force))
        true = seen.force * (1.0 + noise.get("force", 0.01) * rng.normal())
        modulus = SHEAR * (size / 0.6) ** exponent
        moved = (seen.response.value(NU)[:, :3] @ true / modulus).reshape(-1, 3)
        level = noise.get("points", NOISE) * float(np.sqrt((moved**2).mean()))
        moved = moved + level * rng.normal(size=moved.shape)
        probes.append(replace(seen, displacement=moved))
    return joint_minimum(probes, FitSettings())


@pytest.mark.parametrize("exponent", [0.0, 0.1, -0.1])
def test_exact_data_give_the_exponent(pushed, exponent):
    minimum = fitted(pushed, 0, exponent, force=0.0, points=1e-6)
    dependence = load_dependence(pushed[0], minimum)
    assert dependence.exponent.value == pytest.approx(exponent, abs=1e-4)
    assert dependence.force == pytest.approx((0.3, 1.2))
    # nu takes up a little of what one modulus leaves over.
    modulus = minimum.shear_modulus * np.array(dependence.factor)
    assert modulus == pytest.approx(SHEAR * np.array([0.5, 2.0]) ** exponent, rel=2e-3)


def test_errors_are_as_large_as_said(pushed):
    dependences = [drawn(pushed, seed, 0.05) for seed in range(40)]
    z = np.array(
        [(dependence.exponent.value - 0.05) / dependence.exponent.std for dependence in dependences]
    )
    # Of 40 standard normals the root mean square is 1 +- 0.11.
    assert 0.6 < np.sqrt((z**2).mean()) < 1.35
    assert abs(z.mean()) < 4 / np.sqrt(40)


def test_a_linear_object_is_seldom_called_stiffening(pushed):
    assert sum(is_shown(drawn(pushed, 100 + seed)) for seed in range(40)) <= 1


def test_a_modulus_that_rises_by_a_fifth_is_seen(pushed):
    exponent = np.log(1.2) / np.log(4.0)
    dependences = [drawn(pushed, 200 + seed, exponent) for seed in range(10)]
    assert all(map(is_shown, dependences))
    assert np.mean(
        [dependence.factor[1] / dependence.factor[0] for dependence in dependences]
    ) == pytest.approx(1.2, abs=0.02)


def test_forces_of_one_size_tell_nothing(pushed):
    session, observations = pushed
    chosen = [1, 4]
    only = replace(session, probings=tuple(session.probings[k] for k in chosen))
    probes = [observations[k] for k in chosen]
    moved = [probe.response.value(NU)[:, :3] @ probe.force / SHEAR for probe in probes]
    probes = [
        replace(probe, displacement=displacement.reshape(-1, 3))
        for probe, displacement in zip(probes, moved, strict=True)
    ]
    assert load_dependence(only, joint_minimum(probes, FitSettings())) is None

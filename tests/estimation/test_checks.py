"""What contradicts a model, and which force is left out: sound sessions, and one fault each."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.fitted import RANGE, minimum_of, problem_of
from estimation.half_space import HalfSpace, half_space_probes
from scipy.stats import norm

from palpate.estimation import (
    ProbeObservations,
    checks,
    fit,
)
from palpate.estimation.checks import (
    contradictions,
    force_deviations,
    with_outlying_forces_freed,
)
from palpate.estimation.gauss_newton import fitted
from palpate.estimation.measured_components import observed_rows_of
from palpate.estimation.noise import StudentT
from palpate.pipeline.model.shared_errors import force_gain
from palpate.pipeline.observations import model_step


def _probes(seed: int = 1, **options: object) -> list[ProbeObservations]:
    given = {"count": 8, "grid": 8, "noise": 1e-5, "force_noise": 0.01} | options
    return half_space_probes(np.random.default_rng(seed), **given)


def _fitted(probes: list[ProbeObservations]):
    return fitted(tuple(map(observed_rows_of, probes)), StudentT(), RANGE)


def test_the_deviation_of_a_force_is_what_setting_it_free_gains() -> None:
    """Squared, along a force of which only the component along it is uncertain."""
    probes = []
    for probe in _probes(count=4):
        along = np.array([0.0, 0.0, np.linalg.norm(probe.force)])
        moved = probe.response.value(0.3)[:, :3] @ along / 2e4
        noise = 1e-5 * np.random.default_rng(len(probes)).normal(size=probe.displacement.shape)
        std = np.array([0.0, 0.0, 0.01 * along[2]])
        probes.append(
            replace(
                probe, force=along * (1.0 + 0.01 * len(probes)), force_std=std,
                displacement=moved.reshape(-1, 3) + noise,
            )
        )  # fmt: skip
    held = minimum_of(problem_of(probes))
    deviation = force_deviations(held)
    for index in range(4):
        wide = replace(probes[index], force_std=1e4 * probes[index].force_std)
        free = minimum_of(problem_of([*probes[:index], wide, *probes[index + 1 :]]))
        # Linear to the square of the errors, a few per cent.
        assert deviation[index] ** 2 == pytest.approx(held.value - free.value, rel=0.1, abs=0.02)


def test_an_exact_force_disagrees_with_nothing() -> None:
    exact = [replace(probe, force_std=np.zeros(3)) for probe in _probes(count=3)]
    assert force_deviations(_fitted(exact)).tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("seed", range(6))
def test_a_force_that_is_off_is_found_and_does_no_harm(seed: int) -> None:
    probes = _probes(seed)
    wrong = replace(probes[3], force=1.06 * probes[3].force)
    minimum, freed = with_outlying_forces_freed(_fitted([*probes[:3], wrong, *probes[4:]]), RANGE)
    assert list(freed) == ["n04"]
    # As without that force.
    without = _fitted(probes[:3] + probes[4:])
    assert minimum.shear_modulus == pytest.approx(without.shear_modulus, rel=0.003)


@pytest.mark.parametrize(("beyond", "freed"), [(0.99, 0), (1.01, 1)])
def test_of_four_hundred_sound_sessions_one_loses_a_force(
    monkeypatch: pytest.MonkeyPatch, beyond: float, freed: int
) -> None:
    """Whichever of its forces, and however signed: the chance of each is an eighth of 1 / 400."""
    limit = norm.isf(1 / 400 / 2 / 4)
    minimum = _fitted(_probes(0, grid=6)[:4])
    assert len(minimum.problem.probes) == 4
    deviation = np.array([0.3, -beyond * limit, 0.1, 0.2])
    monkeypatch.setattr(checks, "force_deviations", lambda _: deviation)
    assert len(with_outlying_forces_freed(minimum, RANGE)[1]) == freed


def test_no_sound_force_is_left_out() -> None:
    """One session of four hundred by design: none of twenty."""
    for seed in range(20):
        probes = _probes(seed, grid=6)
        assert with_outlying_forces_freed(_fitted(probes), RANGE)[1] == {}


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_lone_force_is_never_left_out(count: int) -> None:
    probes = _probes(count=count)
    wrong = [replace(probes[0], force=1.5 * probes[0].force), *probes[1:]]
    assert with_outlying_forces_freed(_fitted(wrong), RANGE)[1] == {}


def test_forces_that_are_all_unlike_contradict_the_model() -> None:
    factors = (1.0, 1.15, 0.85, 1.3, 0.7, 1.08)
    probes = [
        replace(probe, force=factor * probe.force)
        for probe, factor in zip(_probes(count=6), factors, strict=True)
    ]
    minimum, freed = with_outlying_forces_freed(_fitted(probes), RANGE)
    assert len(freed) <= 2
    assert "measured forces" in {contradiction.source for contradiction in contradictions(minimum)}


def test_errors_none_of_which_is_impossible_contradict_the_model_together() -> None:
    """Eight force sensors, each with a gain of its own: chance lets all be one standard deviation
    off, and each alone two and a half, but not all of them."""
    for sigmas, kinds in ((1.0, set()), (2.5, {"errors"})):
        probes = [
            replace(
                probe,
                force=(1.0 + sign * sigmas * 0.01) * probe.force,
                force_std=np.zeros(3),
                nuisances=(force_gain(0.01, sensor=f"{index}"),),
            )
            for index, (probe, sign) in enumerate(
                zip(_probes(force_noise=0.0), np.tile([1.0, -1.0], 4), strict=True)
            )
        ]
        contradicted = contradictions(_fitted(probes))
        assert {contradiction.kind for contradiction in contradicted} == kinds
        assert all(contradiction.sigmas < 4.0 for contradiction in contradicted)


def _with_mesh(probe: ProbeObservations, share: float) -> ProbeObservations:
    value = probe.response.value
    step = model_step(
        "mesh", share, lambda nu: value(nu)[:, None], lambda nu: 2 * value(nu)[:, None]
    )
    return replace(probe, nuisances=(*probe.nuisances, step))


def _bent(probe: ProbeObservations, share: float) -> ProbeObservations:
    """A smooth field that no half space has, a share of the motion."""
    x, y, _ = probe.position.T / 0.03
    field = np.stack([x * y, x**2 - y**2, x**3], axis=1)
    size = share * np.sqrt((probe.displacement**2).mean() / (field**2).mean())
    return replace(
        probe,
        displacement=probe.displacement + size * field,
        landmarks={"the contact": np.zeros((1, 3)), "the support": np.full((1, 3), 9.0)},
    )


@pytest.mark.parametrize("noise", [1e-8, 2e-6])
def test_motion_beyond_the_model_s_error_contradicts_it(noise: float) -> None:
    probes = [_with_mesh(p, 0.002) for p in _probes(count=3, noise=noise, grid=12)]
    assert contradictions(_fitted(probes)) == ()
    wrong = [_bent(probe, 0.2) for probe in probes]
    contradiction = contradictions(_fitted(wrong))[0]
    assert contradiction.kind == "unexplained"
    assert contradiction.sigmas > 5.0
    assert 0.03 < contradiction.share < 0.3
    # Largest at the edge of the field, far from the contact.
    assert contradiction.landmark == ""
    estimate = fit(wrong).estimate
    assert estimate.status == "model_contradicted"
    assert "unexplained" in estimate.notes[0]


@pytest.mark.parametrize(
    "noise", [1e-6, *(pytest.param(noise, marks=pytest.mark.slow) for noise in (1e-4, 1e-3))]
)
def test_noise_does_not_contradict(noise: float) -> None:
    for seed in range(5):
        probes = [_with_mesh(p, 0.002) for p in _probes(seed, count=3, noise=noise, grid=10)]
        silent = [replace(p, std=None) for p in probes]
        assert contradictions(_fitted(probes)) == contradictions(_fitted(silent)) == ()


def test_an_error_that_its_prior_does_not_allow_contradicts() -> None:
    """Two sensors of one push each differ by 20 %, one per cent told."""
    probes = _probes(count=2, noise=1e-6)
    sensors = [
        replace(probe, force=factor * probe.force, nuisances=(force_gain(0.01, name),))
        for probe, factor, name in zip(probes, (1.0, 1.2), "ab", strict=True)
    ]
    sources = {contradiction.source for contradiction in contradictions(_fitted(sensors))}
    assert "gain of the force sensor" in sources


def test_a_contact_elsewhere_is_noticed() -> None:
    """5 mm beside a point force, with a mesh that is good to a tenth of a per cent."""
    probes = []
    for probe in _probes(count=3, grid=12):
        moved = replace(probe, response=HalfSpace(probe.response.offset - [5e-3, 0.0, 0.0]))
        probes.append(_with_mesh(moved, 0.001))
    assert fit(probes).estimate.status == "model_contradicted"

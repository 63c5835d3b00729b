"""The exact minimum against a general minimiser, at bounds and from afar."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.fitted import RANGE, minimum_of, misfit_of
from estimation.half_space import half_space_probes
from scipy.optimize import minimize

from palpate.estimation.search import nelder_mead as nelder_mead_module, scoring
from palpate.estimation.search.local_probe import SearchState
from palpate.estimation.search.misfit import Misfit
from palpate.estimation.search.nelder_mead import nelder_mead_minimum
from palpate.estimation.search.scoring import (
    Minimum,
    aitken_relaxation,
    diagonal_root,
    scored_minimum,
)


def _misfit(noise: str = "student-t", **options: object) -> Misfit:
    rng = np.random.default_rng(2)
    options = {"count": 2, "grid": 5, "noise": 5e-5, "force_noise": 0.02} | options
    probes = half_space_probes(rng, **options)
    for probe in probes:
        wild = rng.random(len(probe.position)) < 0.08
        field = probe.displacement.copy()
        field[wild] += 1e-3
        object.__setattr__(probe, "displacement", field)
    return misfit_of(probes, noise)


def _slope(misfit: Misfit, nu: float, modulus: float, direction: np.ndarray) -> float:
    step = 1e-6
    high, low = (
        misfit(nu + sign * step * direction[0], modulus * np.exp(sign * step * direction[1]))
        for sign in (1, -1)
    )
    return (high - low) / (2 * step)


@pytest.mark.parametrize("noise", ["student-t", "gaussian"])
def test_it_is_the_minimum_that_a_general_minimiser_finds(noise: str) -> None:
    misfit = _misfit(noise)
    found = minimum_of(misfit)
    other = minimize(
        lambda x: misfit(float(x[0]), 2e4 * float(np.exp(x[1]))), [0.3, 0.0],
        method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-9},
    )  # fmt: skip
    assert found.converged
    # The simplex stops at 1e-9 where rounding of the misfit allows it: 1e-7.
    assert found.poisson_ratio == pytest.approx(other.x[0], abs=1e-6)
    assert np.log(found.shear_modulus / 2e4) == pytest.approx(other.x[1], abs=1e-6)
    local = sum(one.loss for one in found.probes)
    assert local == pytest.approx(misfit(found.poisson_ratio, found.shear_modulus), rel=1e-9)


@pytest.mark.parametrize("start", [(0.02, 6e4), (0.49, 5e3), (0.3, 2e4)])
def test_the_start_does_not_matter(start: tuple[float, float]) -> None:
    misfit = _misfit()
    found, near = (
        scored_minimum(misfit, misfit.start(*start), poisson_range=RANGE),
        minimum_of(misfit),
    )
    # Steps stop at 1e-7 of a standard error, here 0.01.
    assert found.poisson_ratio == pytest.approx(near.poisson_ratio, abs=1e-8)
    assert found.shear_modulus == pytest.approx(near.shear_modulus, rel=1e-8)
    assert found.converged


@pytest.mark.parametrize(("poisson_range", "end"), [((0.0, 0.2), 0.2), ((0.4, 0.45), 0.4)])
def test_at_a_bound_the_modulus_is_the_best_there(
    poisson_range: tuple[float, float], end: float
) -> None:
    misfit = _misfit(poisson_ratio=0.3)
    found = minimum_of(misfit, poisson_range)
    assert found.poisson_ratio == end
    scale = _slope(misfit, end, 1.1 * found.shear_modulus, np.array([0.0, 1.0]))
    along = _slope(misfit, end, found.shear_modulus, np.array([0.0, 1.0]))
    # Central differences of a misfit of some hundreds: 1e-7; a tenth off in G it is thousands.
    assert abs(along) < 1e-6 * abs(scale)


def test_too_few_steps_are_not_converged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palpate.estimation.search.scoring._MAX_LINEARISATIONS", 1)
    monkeypatch.setattr("palpate.estimation.search.scoring._MAX_STEPS", 1)
    misfit = _misfit()
    assert not scored_minimum(misfit, misfit.start(0.05, 5e4), poisson_range=RANGE).converged


def test_a_simplex_is_linearised_where_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stopped early it says so, and its residuals are those of its own constants."""
    misfit = _misfit(force_noise=0.0)
    simplex, exact = (
        nelder_mead_minimum(misfit, misfit.start(0.25, 2.2e4), poisson_range=RANGE),
        minimum_of(misfit),
    )
    assert simplex.converged
    # It collapses to 1e-9 as far as rounding of the misfit allows.
    assert simplex.poisson_ratio == pytest.approx(exact.poisson_ratio, abs=1e-6)
    assert simplex.shear_modulus == pytest.approx(exact.shear_modulus, rel=1e-6)
    misfit = _misfit()
    monkeypatch.setattr(nelder_mead_module, "_MAX_EVALUATIONS", 9)
    found = nelder_mead_minimum(misfit, misfit.start(0.1, 3e4), poisson_range=RANGE)
    assert not found.converged
    _, here = misfit.at_best_forces(found.poisson_ratio, found.shear_modulus)
    for one, other in zip(found.probes, here, strict=True):
        np.testing.assert_array_equal(one.table, other.table)


def test_a_diagonal_without_information_has_a_floor() -> None:
    """Far below the rest, and above nothing where all is nothing."""
    found = diagonal_root(np.diag([4.0, 1e-30]))
    np.testing.assert_allclose(found, [2.0, np.sqrt(4e-15)], rtol=1e-12)
    np.testing.assert_allclose(diagonal_root(np.zeros((2, 2))), 1e-100, rtol=1e-12)


@pytest.mark.parametrize("start", [0.0, 0.48, 0.4999])
def test_the_first_simplex_is_inside_the_range(start: float) -> None:
    asked = []
    misfit = _misfit(count=1, force_noise=0.0)

    class Watched(Misfit):
        def __call__(self, poisson_ratio: float, shear_modulus: float) -> float:
            asked.append((poisson_ratio, shear_modulus))
            return super().__call__(poisson_ratio, shear_modulus)

    watched = Watched(misfit.probes, misfit.level, misfit.noise)
    nelder_mead_minimum(watched, misfit.start(start, 2e4), poisson_range=RANGE)
    first = np.array(asked[:3])
    # Three corners that span both directions by a twentieth.
    np.testing.assert_allclose(np.ptp(first[:, 0]), 0.05, rtol=1e-9)
    np.testing.assert_allclose(np.ptp(np.log(first[:, 1])), 0.05, rtol=1e-9)
    ratios = np.array(asked)[:, 0]
    assert ratios.min() >= RANGE[0]
    assert ratios.max() <= RANGE[1]


@pytest.mark.parametrize("swing", [-3.0, -0.9, -0.4, 0.0, 0.3])
def test_changes_that_swing_back_end_in_a_few_steps(
    monkeypatch: pytest.MonkeyPatch, swing: float
) -> None:
    """Each linearisation lands beyond the minimum by a share of where it started."""

    def overshot(
        misfit: Misfit, rows: list, start: SearchState, poisson_range: tuple
    ) -> tuple[Minimum, float]:
        nu = 0.3 + swing * (start.poisson_ratio - 0.3)
        modulus = 2e4 * (start.shear_modulus / 2e4) ** swing
        own = tuple(swing * one for one in start.shifts)
        state = replace(start, shear_modulus=modulus, shifts=own)
        return Minimum(nu, modulus, misfit.linearised(rows, state), start.errors, False), 1e-3

    monkeypatch.setattr(scoring, "_linear_minimum", overshot)
    misfit = _misfit()
    start = misfit.start(0.31, 2.1e4)
    start = replace(start, shifts=tuple(one + 2.0 for one in start.shifts))
    found = scored_minimum(misfit, start, poisson_range=RANGE)
    assert found.converged
    # It ends where a change is below a hundred thousandth.
    assert abs(found.poisson_ratio - 0.3) < 1e-5


def test_of_changes_that_swing_the_part_is_taken_that_leads_to_their_end() -> None:
    change = np.array([1.0, -2.0])
    assert aitken_relaxation(change, np.zeros(0), 1.0) == 1.0
    assert aitken_relaxation(change, 0.5 * change, 1.0) == 1.0
    # A map whose distance from its end turns by -0.25, and by -3, each time.
    assert aitken_relaxation(-0.25 * change, change, 1.0) == pytest.approx(1 / 1.25)
    assert aitken_relaxation(-3.0 * change, change, 1.0) == pytest.approx(1 / 4)
    # With that share it is at its end; with half of it, half of the change is left.
    assert aitken_relaxation(0.5 * change, change, 0.125) == pytest.approx(1 / 4)

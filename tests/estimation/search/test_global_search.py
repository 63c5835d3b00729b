"""The robust start: near the truth with exact data, with outliers, and with wrong forces."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.fitted import RANGE, misfit_of
from estimation.half_space import half_space_probes

from palpate.estimation import ProbeObservations
from palpate.estimation.noise.registry import NOISE_MODELS
from palpate.estimation.responses.table import response_table
from palpate.estimation.search import global_search
from palpate.estimation.search.global_search import fitted_parameters, global_start
from palpate.estimation.search.local_probe import SearchState


def _start(
    probes: list[ProbeObservations], noise: str = "student-t"
) -> tuple[SearchState, np.ndarray]:
    rows = misfit_of(probes).probes
    return global_start(rows, response_table(rows, RANGE), NOISE_MODELS[noise])


@pytest.mark.parametrize("poisson_ratio", [0.05, 0.3, 0.47])
def test_exact_data(poisson_ratio: float) -> None:
    probes = half_space_probes(
        np.random.default_rng(4), count=3, grid=6, poisson_ratio=poisson_ratio
    )
    start, _ = _start(probes)
    # The third order of the valley over the grid's hundredth.
    assert start.poisson_ratio == pytest.approx(poisson_ratio, abs=1e-3)
    assert start.shear_modulus == pytest.approx(2e4, rel=3e-3)


def test_a_force_that_is_off_is_found() -> None:
    """Many points, exact to a millionth, decide the direction of the force; its size is shared
    with G, so the other probings do."""
    probes = half_space_probes(np.random.default_rng(4), count=5, grid=8, noise=1e-7)
    std = np.full(3, 0.05)
    off = np.array([0.05, -0.05, 0.1])
    probes = [replace(probe, force_std=std) for probe in probes]
    probes[2] = replace(probes[2], force=probes[2].force + off)
    start, _ = _start(probes, "gaussian")
    # All five share the doubt about the scale: a fraction of a standard deviation.
    moved = start.shifts[2] - np.mean([start.shifts[k] for k in (0, 1, 3, 4)], axis=0)
    np.testing.assert_allclose(moved, -off / std, atol=0.9)
    assert start.shifts[2] @ off < 0
    assert np.linalg.norm(start.shifts[2]) > 2 * np.linalg.norm(start.shifts[0])


def test_forces_are_the_best_at_the_start() -> None:
    """With noise so large that the claim of the force counts as much as the displacements."""
    rng = np.random.default_rng(9)
    probes = half_space_probes(rng, count=2, grid=4, noise=1e-3, force_noise=0.2, shear_modulus=5e3)
    start, level = _start(probes, "gaussian")
    misfit = replace(misfit_of(probes), level=level)
    _, best = misfit.at_best_forces(start.poisson_ratio, start.shear_modulus)
    for found, one in zip(start.shifts, best, strict=True):
        # Gaussian weights are all one, and the response is linear in nu: rounding.
        np.testing.assert_allclose(found, one.shift, atol=1e-8)
        assert np.abs(found).max() > 0.01


def test_a_third_of_gross_errors() -> None:
    rng = np.random.default_rng(6)
    probes = []
    for probe in half_space_probes(rng, count=4, grid=12, noise=3e-5):
        wild = rng.random(len(probe.position)) < 0.3
        gross = 1e-3 * rng.normal(size=probe.displacement.shape)
        probes.append(
            replace(probe, displacement=probe.displacement + np.where(wild[:, None], gross, 0.0))
        )
    start, _ = _start(probes)
    # Close enough for scoring: a few standard errors of 0.003.
    assert start.poisson_ratio == pytest.approx(0.3, abs=0.02)
    assert start.shear_modulus == pytest.approx(2e4, rel=0.02)


def test_a_corner_that_moved_together_is_left_out() -> None:
    """The convex loss holds it back before any noise level is known."""
    rng = np.random.default_rng(1)
    probes = []
    for probe in half_space_probes(rng, count=3, grid=12, noise=3e-5):
        corner = (probe.position[:, 0] > 0) & (probe.position[:, 1] > 0)
        moved = probe.displacement + 1e-3 * corner[:, None]
        probes.append(replace(probe, displacement=moved, std=None))
    start, level = _start(probes)
    # A quarter is off by thirty sigmas; left in, the constants are off by tens of per cent.
    assert start.poisson_ratio == pytest.approx(0.3, abs=0.05)
    assert start.shear_modulus == pytest.approx(2e4, rel=0.05)
    # Lifted by the median over a quarter of outliers, not by their size.
    assert level[:3].max() < 2.5 * 3e-5


def test_parameters_are_counted() -> None:
    probes = half_space_probes(np.random.default_rng(1), count=2, noise=1e-5, force_noise=0.1)
    probes[0] = replace(probes[0], force_std=np.array([0.1, 0.0, 0.1]))
    assert fitted_parameters(misfit_of(probes).probes) == 2 + 2 + 3


def test_the_convex_start_explains_exact_data_whatever_the_force() -> None:
    """At the middle of the range of Poisson's ratio, with forces that are off by half."""
    probes = half_space_probes(
        np.random.default_rng(2), count=2, grid=6, poisson_ratio=float(np.mean(RANGE))
    )
    rows = misfit_of([replace(probe, force=1.5 * probe.force) for probe in probes]).probes
    residuals = global_search._convex_residuals(rows, response_table(rows, RANGE))
    for probe, residual in zip(rows, residuals, strict=True):
        # The table's interpolation, and 1e-12 added to normal equations of a condition near 1e3.
        assert np.abs(residual).max() < 1e-5 * np.abs(probe.measured).max()

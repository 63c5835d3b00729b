"""The misfit against the density of the data, and its slopes against differences."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from estimation.fitted import misfit_of
from estimation.half_space import half_space_probes
from scipy.optimize import minimize
from scipy.stats import multivariate_t

from palpate.errors import NotConvergedError
from palpate.estimation import ProbeObservations
from palpate.estimation.nuisance import LengthScale, NuisanceParameter
from palpate.estimation.search import LocalProbe, SearchState, misfit as misfit_module

NU, SHEAR = 0.27, 2.2e4


def _probes(seed: int = 3, **options: object) -> list[ProbeObservations]:
    return half_space_probes(np.random.default_rng(seed), grid=5, noise=1e-4, **options)


def _minus_twice_log(squared: np.ndarray, dimension: int) -> np.ndarray:
    """Of the density of Student's t with 8 degrees, relative to that at zero."""
    density = multivariate_t(np.zeros(dimension), np.eye(dimension), df=8.0)
    point = np.zeros((len(squared), dimension))
    point[:, 0] = np.sqrt(squared)
    return np.atleast_1d(-2 * (density.logpdf(point) - density.logpdf(np.zeros(dimension))))


def _joint(probe: ProbeObservations, shift: np.ndarray) -> float:
    """Minus twice the log density of displacements and force, given the true force."""
    force = probe.force + probe.force_std * shift
    predicted = (probe.response.value(NU)[:, :3] @ force / SHEAR).reshape(-1, 3)
    squared = (((probe.displacement - predicted) / probe.std) ** 2).sum(axis=1)
    total = _minus_twice_log(squared, 3).sum()
    uncertain = int((probe.force_std > 0).sum())
    if uncertain:
        total += _minus_twice_log(np.array([shift @ shift]), uncertain)[0]
    return float(total)


def test_with_exact_forces_it_is_the_density_of_the_displacements() -> None:
    probes = _probes(count=2)
    expected = sum(_joint(probe, np.zeros(3)) for probe in probes)
    # The same sum of some hundred logarithms: rounding.
    assert misfit_of(probes, "student-t")(NU, SHEAR) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("uncertain", [[1.0, 1.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
def test_uncertain_forces_take_their_best_values(uncertain: list[float]) -> None:
    """The force's loss is Student's t of as many components as are uncertain."""
    probe = _probes(count=1, force_noise=0.05)[0]
    probe = replace(probe, force_std=probe.force_std * uncertain)
    best = minimize(
        lambda s: _joint(probe, s * np.array(uncertain)), np.zeros(3), tol=1e-12, method="BFGS"
    )
    misfit = misfit_of([probe], "student-t")
    # BFGS with difference gradients stops at 1e-8 of the minimum.
    assert misfit(NU, SHEAR) == pytest.approx(best.fun, rel=1e-8)
    local = misfit.at_best_forces(NU, SHEAR)[1][0]
    assert local.loss == pytest.approx(misfit(NU, SHEAR), rel=1e-12)
    np.testing.assert_allclose(local.shift, best.x * uncertain, atol=1e-4)
    weight = (8 + sum(uncertain)) / (8 + local.shift @ local.shift)
    assert local.force_weight == pytest.approx(weight, rel=1e-12)


def test_slopes_of_the_prediction_are_derivatives() -> None:
    misfit = misfit_of(_probes(count=1, force_noise=0.05, tip=True))
    shift, step = np.array([0.5, -1.0, 2.0]), 1e-6
    start = SearchState(NU, SHEAR, np.zeros(0), (shift,))
    here = misfit.linearised(misfit.scaled(start), start)[0]

    def residual(change: np.ndarray) -> np.ndarray:
        rows = misfit.scaled(replace(start, poisson_ratio=NU + float(change[0])))
        return misfit.linearised(rows, start.moved(change))[0].residual

    for column, turn in enumerate(np.eye(5)):
        slope = -(residual(step * turn) - residual(-step * turn)) / (2 * step)
        # Central differences: rounding 1e-16 over the step.
        scale = np.abs(slope).max()
        np.testing.assert_allclose(here.design[:, column], slope, atol=1e-7 * scale)


@dataclass(frozen=True)
class _Bent:
    """An error of one probing that adds a share of what is seen, and its own square."""

    parameters = (NuisanceParameter("bend of one probing", 1.0),)
    share, square = 0.3, 0.2

    def columns(self, at):
        return (self.share * at.poisson_ratio * at.displacement)[:, None]

    def curvature(self, at):
        return np.full((len(at.rows), 1, 1), self.square * at.load[2] * at.poisson_ratio**2)


def test_errors_that_are_off_take_part_in_the_slopes() -> None:
    """What an error explains changes with the force: so do the slopes where it is not zero."""
    probes = _probes(count=2, force_noise=0.05)
    probes = [replace(probes[0], nuisances=(LengthScale(0.1), _Bent())), replace(
        probes[1], nuisances=(LengthScale(0.1),)
    )]  # fmt: skip
    misfit = misfit_of(probes)
    shift, errors, step = np.array([0.5, -1.0, 2.0, 1.4]), np.array([0.8, -0.3, 1.1]), 1e-6

    def at(change: np.ndarray) -> LocalProbe:
        state = SearchState(NU, SHEAR, errors, (shift + np.append(change, 0.0), np.zeros(3)))
        return misfit.linearised(misfit.scaled(state), state)[0]

    found = at(np.zeros(3)).design[:, 5:8]
    for column, turn in zip(found.T, np.eye(3), strict=True):
        slope = -(at(step * turn).residual - at(-step * turn).residual) / (2 * step)
        # All is linear in the force; central differences: rounding 1e-16 over the step.
        np.testing.assert_allclose(column, slope, atol=1e-7 * np.abs(slope).max())


def test_an_offset_is_another_poisson_ratio() -> None:
    """The half space's response is linear in nu, so linearised there it is exact."""
    misfit = misfit_of(_probes(count=2, force_noise=0.05))
    state = SearchState(0.3, SHEAR, np.zeros(0), (np.array([0.1, 0.2, 0.3]), np.zeros(3)))
    moved, direct = (
        misfit.linearised(misfit.scaled(replace(state, poisson_ratio=nu)), state)
        for nu in (0.1, 0.3)
    )
    for one, other in zip(moved, direct, strict=True):
        np.testing.assert_allclose(one.table, other.table, rtol=1e-9, atol=1e-9)
        assert one.loss == pytest.approx(other.loss, rel=1e-9)


def test_missing_components_leave_their_points() -> None:
    probe = _probes(count=1)[0]
    field = probe.displacement.copy()
    field[0, 1:] = np.nan
    field[1] = np.nan
    local = misfit_of([replace(probe, displacement=field)]).at_best_forces(NU, SHEAR)[1][0]
    assert local.rows.components[:2].tolist() == [1.0, 3.0]
    assert local.squared[0] == pytest.approx(local.residual[0] ** 2, rel=1e-12)
    assert local.squared[1] == pytest.approx((local.residual[1:4] ** 2).sum(), rel=1e-12)


def test_a_force_that_does_not_settle_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(misfit_module, "_MAX_FORCE_STEPS", 1)
    with pytest.raises(NotConvergedError, match="'n01': the true force did not settle in 1 steps"):
        misfit_of(_probes(count=1, force_noise=0.05), "student-t")(NU, SHEAR)

"""Profile intervals against roots of the misfit itself."""

import numpy as np
import pytest
from estimation.fitted import RANGE, minimum_of, misfit_of, weights_at
from estimation.half_space import half_space_probes
from scipy.optimize import brentq, minimize_scalar

from palpate.estimation.intervals.profile_likelihood import (
    ProfileCurve,
    crossings,
    profile_curve,
    profile_intervals,
)
from palpate.estimation.search.misfit import Misfit
from palpate.estimation.search.scoring import Minimum
from palpate.estimation.search.variable_projection import deviance_of

ALLOWED = {"poisson_ratio": 3.84, "shear_modulus": 3.0, "young_modulus": 5.0}


def _problem(**options: object) -> tuple[Misfit, Minimum, ProfileCurve]:
    options = {"count": 2, "grid": 5, "noise": 1e-4, "force_noise": 0.02} | options
    misfit = misfit_of(half_space_probes(np.random.default_rng(6), **options))
    minimum = minimum_of(misfit)
    weights = weights_at(misfit, minimum)
    curve = profile_curve(
        weights, centre=minimum.poisson_ratio, half_width=0.2, enough=max(ALLOWED.values())
    )
    return misfit, minimum, curve


def _profile_over_nu(misfit: Misfit, nu: float) -> float:
    found = minimize_scalar(
        lambda x: misfit(nu, float(np.exp(x))), bounds=(8.0, 12.0), options={"xatol": 1e-9}
    )
    return float(found.fun)


def _profile_over_modulus(misfit: Misfit, value: float, *, young: bool) -> float:
    def at(nu: float) -> float:
        return misfit(nu, value / (2 * (1 + nu)) if young else value)

    return float(minimize_scalar(at, bounds=RANGE, options={"xatol": 1e-10}).fun)


def test_ends_are_where_the_misfit_rises_to_the_allowed_height() -> None:
    misfit, minimum, curve = _problem()
    intervals = profile_intervals(curve, ALLOWED)
    best = misfit(minimum.poisson_ratio, minimum.shear_modulus)
    nu, shear = minimum.poisson_ratio, minimum.shear_modulus
    young = 2 * shear * (1 + nu)
    height = {
        "poisson_ratio": lambda x: _profile_over_nu(misfit, x),
        "shear_modulus": lambda x: _profile_over_modulus(misfit, x, young=False),
        "young_modulus": lambda x: _profile_over_modulus(misfit, x, young=True),
    }
    centre = {"poisson_ratio": nu, "shear_modulus": shear, "young_modulus": young}
    for name, (low, high) in intervals.items():

        def above(x: float, name: str = name) -> float:
            return height[name](x) - best - ALLOWED[name]

        width = high - low
        expected = (
            brentq(above, low - 0.3 * width, centre[name], xtol=1e-7 * width),
            brentq(above, centre[name], high + 0.3 * width, xtol=1e-7 * width),
        )
        # The root of the height is taken linear between 65 points, and moduli's edges end after
        # four Newton steps: 1e-3 of the width.
        np.testing.assert_allclose((low, high), expected, atol=2e-3 * width, err_msg=name)


def test_a_near_part_that_is_too_small_gives_way_to_the_whole_range() -> None:
    misfit, minimum, _ = _problem()
    weights = weights_at(misfit, minimum)
    nu = minimum.poisson_ratio
    small = profile_curve(weights, centre=nu, half_width=0.001, enough=3.84)
    np.testing.assert_allclose(small.poisson_ratio[[0, -1]], RANGE)
    near = profile_curve(weights, centre=nu, half_width=0.15, enough=3.84)
    assert near.height.min() < 1e-3
    np.testing.assert_allclose(near.poisson_ratio[[0, -1]], [nu - 0.15, nu + 0.15])
    assert min(near.height[0], near.height[-1]) > 3.84


def test_cut_at_a_bound_an_end_need_not_be_high() -> None:
    misfit, minimum, _ = _problem(poisson_ratio=0.49)
    nu = minimum.poisson_ratio
    curve = profile_curve(weights_at(misfit, minimum), centre=nu, half_width=0.15, enough=3.84)
    assert curve.height[-1] < 3.84
    np.testing.assert_allclose(curve.poisson_ratio[[0, -1]], [nu - 0.15, RANGE[1]])


def test_one_low_end_is_enough_to_look_everywhere() -> None:
    misfit, minimum, _ = _problem()
    weights = weights_at(misfit, minimum)
    nu = minimum.poisson_ratio
    for centre in (nu - 0.1, nu + 0.1):
        curve = profile_curve(weights, centre=centre, half_width=0.1, enough=3.84)
        np.testing.assert_allclose(curve.poisson_ratio[[0, -1]], RANGE)


def test_height_without_signal_is_all_that_was_measured() -> None:
    misfit, _, curve = _problem(force_noise=0.0)
    squares = sum(((probe.measured / probe.unit) ** 2).sum() for probe in misfit.probes)
    lowest, _, _ = deviance_of(curve.probes, curve.compliance)
    # The lowest of 65 points is near the minimum to a part in 1e3 of a standard deviation.
    assert curve.no_signal == pytest.approx(squares - lowest.min(), rel=1e-4)


def test_where_no_signal_is_allowed_moduli_have_no_upper_end() -> None:
    _, _, curve = _problem()
    for change, infinite in ((-1e-6, False), (1e-6, True)):
        allowed = dict.fromkeys(ALLOWED, curve.no_signal * (1 + change))
        high = profile_intervals(curve, allowed)["shear_modulus"][1]
        assert np.isinf(high) == infinite


def test_nothing_allowed_leaves_the_best() -> None:
    _, minimum, curve = _problem()
    intervals = profile_intervals(curve, dict.fromkeys(ALLOWED, 0.0))
    step = curve.poisson_ratio[1] - curve.poisson_ratio[0]
    # The best of the table's points.
    assert intervals["poisson_ratio"][0] == intervals["poisson_ratio"][1]
    assert intervals["poisson_ratio"][0] == pytest.approx(minimum.poisson_ratio, abs=step)
    assert intervals["shear_modulus"] == pytest.approx((minimum.shear_modulus,) * 2, rel=0.02)


def test_the_ends_of_nu_are_exact_on_a_parabola() -> None:
    """Its root is linear on either side."""
    place = np.linspace(0.1, 0.5, 41)
    height = ((place - 0.3) / 0.05) ** 2
    expected = 0.3 + 0.05 * np.sqrt(3.84) * np.array([-1, 1])
    # A few roundings.
    np.testing.assert_allclose(crossings(place, height, 3.84), expected, rtol=1e-12)
    assert crossings(place, height, 25.0) == (0.1, 0.5)
    assert crossings(place, height + 1.0, 0.5) == pytest.approx((0.3, 0.3), rel=1e-12)

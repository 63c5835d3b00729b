"""The whole estimation on closed-form responses: truth, laws, outliers, wrong claims."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from estimation.half_space import HalfSpace, half_space_probes
from hypothesis import given, settings, strategies as st

from palpate.errors import InputError
from palpate.estimation import FitMethod, FitSettings, ProbeObservations, fit
from palpate.records import Status


def _probes(seed: int = 1, **options: object) -> list[ProbeObservations]:
    return half_space_probes(np.random.default_rng(seed), **options)


@pytest.mark.parametrize("poisson_ratio", [0.02, 0.3, 0.47])
@pytest.mark.parametrize("force_noise", [0.0, 0.01])
def test_exact_data_give_exact_constants(poisson_ratio: float, force_noise: float) -> None:
    probes = _probes(count=4, poisson_ratio=poisson_ratio)
    if force_noise:  # exact force that is only claimed to be uncertain
        probes = [replace(p, force_std=np.full(3, force_noise)) for p in probes]
    estimate = fit(probes).estimate
    # Rounding of 1e-16 over a sensitivity of order one; 1e-8 leaves room for the noise floor.
    assert estimate.poisson_ratio.value == pytest.approx(poisson_ratio, abs=1e-8)
    assert estimate.shear_modulus.value == pytest.approx(2e4, rel=1e-8)
    assert estimate.young_modulus.value == pytest.approx(4e4 * (1 + poisson_ratio), rel=1e-8)
    assert estimate.status is Status.OK
    for probe in estimate.probes:
        assert probe.poisson_ratio.value == pytest.approx(poisson_ratio, abs=1e-8)
        assert probe.prediction_error < 1e-10


def test_auxetic_on_request() -> None:
    probes = _probes(count=3, poisson_ratio=-0.4)
    # The end of the range is no measurement, and the model with it does not fit.
    bounded = fit(probes).estimate
    assert bounded.status is Status.MODEL_CONTRADICTED
    assert not bounded.identifiable["poisson_ratio"]
    assert bounded.poisson_ratio.ci95 == (0.0, 0.4999)
    assert any(
        "lead beyond the range of Poisson's ratio, whose end, 0," in n for n in bounded.notes
    )
    wide = fit(probes, settings=FitSettings(poisson_range=(-0.99, 0.4999))).estimate
    # Exact data: only rounding is left.
    assert wide.poisson_ratio.value == pytest.approx(-0.4, abs=1e-8)


def test_scaling_laws() -> None:
    probes = _probes(count=4, noise=3e-5, force_noise=0.01)
    plain = fit(probes).estimate
    moved = [replace(p, displacement=3 * p.displacement, std=3 * p.std) for p in probes]
    pushed = [replace(p, force=5 * p.force, force_std=5 * p.force_std) for p in probes]
    softer, stiffer = fit(moved).estimate, fit(pushed).estimate
    # The minimisation stops at 1e-7 standard errors, here below 1e-8.
    assert softer.shear_modulus.value == pytest.approx(plain.shear_modulus.value / 3, rel=1e-8)
    assert stiffer.shear_modulus.value == pytest.approx(plain.shear_modulus.value * 5, rel=1e-8)
    for other in (softer, stiffer):
        assert other.poisson_ratio.value == pytest.approx(plain.poisson_ratio.value, abs=1e-8)
        np.testing.assert_allclose(other.poisson_ratio.ci95, plain.poisson_ratio.ci95, rtol=1e-6)


@given(length=st.sampled_from([1e-3, 1e3]), force=st.sampled_from([1e-3, 9.81, 1e3]))
@settings(max_examples=4, deadline=None)
def test_units_do_not_matter(length: float, force: float) -> None:
    """Lengths and forces in other units: G in force over length squared, nu as before."""
    probes = _probes(count=3, grid=6, noise=5e-5, force_noise=0.01)
    other = [
        replace(
            p,
            position=length * p.position,
            displacement=length * p.displacement,
            std=length * p.std,
            force=force * p.force,
            force_std=force * p.force_std,
            response=HalfSpace(length * p.response.offset),
        )
        for p in probes
    ]
    plain, changed = fit(probes).estimate, fit(other).estimate
    # The minimisation stops at 1e-7 standard errors.
    assert changed.poisson_ratio.value == pytest.approx(plain.poisson_ratio.value, abs=1e-8)
    unit = force / length**2
    assert changed.shear_modulus.value == pytest.approx(unit * plain.shear_modulus.value, rel=1e-8)
    assert changed.young_modulus.std == pytest.approx(unit * plain.young_modulus.std, rel=1e-5)


@given(order=st.permutations(range(4)))
@settings(max_examples=5, deadline=None)
def test_the_order_of_the_probings_does_not_matter(order: list[int]) -> None:
    probes = _probes(count=4, grid=6, noise=5e-5, force_noise=0.01)
    plain, changed = fit(probes).estimate, fit([probes[k] for k in order]).estimate
    # The minimisation stops at 1e-7 standard errors.
    assert changed.poisson_ratio.value == pytest.approx(plain.poisson_ratio.value, abs=1e-8)
    assert changed.shear_modulus.std == pytest.approx(plain.shear_modulus.std, rel=1e-6)
    assert [probe.name for probe in changed.probes] == [probes[k].name for k in order]


class _Turned:
    """A response seen from another frame: x' = turn x."""

    def __init__(self, response: HalfSpace, turn: np.ndarray) -> None:
        self._response, self._turn = response, turn

    def _seen(self, table: np.ndarray) -> np.ndarray:
        block = table.reshape(-1, 3, 4)
        force = np.eye(4)
        force[:3, :3] = self._turn.T
        return np.einsum("ij,pjk,kl->pil", self._turn, block, force).reshape(-1, 4)

    def value(self, poisson_ratio: float) -> np.ndarray:
        return self._seen(self._response.value(poisson_ratio))


def test_frame_does_not_matter() -> None:
    probes = _probes(count=4, noise=3e-5, force_noise=0.01)
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    turned = [
        replace(
            p,
            position=p.position @ turn.T,
            displacement=p.displacement @ turn.T,
            force=turn @ p.force,
            response=_Turned(p.response, turn),
        )
        for p in probes
    ]
    plain, other = fit(probes).estimate, fit(turned).estimate
    # Same minimum, reached to 1e-7 standard errors.
    assert other.poisson_ratio.value == pytest.approx(plain.poisson_ratio.value, abs=1e-8)
    assert other.shear_modulus.value == pytest.approx(plain.shear_modulus.value, rel=1e-8)


@pytest.mark.parametrize("force_noise", [0.0, 0.02])
def test_nelder_mead_agrees(force_noise: float) -> None:
    probes = _probes(count=3, grid=8, noise=3e-5, force_noise=force_noise)
    fast = fit(probes).estimate
    slow = fit(probes, settings=FitSettings(method="nelder-mead")).estimate
    # Asked for: 1e-6.
    assert slow.poisson_ratio.value == pytest.approx(fast.poisson_ratio.value, abs=1e-6)
    assert slow.shear_modulus.value == pytest.approx(fast.shear_modulus.value, rel=1e-6)
    assert (slow.method, fast.method) == ("nelder-mead", "reduced")
    assert slow.poisson_ratio.value != fast.poisson_ratio.value


def test_a_simplex_that_stops_early_reports_its_own_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """Predictions, residuals and intervals belong to the constants that are reported."""
    monkeypatch.setattr(sys.modules["palpate.estimation.fit"], "_MAX_EVALUATIONS", 6)
    probes = _probes(count=3, grid=6, noise=3e-5)
    result = fit(probes, settings=FitSettings(method="nelder-mead"))
    joint = result.estimate
    assert joint.status is Status.NOT_CONVERGED
    for probe, estimate in zip(probes, result.probes, strict=True):
        value = probe.response.value(joint.poisson_ratio.value)[:, :3]
        expected = (value @ probe.force / joint.shear_modulus.value).reshape(-1, 3)
        left = (probe.displacement - expected) / 3e-5
        # The weights are those of these residuals, too; noise levels of 1 by the claims.
        np.testing.assert_allclose(estimate.predicted, expected, rtol=1e-9)
        weight = 8 / (8 + (left**2).sum(axis=1))
        np.testing.assert_allclose(estimate.weight[:, 0], weight, rtol=1e-6)


def test_gross_outliers_do_no_harm() -> None:
    clean = _probes(count=6, noise=3e-5, force_noise=0.01)
    rng = np.random.default_rng(4)
    dirty, marked = [], 0
    for probe in clean:
        wild = rng.random(len(probe.position)) < 0.1
        marked += int(wild.sum())
        gross = 3e-5 * rng.uniform(10, 40, (len(wild), 1)) * rng.normal(size=(len(wild), 3))
        dirty.append(
            replace(probe, displacement=np.where(wild[:, None], gross, 0) + probe.displacement)
        )
    plain, robust = fit(clean).estimate, fit(dirty).estimate
    # Losing a tenth of the points moves the estimate by a third of its standard error.
    shift = robust.poisson_ratio.value - plain.poisson_ratio.value
    assert abs(shift) < plain.poisson_ratio.std
    # Claim and scatter of six probings: a standard error is itself known to 29 %.
    assert robust.poisson_ratio.std < 1.6 * plain.poisson_ratio.std
    rejected = sum(fitted.rejected for fitted in robust.probes)
    # Nearly all gross errors are beyond the 4.9 sigma of the rejection; clean points almost never.
    assert 0.9 * marked <= rejected <= 1.05 * marked
    least_squares = fit(dirty, settings=FitSettings(noise="gaussian")).estimate
    assert least_squares.poisson_ratio.std > 2 * robust.poisson_ratio.std


def test_many_clustered_outliers_in_one_direction() -> None:
    """A quarter of the field moved together: the robust start must not lock on to it."""
    probes = _probes(count=5, noise=3e-5, grid=14)
    dirty = []
    for probe in probes:
        corner = (probe.position[:, 0] > 0) & (probe.position[:, 1] > 0)
        dirty.append(replace(probe, displacement=probe.displacement + 1e-3 * corner[:, None]))
    estimate = fit(dirty).estimate
    # A quarter lost and the weights' remaining influence: within a few standard errors.
    assert estimate.poisson_ratio.value == pytest.approx(0.3, abs=0.03)
    assert estimate.shear_modulus.value == pytest.approx(2e4, rel=0.05)


def test_missing_points_are_counted() -> None:
    probes = _probes(count=2, noise=3e-5, tip=True)
    field = probes[0].displacement.copy()
    field[:7] = np.nan
    field[10, 2] = np.nan
    estimate = fit([replace(probes[0], displacement=field), probes[1]]).estimate
    assert (estimate.probes[0].missing, estimate.probes[0].observed) == (7, len(field) - 7)
    assert estimate.probes[1].missing == 0


def test_noise_that_is_not_claimed_is_estimated() -> None:
    probes = _probes(count=6, noise=3e-5, force_noise=0.01)
    silent = [replace(p, std=None) for p in probes]
    claimed, estimated = fit(probes).estimate, fit(silent).estimate
    # 2500 values a component: the level is known to 2 %, its effect on the interval likewise.
    assert estimated.poisson_ratio.std == pytest.approx(claimed.poisson_ratio.std, rel=0.15)
    assert any("estimated from the residuals" in note for note in estimated.notes)


def test_a_component_that_runs_the_other_way_is_told() -> None:
    """Of so few points the order of the residuals tells nothing."""
    probe = _probes(count=1, noise=1e-6)[0]
    nearest = np.argsort(-np.linalg.norm(probe.displacement, axis=1))[:24]
    field = np.full_like(probe.displacement, np.nan)
    field[nearest] = probe.displacement[nearest]
    right = replace(probe, std=None, displacement=field)
    wrong = replace(right, displacement=field * [-1.0, 1.0, 1.0])
    assert fit([right]).estimate.status == Status.OK
    estimate = fit([wrong]).estimate
    assert estimate.status == Status.MODEL_CONTRADICTED
    # The likeliest cause comes first.
    assert estimate.notes[0].startswith("Along x the residuals are")


def test_too_small_claims_widen_and_too_large_ones_stand() -> None:
    probes = _probes(count=6, noise=3e-5)
    right = fit(probes).estimate
    bold = fit([replace(p, std=p.std / 4) for p in probes]).estimate
    shy = fit([replace(p, std=p.std * 4) for p in probes]).estimate
    # The residuals decide where they exceed the claim.
    assert bold.poisson_ratio.std == pytest.approx(right.poisson_ratio.std, rel=0.05)
    # A claim is never lowered; the profile of nu is no exact parabola.
    assert shy.poisson_ratio.std / right.poisson_ratio.std == pytest.approx(4.0, rel=0.25)
    assert any("exceed the given standard deviations" in note for note in bold.notes)


def test_one_probing_with_a_wrong_force_scale() -> None:
    probes = _probes(count=10, noise=3e-5, force_noise=0.01)
    off = [replace(probes[0], force=1.3 * probes[0].force), *probes[1:]]
    estimate = fit(off).estimate
    # Plain averaging would move G by 3 %; the force is left out.
    assert estimate.shear_modulus.value == pytest.approx(2e4, rel=0.015)
    assert any("left out" in note and "'n01' by" in note for note in estimate.notes)


@pytest.mark.parametrize(("count", "status"), [(1, "ok"), (3, "model_contradicted"), (4, "ok")])
def test_a_force_is_left_out_only_where_three_others_agree(count: int, status: str) -> None:
    probes = _probes(count=count, noise=3e-5, force_noise=0.01)
    off = [replace(probes[0], force=1.3 * probes[0].force), *probes[1:]]
    estimate = fit(off).estimate
    assert estimate.status.value == status
    assert any("left out" in note for note in estimate.notes) == (count == 4)
    assert fit(probes).estimate.status.value == "ok"
    assert not fit(probes).estimate.notes


def test_force_noise_does_not_bias_the_modulus() -> None:
    """The functional errors-in-variables model: no bias of the order of the force variance."""
    ratios = [
        fit(
            _probes(seed, count=6, grid=5, noise=1e-6, force_noise=0.12)
        ).estimate.shear_modulus.value
        / 2e4
        for seed in range(16)
    ]
    error = np.std(ratios) / np.sqrt(len(ratios))
    # A normaliser of the force would add 3 * 0.12^2 = 4.3 %, four of these errors.
    assert abs(np.mean(ratios) - 1) < 3 * error
    assert error < 0.014


def test_left_out_prediction_is_a_refit() -> None:
    probes = _probes(count=3, noise=3e-5, force_noise=0.01)
    result = fit(probes)
    refit = fit(probes[1:]).estimate
    value = probes[0].response.value(refit.poisson_ratio.value)
    expected = (value[:, :3] @ probes[0].force / refit.shear_modulus.value).reshape(-1, 3)
    got = result.probes[0].left_out_predicted
    joint = result.estimate
    value = probes[0].response.value(joint.poisson_ratio.value)
    same = (value[:, :3] @ probes[0].force / joint.shear_modulus.value).reshape(-1, 3)
    # Weights are those of the joint fit, and a third of the data is a large thing to leave out in
    # one step: the move that leaving out makes is right to a tenth.
    assert np.linalg.norm(got - expected) < 0.1 * np.linalg.norm(same - expected)


def test_single_probing() -> None:
    result = fit(_probes(count=1, noise=3e-5))
    assert result.estimate.probes[0].prediction_error is None
    assert result.probes[0].left_out_predicted is None
    assert result.estimate.probes[0].poisson_ratio == result.estimate.poisson_ratio


def test_likelihood_map() -> None:
    result = fit(_probes(count=4, noise=3e-5, force_noise=0.01))
    likelihood, estimate = result.likelihood, result.estimate
    assert likelihood.deviance.shape == (51, 51)
    assert likelihood.deviance.min() >= 0
    best = np.unravel_index(likelihood.deviance.argmin(), (51, 51))
    step = np.ptp(likelihood.poisson_ratio) / 50
    assert abs(likelihood.poisson_ratio[best[0]] - estimate.poisson_ratio.value) <= step
    # Chi-square with two degrees of freedom.
    assert likelihood.height(0.95) == pytest.approx(-2 * np.log(0.05))
    inside = likelihood.deviance <= 1.0
    width = np.ptp(likelihood.poisson_ratio[inside.any(axis=1)])
    # Projection of the region of height 1 is one standard deviation to either side.
    # The map has one scale for both constants, the mean of theirs.
    assert width == pytest.approx(2 * estimate.poisson_ratio.std, rel=0.2)


def test_nothing_to_fit() -> None:
    with pytest.raises(InputError, match="no probings"):
        fit([])
    probes = _probes(count=2)
    with pytest.raises(InputError, match="same name"):
        fit([probes[0], probes[0]])
    blind = replace(probes[0], displacement=np.full_like(probes[0].displacement, np.nan))
    with pytest.raises(InputError, match="'n01' has no measured displacement"):
        fit([blind, probes[1]])
    with pytest.raises(InputError, match="zero force"):
        fit([replace(probes[0], force=np.zeros(3))])


def test_known_covariances_make_estimates_as_sharp_as_they_claim() -> None:
    # Depth is four times as uncertain as the rest; no axis of the object is better than another.
    along = np.full(3, 3.0**-0.5)
    shape = np.eye(3) + 15.0 * np.outer(along, along)
    root = np.linalg.cholesky(1e-10 * shape)
    away: dict[bool, list[float]] = {True: [], False: []}
    claims = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        (probe,) = half_space_probes(rng, count=1, grid=7, noise=0.0)
        n = len(probe.position)
        field = probe.displacement + rng.standard_normal((n, 3)) @ root.T
        covariance = np.tile(1e-10 * shape, (n, 1, 1))
        std = np.sqrt(np.einsum("naa->na", covariance))
        for known in (True, False):
            given = covariance if known else None
            estimate = fit([replace(probe, displacement=field, std=std, covariance=given)]).estimate
            away[known].append(estimate.poisson_ratio.value - 0.3)
            if known:
                claims.append(estimate.poisson_ratio.std)
    with_it, without = (float(np.sqrt(np.mean(np.square(away[known])))) for known in (True, False))
    # Twenty draws know a standard deviation to 16 %; three of these.
    assert abs(with_it / np.mean(claims) - 1.0) < 0.48
    assert with_it < 0.8 * without


@pytest.mark.parametrize(
    "ends", [(0.3, 0.3), (0.4, 0.1), (-1.0, 0.4), (0.0, 0.5), (float("nan"), 0.4)]
)
def test_a_range_that_cannot_be_is_refused(ends):
    with pytest.raises(InputError, match=r"both ends must be in \[-0.99, 0.4999\]"):
        FitSettings(poisson_range=ends)
    assert FitSettings(poisson_range=(-0.99, 0.4999)).poisson_range == (-0.99, 0.4999)


@pytest.mark.parametrize("name", ["method", "noise"])
def test_an_unknown_choice_is_refused_with_those_there_are(name):
    with pytest.raises(InputError, match=rf"{name} is 'guess'; must be one of '"):
        FitSettings(**{name: "guess"})


def test_members_are_as_good_as_their_names():
    assert FitSettings(method=FitMethod.NELDER_MEAD) == FitSettings(method="nelder-mead")

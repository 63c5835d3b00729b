"""Information, scores and their noise against dense linear algebra and the law of large numbers."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from estimation.fitted import dense_information, minimum_of, misfit_of
from estimation.half_space import half_space_probes
from scipy.stats import norm, t

from palpate.errors import InputError
from palpate.estimation import ProbeObservations, cramer_rao_bound
from palpate.estimation.intervals.sandwich import Scores, directions, scores_of
from palpate.estimation.intervals.scatter import NO_SCATTER, Scatter, Variance
from palpate.estimation.intervals.score_noise import ScoreNoise
from palpate.estimation.noise.noise_model import gaussian_moments
from palpate.estimation.noise.student_t import StudentT
from palpate.estimation.nuisance import LoadedResponse, NuisanceParameter
from palpate.records import PointCorrelation

CLAIMED = ScoreNoise(1.0, 1.0, np.inf, 0.0, NO_SCATTER)
NOISE = 1e-4


def _probes(seed: int = 1, **options: object) -> list[ProbeObservations]:
    options = {"count": 3, "grid": 5, "noise": NOISE} | options
    return half_space_probes(np.random.default_rng(seed), **options)


def _random_matrices(rng: np.random.Generator, count: int) -> np.ndarray:
    root = rng.normal(size=(count, 2, 4))
    return root @ root.swapaxes(1, 2)


def _scores(
    score: np.ndarray, information: np.ndarray, noise: np.ndarray, curvature: np.ndarray
) -> Scores:
    """Scores of probings that have nothing in common."""
    count, d = score.shape
    return Scores(score, information, noise, curvature, np.zeros((count, count, d, d)))


def test_directions_are_derivatives() -> None:
    step = 1e-6

    def constants(nu: float, log_shear: float) -> np.ndarray:
        young = 2 * np.exp(log_shear) * (1 + nu)
        return np.array([nu, log_shear, np.log(young)])

    for k, move in enumerate(([step, 0.0], [0.0, step])):
        high, low = constants(0.3 + move[0], move[1]), constants(0.3 - move[0], -move[1])
        slope = (high - low) / (2 * step)
        for found, expected in zip(directions(0.3).values(), slope, strict=True):
            # Central differences: rounding over the step.
            assert found[k] == pytest.approx(expected, abs=1e-9)
    assert list(directions(0.3)) == ["poisson_ratio", "shear_modulus", "young_modulus"]


def test_covariance_is_the_sandwich() -> None:
    rng = np.random.default_rng(3)
    bread, meat, bare = (_random_matrices(rng, 4) for _ in range(3))
    scores = _scores(np.zeros((4, 2)), bread, meat, bare)
    inverse = np.linalg.inv(bread.sum(0))
    # The ridge is 1e-11 of the diagonal.
    np.testing.assert_allclose(scores.covariance(), inverse @ meat.sum(0) @ inverse, rtol=1e-8)
    direction = np.array([0.3, -1.2])
    expected = direction @ np.linalg.inv(bare.sum(0)) @ direction
    assert scores.curvature_variance(direction) == pytest.approx(expected, rel=1e-8)


def test_nothing_known_has_no_finite_variance() -> None:
    """One combination without information: a huge variance, not an error."""
    flat = np.array([[[1.0, 1.0], [1.0, 1.0]]])
    covariance = _scores(np.zeros((1, 2)), flat, flat, flat).covariance()
    assert covariance[0, 0] > 1e8
    total = np.ones(2) @ covariance @ np.ones(2)
    # The combination that is known is known to 1: the ridge is 1e-11, its inverse rounds at 1e-5.
    assert total == pytest.approx(1.0, rel=1e-3)


def test_scatter_of_equal_probings() -> None:
    """Mean square of the deviations from the mean over what the claim explains."""
    deviation = np.array([-1.0, 0.5, 2.0, -1.5])
    information = np.repeat(np.diag([4.0, 1.0])[None], 4, axis=0)
    scores = _scores(
        np.column_stack([7.0 + 4.0 * deviation, np.zeros(4)]), information, information, information
    )
    found = scores.scatter(np.array([1.0, 0.0]))
    # Each probing's own nu deviates by `deviation`, claimed variance 1 / 4.
    assert found.ratio == pytest.approx((deviation**2).sum() / 3 * 4.0, rel=1e-8)
    # The mean is taken from the same four.
    assert found.degrees == pytest.approx(3.0, rel=1e-8)
    assert scores.scatter(np.array([0.0, 1.0])).ratio == pytest.approx(0.0, abs=1e-12)


def test_scatter_has_mean_one_where_claims_are_right() -> None:
    """Probings of very different information, scores drawn with the claimed covariance."""
    rng = np.random.default_rng(8)
    information, noise = _random_matrices(rng, 5), _random_matrices(rng, 5)
    root = np.linalg.cholesky(noise)
    direction, ratios = np.array([1.0, 0.4]), []
    for _ in range(3000):
        drawn = (root @ rng.normal(size=(5, 2, 1)))[..., 0]
        ratios.append(_scores(drawn, information, noise, noise).scatter(direction).ratio)
    # Chi-square with about three degrees over three, 3000 draws: 1.5 % of Monte Carlo error.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)


def test_no_scatter_of_one_probing_or_without_noise() -> None:
    one = np.ones((1, 2, 2))
    assert _scores(np.ones((1, 2)), one, one, one).scatter(np.ones(2)) == Scatter(1.0, 0.0)
    two = np.repeat(np.eye(2)[None], 2, axis=0)
    silent = _scores(np.ones((2, 2)), two, 0 * two, two)
    assert silent.scatter(np.array([1.0, 0.0])) == Scatter(1.0, 0.0)


def test_claim_and_scatter_count_by_their_degrees() -> None:
    """The claim is one observation of the variance, the scatter as many as it has degrees."""
    assert Scatter(9.0, 3.0).factor == pytest.approx((1 + 3 * 9.0) / 4)
    assert Scatter(9.0, 3.0).total_degrees == 4.0
    assert Scatter(1.0, 0.0).factor == 1.0
    assert Scatter(1.0, 0.0).total_degrees == np.inf


@pytest.mark.parametrize("count", [2, 3, 5])
def test_intervals_hold_where_the_claim_is_half_of_the_truth(count: int) -> None:
    """Means of a few values whose spread is twice what is claimed."""
    rng = np.random.default_rng(count)
    information = np.ones((count, 1, 1)) * np.eye(2)
    held = 0
    for _ in range(1500):
        value = 2.0 * rng.normal(size=count)
        score = np.column_stack([value - value.mean(), np.zeros(count)])
        scores = _scores(score, information, information, information)
        direction = np.array([1.0, 0.0])
        found = scores.variance(direction, scores.scatter(direction))
        held += abs(value.mean()) < found.quantile * np.sqrt(found.total)
    # 93.4 to 96.4 % by simulation (1e6 draws); three standard errors of 1500 draws are 1.9 %.
    assert held / 1500 > 0.915


def test_quantiles() -> None:
    # Quantiles of two libraries agree to rounding of their iterations.
    assert Variance(2.0, 1.0, np.inf).quantile == pytest.approx(norm.ppf(0.975), rel=1e-10)
    assert Variance(2.0, 0.0, 4.0).quantile == pytest.approx(t.ppf(0.975, 4.0), rel=1e-10)
    # Satterthwaite: degrees times the square of the total over the uncertain part.
    assert Variance(2.0, 2.0, 4.0).quantile == pytest.approx(t.ppf(0.975, 16.0), rel=1e-10)
    assert Variance(0.0, 1.0, 4.0).quantile == pytest.approx(norm.ppf(0.975), rel=1e-10)


def test_a_shared_error_is_not_averaged_away() -> None:
    """Probings of y_k = x + b + noise, b of standard deviation 1: variance of x is 1 / n + 1."""
    # In (nu, log G, b): a probing sees log G and b alike.
    sees = np.array([0.0, 1.0, 1.0])
    unit = np.outer(sees, sees) + np.diag([1.0, 0.0, 0.0])
    for count in (2, 50):
        matrices = np.repeat(unit[None], count, axis=0)
        scores = _scores(np.zeros((count, 3)), matrices, matrices, matrices[:, :2, :2])
        found = scores.variance(np.array([0.0, 1.0]), Scatter(1.0, 0.0))
        assert found.independent == pytest.approx(1 / count, rel=1e-6)
        assert found.shared == pytest.approx(1.0, rel=1e-6)
        assert scores.covariance()[1, 1] == pytest.approx(1 / count + 1.0, rel=1e-6)


def _common(count: int, share: float) -> np.ndarray:
    """Probings of two constants that see the same noises with a share of their variance of 1."""
    return share * np.tile(np.eye(2), (count, count, 1, 1))


def test_noise_of_a_common_reference_is_not_averaged_away() -> None:
    """Means of values of variance 1, half of it the same for all: (1 / n + 1) / 2."""
    for count in (2, 50):
        unit = np.repeat(np.eye(2)[None], count, axis=0)
        scores = Scores(np.zeros((count, 2)), unit, 0.5 * unit, unit, _common(count, 0.5))
        found = scores.variance(np.array([1.0, 0.0]), Scatter(1.0, 0.0))
        assert found.independent == pytest.approx(0.5 / count, rel=1e-6)
        assert found.shared == pytest.approx(0.5, rel=1e-6)
        assert scores.covariance()[0, 0] == pytest.approx(found.total, rel=1e-6)


def test_what_probings_share_does_not_scatter() -> None:
    """Probings of very different information, half of whose noise is common."""
    rng = np.random.default_rng(9)
    information, noise = _random_matrices(rng, 5), _random_matrices(rng, 5)
    root, common = np.linalg.cholesky(noise), rng.normal(size=(5, 3, 2))
    shared = np.einsum("kri,lrj->klij", common, common)
    direction, ratios = np.array([1.0, 0.4]), []
    for _ in range(3000):
        drawn = (root @ rng.normal(size=(5, 2, 1)))[..., 0] + rng.normal(size=3) @ common
        ratios.append(Scores(drawn, information, noise, noise, shared).scatter(direction).ratio)
    # As above.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)


def _near(probe: ProbeObservations) -> PointCorrelation:
    """Neighbours on the grid are correlated by 0.3."""
    apart = np.linalg.norm(probe.position[:, None] - probe.position[None], axis=2)
    pair = np.argwhere(np.triu((apart > 0.0) & (apart < 0.016)))
    return PointCorrelation(pair, np.full(len(pair), 0.3))


@pytest.mark.parametrize("sharing", [0.0, 0.4])
def test_points_of_one_reference_err_together(sharing: float) -> None:
    """Against X' C X with half of the noise of every point the same in all probings, and a part of
    the neighbours' correlation, dense."""
    probes = [replace(p, reference="rest", correlation=_near(p)) for p in _probes()]
    probes[1] = replace(
        probes[1], displacement=np.where(np.arange(25)[:, None] < 7, np.nan, probes[1].displacement)
    )
    local = minimum_of(misfit_of(probes)).probes
    known = replace(CLAIMED, sharing=sharing, blocks=Scatter(3.0, 2.0))
    found, _ = scores_of(misfit_of(probes), local, noise=known)
    whole = [one.design[:, :2] for one in local]
    rows = [np.isfinite(probe.displacement).ravel() for probe in probes]
    near = np.eye(25)
    pair = probes[0].correlation.pair
    near[tuple(pair.T)] = near[tuple(pair.T[::-1])] = 0.3 * sharing
    near = np.kron(near, np.eye(3))
    expected = np.zeros((2, 2))
    for k, (first, mine) in enumerate(zip(whole, rows, strict=True)):
        for m, (second, theirs) in enumerate(zip(whole, rows, strict=True)):
            both = 1.0 * (mine & theirs)
            # Between probings what a point has that only one of them saw counts by half.
            seen = 0.5 * (np.outer(mine, both) + np.outer(both, theirs))
            share = np.outer(mine, theirs) if k == m else 0.5 * seen
            alike = (near * share)[mine][:, theirs]
            expected += first.T @ alike @ second
    together = found.noise.sum(0) + found.common_covariance.sum(axis=(0, 1))
    # A claim worth one degree of freedom and a scatter of 3 with two: a factor of 7 / 3.
    np.testing.assert_allclose(together, 7.0 / 3.0 * expected, rtol=1e-9)


def test_neighbours_that_err_together_widen_what_they_say() -> None:
    """Least squares on noise of a known correlation: the claim is its scatter over draws."""
    rng, drawn = np.random.default_rng(11), []
    probe = _probes(count=1, grid=9)[0]
    clean = _probes(count=1, grid=9, noise=0.0)[0]
    apart = np.linalg.norm(probe.position[:, None] - probe.position[None], axis=2)
    like = np.exp(-((apart / 0.009) ** 2))
    pair = np.argwhere(np.triu(like > 1e-4, 1))
    known = PointCorrelation(pair, like[tuple(pair.T)])
    root = np.linalg.cholesky(like + 1e-9 * np.eye(len(like)))
    claims, sharings = [], []
    for _ in range(120):
        moved = clean.displacement + NOISE * root @ rng.normal(size=probe.displacement.shape)
        one = replace(probe, displacement=moved, correlation=known)
        best = minimum_of(misfit_of([one]))
        scores, noise = scores_of(misfit_of([one]), best.probes)
        plain = replace(noise, blocks=NO_SCATTER)
        scores, _ = scores_of(misfit_of([one]), best.probes, noise=plain)
        drawn.append(np.log(best.shear_modulus))
        claims.append(scores.covariance()[1, 1])
        sharings.append(noise.sharing)
    # 6 % from 120 draws of a standard deviation.
    assert np.sqrt(np.mean(claims)) / np.std(drawn) == pytest.approx(1.0, abs=0.2)
    # The fit takes two of some 30 parts of the noise that are independent.
    assert np.mean(sharings) == pytest.approx(1.0, abs=0.15)


@dataclass(frozen=True)
class _Unknown:
    """A displacement of the model that nobody fits."""

    step: np.ndarray
    name: str = "something"

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        return (NuisanceParameter(self.name, 1.0),)

    def columns(self, at: LoadedResponse) -> np.ndarray:
        return self.step[at.rows, None]


@pytest.mark.parametrize("shared", [True, False])
def test_what_is_considered_moves_the_estimate_by_its_prior(shared: bool) -> None:
    """Data of no noise, off by one standard deviation of an error that is not fitted: so far the
    estimate moves."""
    clean = [
        replace(probe, std=np.full_like(probe.displacement, NOISE)) for probe in _probes(noise=0.0)
    ]
    rng = np.random.default_rng(2)
    steps = [1e-7 * rng.normal(size=3 * len(probe.position)) for probe in clean]
    names = ["something"] * 3 if shared else ["a", "b", "c"]
    signs = [np.ones(3)] if shared else list(np.eye(3))
    considered = [
        replace(probe, considered=(_Unknown(step, name),))
        for probe, step, name in zip(clean, steps, names, strict=True)
    ]
    best = minimum_of(misfit_of(clean))
    found, _ = scores_of(
        misfit_of(considered), minimum_of(misfit_of(considered)).probes, noise=CLAIMED
    )
    alone = replace(found, noise=np.zeros_like(found.noise)).covariance()
    expected = np.zeros((2, 2))
    for sign in signs:
        moved = [
            replace(probe, displacement=probe.displacement + factor * step.reshape(-1, 3))
            for probe, step, factor in zip(clean, steps, sign, strict=True)
        ]
        there = minimum_of(misfit_of(moved))
        shear = np.log(there.shear_modulus / best.shear_modulus)
        off = np.array([there.poisson_ratio - best.poisson_ratio, shear])
        expected += np.outer(off, off)
    # A thousandth of the noise; the search ends within 1e-4 of such a step.
    np.testing.assert_allclose(alone, expected, rtol=1e-3)


def test_other_references_are_independent() -> None:
    probes = [replace(probe, reference=f"rest {k}") for k, probe in enumerate(_probes())]
    local = minimum_of(misfit_of(probes)).probes
    assert not scores_of(misfit_of(probes), local, noise=CLAIMED)[0].common_covariance.any()


def test_score_is_the_slope_of_the_misfit() -> None:
    misfit = misfit_of(_probes(force_noise=0.05), "student-t")
    nu, modulus, step = 0.25, 2.3e4, 1e-6
    _, local = misfit.at_best_forces(nu, modulus)
    found, _ = scores_of(misfit, local)
    for k, probe in enumerate(misfit.probes):
        single = replace(misfit, probes=(probe,))
        slope = [
            (single(nu + step, modulus) - single(nu - step, modulus)) / (2 * step),
            (single(nu, modulus * np.exp(step)) - single(nu, modulus * np.exp(-step))) / (2 * step),
        ]
        # Half of minus the slope; differences of a misfit of order 100 over 1e-6.
        np.testing.assert_allclose(found.score[k], -0.5 * np.array(slope), rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("force_noise", [0.0, 0.05])
def test_least_squares_has_the_information_of_its_covariance(force_noise: float) -> None:
    """Gaussian claims: information, noise and curvature are all X' C^-1 X, with the force's error
    as correlated noise in C."""
    misfit = misfit_of(_probes(force_noise=force_noise))
    local = minimum_of(misfit).probes
    found, noise = scores_of(misfit, local, noise=CLAIMED)
    assert noise.degrees == np.inf
    for k, one in enumerate(local):
        expected = dense_information(one)
        # Dense inverses of condition 1e5.
        np.testing.assert_allclose(found.information[k], expected, rtol=1e-7)
        np.testing.assert_allclose(found.noise[k], expected, rtol=1e-7)
        np.testing.assert_allclose(found.curvature[k], expected, rtol=1e-7)


def test_moments_of_the_score_enter_where_they_belong() -> None:
    """Mean slope a of the points' score and f of the force's: X' (1/a + P P' / f)^-1 X."""
    misfit = misfit_of(_probes(force_noise=0.05), "student-t")
    local = minimum_of(misfit).probes
    power, slope = gaussian_moments(StudentT(8.0), 3)
    found, _ = scores_of(misfit, local, noise=replace(CLAIMED, power=0.7, slope=0.8))
    for k, one in enumerate(local):
        expected = dense_information(one, row_variance=1 / 0.8, force_variance=1 / slope)
        np.testing.assert_allclose(found.information[k], expected, rtol=1e-7)
        weights = one.rows.per_row(one.weight)
        expected = dense_information(
            one, row_variance=1 / weights, force_variance=1 / one.force_weight
        )
        np.testing.assert_allclose(found.curvature[k], expected, rtol=1e-7)
    # Where score power and slope are equal multiples for points and force, so are the matrices.
    share = power / slope
    equal = ScoreNoise(0.4 * share, 0.8, np.inf, 0.0, Scatter(2.5, 2.0))
    found, _ = scores_of(misfit, local, noise=equal)
    np.testing.assert_allclose(found.noise, share * found.information, rtol=1e-7)


def _stretched(probes: list[ProbeObservations], factor: float) -> list[ProbeObservations]:
    """The same probings, residuals of the least-squares fit multiplied."""
    misfit = misfit_of(probes)
    local = minimum_of(misfit).probes
    return [
        replace(p, displacement=p.displacement + (factor - 1) * NOISE * one.residual.reshape(-1, 3))
        for p, one in zip(probes, local, strict=True)
    ]


def _noise_of(probes: list[ProbeObservations]) -> tuple[ScoreNoise, float, int]:
    """Noise of the scores, sum of squared residuals in claimed sigmas, rows."""
    misfit = misfit_of(probes)
    local = minimum_of(misfit).probes
    found = scores_of(misfit, local)[1]
    squares = float(sum((one.residual**2).sum() for one in local))
    return found, squares, sum(len(one.residual) for one in local)


def test_noise_without_claims_is_that_of_regression() -> None:
    """s^2 = RSS / (n - 2) with n - 2 degrees of freedom."""
    probes = _probes()
    found, squares, rows = _noise_of([replace(probe, std=None) for probe in probes])
    assert found.degrees == rows - 2
    # Both are sums over the same residuals.
    assert found.power == pytest.approx(squares / (rows - 2), rel=1e-9)
    assert found.slope == pytest.approx(1.0, rel=1e-12)


def test_free_forces_take_three_degrees_each() -> None:
    probes = [replace(p, std=None, force_std=np.full(3, 1e6)) for p in _probes()]
    misfit = misfit_of(probes)
    _, one = misfit.at_best_forces(0.3, 2e4)
    found = scores_of(misfit, one)[1]
    rows = sum(len(probe.measured) for probe in misfit.probes)
    # A force known to 1e6 N is free but for 1e-6 of a degree.
    assert found.degrees == pytest.approx(rows - 2 - 9, abs=1e-4)


def test_no_rows_to_spare() -> None:
    probe = _probes(count=1)[0]
    field = np.full_like(probe.displacement, np.nan)
    field[0, :2] = probe.displacement[0, :2]
    found = _noise_of([replace(probe, displacement=field, std=None)])[0]
    assert found.degrees == 0.5


def test_claims_hold_until_residuals_exceed_them() -> None:
    probes = _probes()
    _, squares, rows = _noise_of(probes)
    spare = rows - 2
    # Mean square residual at which chance is left out: 1 and two standard errors of a variance.
    limit = 1 + 2 * np.sqrt(2 / spare)
    for share, raised in ((0.99, False), (1.01, True)):
        factor = np.sqrt(share * limit / (squares / spare))
        found = _noise_of(_stretched(probes, factor))[0]
        assert found.degrees == (spare if raised else np.inf)
        expected = share * limit if raised else 1.0
        # Stretched residuals leave the minimum where it was, to 1e-7 of a standard error.
        assert found.power == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("force_noise", [0.0, 0.05])
def test_cramer_rao_is_the_inverse_information(force_noise: float) -> None:
    probes = _probes(force_noise=force_noise)
    misfit = misfit_of(probes)
    state = misfit.start(0.3, 2e4)
    local = misfit.linearised(misfit.scaled(state), state)
    covariance = np.linalg.inv(sum(dense_information(one) for one in local))
    bound = cramer_rao_bound(probes, poisson_ratio=0.3, shear_modulus=2e4)
    young = 5.2e4 * np.array([1 / 1.3, 1.0])
    # Dense inverses of condition 1e5.
    assert bound["poisson_ratio"] == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-6)
    assert bound["shear_modulus"] == pytest.approx(2e4 * np.sqrt(covariance[1, 1]), rel=1e-6)
    assert bound["young_modulus"] == pytest.approx(np.sqrt(young @ covariance @ young), rel=1e-6)


def test_cramer_rao_says_what_it_cannot() -> None:
    probes = _probes()
    with pytest.raises(InputError, match="'n01' has no std"):
        cramer_rao_bound([replace(probes[0], std=None)], poisson_ratio=0.3, shear_modulus=2e4)
    field = np.full_like(probes[0].displacement, np.nan)
    field[3, 2] = 1e-5
    alone = replace(probes[0], displacement=field)
    bound = cramer_rao_bound([alone], poisson_ratio=0.3, shear_modulus=2e4)
    assert all(np.isinf(value) for value in bound.values())


def test_another_probing_never_makes_the_bound_wider() -> None:
    probes = _probes(count=5, force_noise=0.05)
    bounds = [
        cramer_rao_bound(probes[: k + 1], poisson_ratio=0.3, shear_modulus=2e4) for k in range(5)
    ]
    for name in ("poisson_ratio", "shear_modulus", "young_modulus"):
        assert np.all(np.diff([bound[name] for bound in bounds]) < 0)

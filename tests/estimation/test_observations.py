"""What a probing may hold, and how its measured components become rows."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.half_space import HalfSpace, half_space_probes

from palpate.errors import InputError
from palpate.estimation import ProbeObservations
from palpate.estimation.observed_rows import observed_rows_of


def _probe(**options: object) -> ProbeObservations:
    return half_space_probes(np.random.default_rng(1), count=1, grid=4, noise=1e-5, **options)[0]


def test_a_std_that_is_not_positive_is_refused_where_something_was_measured() -> None:
    probe = _probe()
    std = probe.std.copy()
    std[2, 1] = 0.0
    with pytest.raises(InputError, match=r"'n01': std is 0.0 at index \(2, 1\), and 1 entries"):
        replace(probe, std=std)
    field = probe.displacement.copy()
    field[2] = np.nan
    assert np.isnan(replace(probe, std=std, displacement=field).displacement[2]).all()


def test_wrong_entries_are_refused() -> None:
    probe = _probe(tip=True)
    with pytest.raises(InputError, match=r"force_std is .* every component must be >= 0"):
        replace(probe, force_std=np.array([0.0, -1e-3, 0.0]))
    with pytest.raises(InputError, match=r"tip_displacement_std is -1\.0 at index"):
        replace(probe, tip_displacement_std=np.array([1e-5, -1.0, 1e-5]))
    with pytest.raises(InputError, match=r"'n01': position has .* not finite"):
        replace(probe, position=np.full_like(probe.position, np.nan))


def test_rows_follow_the_response() -> None:
    probe = _probe(tip=True, force_noise=0.1)
    field = probe.displacement.copy()
    field[0, 1] = np.nan
    field[3] = np.nan
    rows = observed_rows_of(replace(probe, displacement=field, force_std=np.array([1.0, 0.0, 1.0])))
    n = len(field)
    kept = np.setdiff1d(np.arange(3 * n + 3), [1, 9, 10, 11])
    np.testing.assert_array_equal(rows.rows, kept)
    np.testing.assert_array_equal(rows.component_of_row, kept % 3)
    measured = np.concatenate([field.ravel(), probe.tip_displacement])
    np.testing.assert_array_equal(rows.measured, measured[kept])
    # Three points a row at most: the first has two components left, the tip comes last.
    assert rows.components[0] == 2.0
    assert (rows.point[-1], rows.components[-1]) == (n, 3.0)
    assert np.isnan(rows.position[-1]).all()
    assert rows.group[:3].tolist() == [4, 6, 4]
    assert rows.group[-3:].tolist() == [7, 7, 7]
    assert rows.has_claims
    values = np.arange(float(len(rows.start)))
    assert rows.per_row(values)[:5].tolist() == [0.0, 0.0, 1.0, 1.0, 1.0]
    lengths = rows.squared_length(np.full(len(rows.measured), 2.0))
    np.testing.assert_array_equal(lengths, 4.0 * rows.components)
    level = np.arange(1.0, 9.0)
    np.testing.assert_allclose(rows.sigma(level)[:2], [5e-5, 7e-5], rtol=1e-12)


def test_without_claims_levels_are_lengths() -> None:
    rows = observed_rows_of(replace(_probe(tip=True), std=None, tip_displacement_std=None))
    assert not rows.has_claims
    assert set(rows.group.tolist()) == {0, 1, 2, 3}
    np.testing.assert_array_equal(rows.unit, 1.0)


def test_a_body_force_alone_pushes() -> None:
    class Heavy(HalfSpace):
        def value(self, poisson_ratio: float) -> np.ndarray:
            table = super().value(poisson_ratio)
            table[:, 3] = 1.0
            return table

    probe = _probe()
    silent = replace(probe, force=np.zeros(3))
    with pytest.raises(InputError, match="has zero force and no other load"):
        observed_rows_of(silent)
    heavy = replace(silent, response=Heavy(probe.response.offset))
    assert len(observed_rows_of(heavy).measured) == 3 * len(probe.position)


def _covariances(count: int, *, depth: float = 4.0) -> np.ndarray:
    """As of cameras in one direction: `depth` times as uncertain along it."""
    rng = np.random.default_rng(3)
    along = np.array([0.5, -0.3, 0.81])
    along /= np.linalg.norm(along)
    shape = np.eye(3) + (depth**2 - 1.0) * np.outer(along, along)
    return 1e-10 * rng.uniform(0.5, 2.0, (count, 1, 1)) * shape


def _with_covariance(**options: object) -> ProbeObservations:
    probe = _probe(**options)
    covariance = _covariances(len(probe.position))
    return replace(probe, std=np.sqrt(np.einsum("naa->na", covariance)), covariance=covariance)


def test_rows_of_known_covariance_are_independent_and_equal() -> None:
    probe = _with_covariance(tip=True)
    field = probe.displacement.copy()
    field[3] = np.nan
    rows = observed_rows_of(replace(probe, displacement=field))
    plain = observed_rows_of(replace(probe, displacement=field, covariance=None))
    level = np.ones(8)
    kept = np.delete(np.arange(len(field)), 3)
    # The squared length of a residual is what its covariance makes of it.
    value = probe.response.value(0.2)[rows.rows, 2]
    left = (plain.measured - value)[:-3].reshape(-1, 3)
    inverse = np.linalg.inv(probe.covariance[kept])
    expected = np.einsum("pa,pab,pb->p", left, inverse, left)
    found = rows.squared_length((rows.measured - rows.whitened(value)) / rows.sigma(level))
    np.testing.assert_allclose(found[:-1], expected, rtol=1e-9)
    variance = rows.sigma(level) ** 2
    np.testing.assert_allclose(
        rows.component_variance(variance), plain.sigma(level) ** 2, rtol=1e-9
    )
    np.testing.assert_array_equal(plain.component_variance(variance), variance)
    np.testing.assert_allclose(rows.unwhitened(rows.measured), plain.measured, rtol=1e-9)
    # The tip, behind the points, is as it was.
    np.testing.assert_array_equal(rows.measured[-3:], plain.measured[-3:])


def test_whitening_mixes_the_components_of_each_point_alone() -> None:
    rows = observed_rows_of(_with_covariance(tip=True))
    n = len(rows.whitening)
    columns = np.random.default_rng(1).normal(size=(len(rows.measured), 2))
    mixed = rows.whitening @ columns[: 3 * n].reshape(n, 3, 2)
    np.testing.assert_allclose(rows.whitened(columns)[: 3 * n], mixed.reshape(-1, 2), rtol=1e-12)
    np.testing.assert_array_equal(rows.whitened(columns)[3 * n :], columns[3 * n :])
    # Variance of a row for components of variance 1, and weights of pairs of components.
    matrix = np.zeros((3 * n, 3 * n))
    for k in range(n):
        matrix[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = rows.whitening[k]
    np.testing.assert_allclose(rows.whitening_power()[: 3 * n], np.diag(matrix @ matrix.T))
    weight = np.random.default_rng(2).uniform(1, 2, len(rows.measured))
    expected = matrix.T @ np.diag(weight[: 3 * n]) @ matrix
    found = rows.component_products(weight)
    np.testing.assert_allclose(found[1], expected[3:6, 3:6], rtol=1e-9)
    np.testing.assert_array_equal(found[-1], np.diag(weight[-3:]))


def test_covariances_that_cannot_be_are_refused() -> None:
    probe = _with_covariance()
    with pytest.raises(InputError, match="covariance is given without std"):
        replace(probe, std=None)
    field = probe.displacement.copy()
    field[0, 1] = np.nan
    with pytest.raises(InputError, match="some components of a point are measured"):
        replace(probe, displacement=field)
    broken = probe.covariance.copy()
    broken[2, 0, 0] = -1e-10
    with pytest.raises(InputError, match="covariance of point 2 is not positive definite"):
        replace(probe, covariance=broken)

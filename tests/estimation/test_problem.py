"""The objective: derivatives against differences, its terms against the formula."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from estimation.fitted import minimum_of, patterns, problem_of
from estimation.half_space import HalfSpace, half_space_probes

from palpate.errors import InputError
from palpate.estimation import (
    Nuisance,
    NuisanceParameter,
    ProbeObservations,
    ResponseTerms,
    Settlement,
    fixed_displacement,
)
from palpate.estimation.measured_components import MeasuredComponents, observed_rows_of
from palpate.estimation.normal_equations import Evaluation
from palpate.estimation.unknown_error import UnknownRows, correlated_patterns, unknown_rows
from palpate.pipeline.model.shared_errors import (
    contact_error,
    force_direction,
    force_gain,
    length_scale,
    tool_slip,
)
from palpate.pipeline.observations import model_step

# Where contacts are tried, in standard deviations of two parameters.
STEPS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 1.0]])


@dataclass(frozen=True, eq=False)
class _Moving:
    """A half space on a support that moves in two ways."""

    base: HalfSpace

    def value(self, poisson_ratio: float) -> np.ndarray:
        loads = self.base.value(poisson_ratio)
        motions = np.stack([np.ones(len(loads)), np.arange(len(loads)) * poisson_ratio], axis=1)
        return np.concatenate([loads, motions], axis=1)


def _everything(rng: np.random.Generator) -> list[ProbeObservations]:
    """Two probings with every kind of error, motions, springs and correlated components."""
    probes = []
    for probe in half_space_probes(rng, count=2, grid=6, noise=3e-5, force_noise=0.02, tip=True):
        count = len(probe.position)
        response = _Moving(probe.response)
        columns = response.value(0.3).shape[1]
        name = probe.name

        def wider(nu: float, moving: _Moving = response) -> np.ndarray:
            return 1.02 * moving.value(nu)[:, None] + nu

        def change(nu: float, moving: _Moving = response) -> np.ndarray:
            return 1e3 * nu**2 * moving.value(nu)[:, :5]

        def effects(at: ResponseTerms, columns: int = columns) -> np.ndarray:
            effect = np.full((len(at.rows), columns, 1), 5e-4 * at.poisson_ratio)
            return np.stack([np.zeros_like(effect), effect], axis=1)

        def corrected(at: ResponseTerms) -> np.ndarray:
            return fixed_displacement(np.ones((len(at.rows), 1)), at)

        slips = (NuisanceParameter(f"{name} a", 1e-4, "m"), NuisanceParameter(f"{name} b", 1e-4))
        contact = tuple(
            NuisanceParameter(f"{name} {k}", 0.1, is_model_error=k == 1) for k in range(2)
        )
        turned = rng.normal(size=(count, 3, 3))
        probes.append(
            replace(
                probe,
                response=response,
                motion=np.array([1e-4, 0.0]),
                motion_std=np.array([1e-5, 1e-6]),
                settlement=Settlement(1.7e4, lambda nu, m=response: 0.1 * nu * m.value(nu)),
                covariance=1e-10 * (np.eye(3) + turned @ turned.swapaxes(1, 2)),
                nuisances=(
                    force_gain(0.01),
                    force_direction(0.02),
                    length_scale(0.003),
                    model_step("mesh", 0.4, lambda nu, m=response: m.value(nu)[:, None], wider),
                    Nuisance((NuisanceParameter("compliance of support 1", 0.5, "m/Pa"),), effects),
                    Nuisance((NuisanceParameter("correction", 1.0),), corrected),
                    contact_error(contact, STEPS, change, count),
                    tool_slip(slips, np.eye(3)[:2], count),
                ),
            )
        )  # fmt: skip
    return probes


def test_the_jacobian_is_the_derivative_of_the_prediction() -> None:
    rng = np.random.default_rng(2)
    problem = problem_of(_everything(rng))
    layout = problem.layout
    theta = rng.normal(size=layout.size)
    theta[:2] = 0.285, np.log(1.9e4)
    tables = problem.linearised(theta)[1]
    for index, block in enumerate(layout.blocks):
        whole = np.vstack([tables[index], patterns(problem, index)])
        entries = [*range(layout.common), *range(block.whole.start, block.whole.stop)]
        for row, entry in enumerate(entries):
            step = np.zeros(layout.size)
            # Of second order in all but log G.
            size = 1e-4 if entry == 1 else 1e-2
            step[entry] = size
            ahead, behind = (problem.linearised(theta + s * step)[0][index] for s in (1, -1))
            expected = -(ahead - behind) / (2 * size)
            scale = np.abs(whole[row]).max() + 1e-9
            np.testing.assert_allclose(whole[row], expected, atol=2e-6 * scale, err_msg=str(entry))


def test_an_expansion_is_right_to_second_order() -> None:
    probes = _everything(np.random.default_rng(3))
    problem = problem_of(probes)
    theta = np.zeros(problem.layout.size)
    missed = []
    for offset in (0.04, 0.02):
        theta[:2] = 0.28 + offset, np.log(2e4)
        far, near = (
            expanded.linearised(theta)[0][0]
            for expanded in (problem, problem.expanded(0.28 + offset))
        )
        missed.append(np.linalg.norm(far - near))
    assert missed[0] / missed[1] == pytest.approx(4.0, rel=0.15)


def test_models_made_when_asked_for_are_those_that_are_kept() -> None:
    problem = problem_of(_everything(np.random.default_rng(3)))
    theta = 0.3 * np.random.default_rng(4).normal(size=problem.layout.size)
    theta[:2] = 0.28, np.log(2e4)
    made = problem.of(problem.probes, problem.shared, theta)
    expanded = made.expanded(0.28)
    assert isinstance(expanded.expansions, tuple)
    assert not isinstance(made.expansions, tuple)
    for actual, wanted in zip(made.linearised(theta), expanded.linearised(theta), strict=True):
        for first, other in zip(actual, wanted, strict=True):
            np.testing.assert_array_equal(first, other)
    assert [len(expansion.effects) for expansion in made.expansions[1:]] == [
        len(expanded.expansions[1].effects)
    ]


def test_the_prediction_is_the_formula() -> None:
    """Two terms: what scales with 1 / G, and what does not depend on G."""
    probes = _everything(np.random.default_rng(4))
    plain = [replace(p, nuisances=(), covariance=None) for p in probes]
    problem = problem_of(plain).expanded(0.31)
    theta = np.zeros(problem.layout.size)
    theta[:2] = 0.31, np.log(2.4e4)
    seen = plain[0]
    load = np.concatenate([np.append(seen.force, 1.0) / 2.4e4, seen.motion])
    response = seen.response.value(0.31)
    response = response + (2.4e4 / 1.7e4 - 1.0) * seen.settlement.derivative(0.31)
    measured = np.append(seen.displacement.ravel(), seen.tip_displacement)
    np.testing.assert_allclose(
        problem.linearised(theta)[0][0], measured - response @ load, atol=1e-11
    )


def test_the_objective_is_noise_and_priors() -> None:
    probes = half_space_probes(np.random.default_rng(5), count=2, grid=5, noise=3e-5)
    probes = [replace(p, nuisances=(force_gain(0.01),), force_std=np.full(3, 0.01)) for p in probes]
    problem = replace(problem_of(probes), information=0.7)
    theta = np.random.default_rng(6).normal(size=problem.layout.size)
    theta[:2] = 0.3, np.log(2e4)
    residual = problem.linearised(theta)[0]
    expected = 0.7 * sum(((row / 3e-5) ** 2).sum() for row in residual) + (theta[2:] ** 2).sum()
    assert Evaluation(problem, theta).value == pytest.approx(expected, rel=1e-12)


def test_probings_share_by_name() -> None:
    problem = problem_of(_everything(np.random.default_rng(7)))
    names = [parameter.name for parameter in problem.shared]
    assert names[0] == "gain of the force sensor"
    assert names[-1] == "correction"
    assert [error.name for error in problem.own(1)] == ["n02 0", "n02 1", "n02 a", "n02 b"]
    # One probing alone has nobody to share with, but keeps what the session shares.
    assert problem_of(_everything(np.random.default_rng(7))[:1]).shared == ()
    theta = np.arange(float(problem.layout.size))
    alone, part = problem.subset(1, theta)
    assert alone.shared == problem.shared
    assert (
        part[alone.layout.blocks[0].force].tolist()
        == theta[problem.layout.blocks[1].force].tolist()
    )


def test_a_response_that_does_not_fit_is_refused() -> None:
    probe = half_space_probes(np.random.default_rng(1), count=1, grid=4)[0]
    wrong = replace(probe, response=HalfSpace(probe.response.offset[1:]))
    with pytest.raises(InputError, match="must be finite with three rows a point"):
        observed_rows_of(wrong).observations.response_terms(0.3)


def _probe(grid: int = 12, **options: object) -> ProbeObservations:
    rng = np.random.default_rng(3)
    return half_space_probes(rng, count=1, grid=grid, noise=1e-6, **options)[0]


def _unknown(probe: MeasuredComponents, fields: np.ndarray) -> UnknownRows:
    return unknown_rows(probe, fields, correlated_patterns(probe.position))


def test_a_step_is_the_difference_of_two_models() -> None:
    probe = _probe(4)
    value = probe.response.value(0.3)
    step = model_step("mesh", 0.2, lambda nu: value[:, None], lambda nu: 1.05 * value[:, None])
    problem = problem_of([replace(probe, nuisances=(step,))])
    theta = np.zeros(problem.layout.size)
    theta[:2] = 0.3, np.log(2e4)
    (column,) = problem.linearised(theta)[1][0][problem.layout.blocks[0].errors]
    expected = 0.2 * 0.05 * value[:, :3] @ probe.force / 2e4
    np.testing.assert_allclose(column, expected, rtol=1e-9)


def test_the_covariance_has_the_size_of_the_fields() -> None:
    """A field of one size everywhere: variance of every row, fields and patterns and what is white
    together, and a correlation that falls with distance."""
    probe = observed_rows_of(_probe())
    fields = np.full((len(probe.measured), 1), 2e-6)
    unknown = _unknown(probe, fields)
    smooth = np.stack([unknown.moved(coefficients) for coefficients in np.eye(unknown.count)])[1:]
    covariance_of_rows = smooth.T @ smooth + np.diag(unknown.variance)
    # One field of size s has variance s^2 of every component.
    np.testing.assert_allclose(np.diag(covariance_of_rows), 4e-12, rtol=1e-6)
    along_x = covariance_of_rows[::3, ::3] / 4e-12
    distance = np.linalg.norm(probe.position[:, None] - probe.position[None], axis=2)
    near, far = (along_x[(distance > a) & (distance < b)].mean() for a, b in ((0, 7e-3), (5e-2, 1)))
    assert near > 0.4 > 0.15 > far
    # Components are independent.
    np.testing.assert_allclose(covariance_of_rows[::3, 1::3], 0.0, atol=1e-18)
    assert _unknown(probe, fields[:, :0]).variance.max() == 0.0


def test_products_are_those_of_the_dense_patterns() -> None:
    rng = np.random.default_rng(5)
    probe = _probe(8)
    mixed = rng.normal(size=(len(probe.position), 3, 3))
    probe = replace(probe, covariance=1e-12 * (np.eye(3) + mixed @ mixed.swapaxes(1, 2)))
    rows = observed_rows_of(probe)
    unknown = _unknown(rows, rng.normal(size=(len(rows.measured), 2)))
    dense = np.stack([unknown.moved(coefficients) for coefficients in np.eye(unknown.count)])
    columns, weight = rng.normal(size=(4, dense.shape[1])), rng.uniform(1, 2, dense.shape[1])
    cross, whole = unknown.products(columns, weight)
    # The same sums in another order.
    np.testing.assert_allclose(cross, (columns * weight) @ dense.T, atol=1e-9)
    np.testing.assert_allclose(whole, (dense * weight) @ dense.T, atol=1e-9)


def test_information_saturates() -> None:
    """Sixteen times as many points, or a tenth of the noise, tell hardly more once the model's own
    error decides."""

    def error(grid: int, noise: float) -> float:
        probe = replace(_probe(grid), std=None)
        probe = replace(probe, std=np.full_like(probe.displacement, noise))
        value = probe.response.value
        step = model_step(
            "m", 0.01, lambda nu: value(nu)[:, None], lambda nu: 2 * value(nu)[:, None]
        )
        normal = minimum_of(problem_of([replace(probe, nuisances=(step,))])).normal
        return float(np.sqrt(normal.covariance[0, 0]))

    few, many = error(10, 1e-9), error(40, 1e-9)
    assert few / many < 2.5
    assert error(10, 1e-10) == pytest.approx(few, rel=0.01)
    # Without an error of the model it is the noise alone.
    plain = []
    for grid in (10, 40):
        probe = _probe(grid)
        sure = replace(probe, std=np.full((len(probe.position), 3), 1e-9))
        plain.append(np.sqrt(minimum_of(problem_of([sure])).normal.covariance[0, 0]))
    assert plain[0] / plain[1] > 3.0


def test_probings_share_their_modes() -> None:
    """Of few of the points as of all, where these are all that is observed."""
    places = observed_rows_of(_probe()).position
    at = correlated_patterns(places)
    np.testing.assert_allclose(at(places[::5]), at(places)[::5], rtol=1e-12)
    twice = correlated_patterns(np.concatenate([places, places]))
    np.testing.assert_allclose(np.abs(twice(places)), np.abs(at(places)), atol=1e-9)


def test_few_points_have_no_patterns() -> None:
    rows = observed_rows_of(_probe(3))
    unknown = _unknown(rows, np.full((len(rows.measured), 1), 1e-6))
    assert unknown.count == 1
    np.testing.assert_allclose(unknown.variance, 1e-12)
    assert patterns(problem_of([_probe(3)]), 0).shape[0] == 0


@pytest.mark.slow
def test_an_error_that_all_probings_share_does_not_average_out() -> None:
    """Eight looks at the same nine points of a mesh, each point a tenth of a micrometre off, the
    same in every look: Poisson's ratio scatters as one look's would, and as claimed."""
    rng, size, draws = np.random.default_rng(8), 1e-7, 60
    look = half_space_probes(rng, count=1, grid=3, noise=0.0)[0]
    value = look.response.value(0.28)[:, None]
    other = value * (1.0 + size / (value[:, 0, :3] @ look.force / 2.1e4))[:, None, None]
    step = model_step("mesh", 1.0, lambda _: value, lambda _: other)
    std = np.full_like(look.displacement, 1e-9)
    looks = [replace(look, name=f"look {k}", std=std, nuisances=(step,)) for k in range(8)]

    def found(displacement: np.ndarray, count: int = 8) -> tuple[float, float]:
        probes = [replace(repeated, displacement=displacement) for repeated in looks[:count]]
        minimum = minimum_of(problem_of(probes))
        return minimum.poisson_ratio, float(np.sqrt(minimum.normal.covariance[0, 0]))

    off = look.displacement + size * rng.normal(size=(draws, *look.displacement.shape))
    ratios, claims = np.transpose([found(displacement) for displacement in off])
    assert found(look.displacement)[1] == pytest.approx(found(look.displacement, 1)[1], rel=0.02)
    # A scatter from 60 draws is known to 9 %; eight independent looks would claim a third of it.
    assert np.std(ratios) == pytest.approx(claims.mean(), rel=0.3)

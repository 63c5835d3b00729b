"""The objective: derivatives against differences, its terms against the formula."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from estimation.fitted import patterns, problem_of
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
from palpate.estimation.normal_equations import Evaluation
from palpate.estimation.observed_rows import observed_rows_of
from palpate.pipeline.model.contacts.contact_errors import contact_error, tool_slip
from palpate.pipeline.model.measurement_errors import force_direction, force_gain, length_scale
from palpate.pipeline.observations.converged_observations import model_step

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

        def give(at: ResponseTerms, columns: int = columns) -> np.ndarray:
            own = np.full((len(at.rows), columns, 1), 5e-4 * at.poisson_ratio)
            return np.stack([np.zeros_like(own), own], axis=1)

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
                    Nuisance((NuisanceParameter("compliance of support 1", 0.5, "m/Pa"),), give),
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
        own = [*range(layout.common), *range(block.whole.start, block.whole.stop)]
        for row, entry in enumerate(own):
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
            each.linearised(theta)[0][0] for each in (problem, problem.expanded(0.28 + offset))
        )
        missed.append(np.linalg.norm(far - near))
    assert missed[0] / missed[1] == pytest.approx(4.0, rel=0.15)


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
    assert [one.name for one in problem.own(1)] == ["n02 0", "n02 1", "n02 a", "n02 b"]
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

"""Fisher information of probings before they are made, and the Cramer-Rao bound from it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.estimation.gauss_newton import stated_excess
from palpate.estimation.measured_components import observed_rows_of
from palpate.estimation.noise import Gaussian
from palpate.estimation.normal_equations import Evaluation
from palpate.estimation.observations import ProbeObservations
from palpate.estimation.posterior import directions, posterior_of, uncertainty_budget
from palpate.estimation.problem import Problem, make_problem
from palpate.records import CONSTANT_NAMES, BudgetEntry

_ANY_RATIO = (-0.99, 0.4999)


@dataclass(frozen=True, slots=True, eq=False)
class Information:
    """Fisher information of each probing, for Gaussian noise of the claimed standard deviations.

    Uncertain forces and each probing's own errors are eliminated, with their claimed uncertainties
    as priors.

    Attributes
    ----------
    parts : (k, d, d) float         of nu, log G and the d - 2 shared errors, these in prior
                                    standard deviations
    moved : (k, d, d) float         sum of the outer products of the derivatives of the observed
                                    components, over the sum of these components' squares
    budget : tuple of BudgetEntry   contributions of the sources to the bound of all probings
    poisson_ratio : float [-]       at which it is taken
    shear_modulus : float [Pa]
    """

    parts: Float[np.ndarray, "k d d"]
    moved: Float[np.ndarray, "k d d"]
    budget: tuple[BudgetEntry, ...]
    poisson_ratio: float
    shear_modulus: float

    def of(self, probings: Sequence[int]) -> Float[np.ndarray, "2 2"]:
        """Information of some probings together about (nu, log G), (2, 2), shared errors
        eliminated."""
        information = self._of(probings)
        return information[:2, :2] - information[:2, 2:] @ np.linalg.solve(
            information[2:, 2:], information[2:, :2]
        )

    def prediction(self, probings: Sequence[int], others: Sequence[int]) -> float:
        """Standard deviation with which some probings predict the displacements of others from
        their force, by what all have in common: relative, root mean square over the others.

        Parameters
        ----------
        probings, others : sequence of int
        """
        covariance = np.linalg.pinv(self._of(probings), hermitian=True)
        variance = np.einsum("kij,ij->k", self.moved[list(others)], covariance)
        return float(np.sqrt(variance.mean()))

    def _of(self, probings: Sequence[int]) -> Float[np.ndarray, "d d"]:
        """Information of some probings and the priors about all parameters."""
        information = np.asarray(self.parts[list(probings)].sum(axis=0))
        information[2:, 2:] += np.eye(len(information) - 2)
        return information

    def bound(self, probings: Sequence[int] | None = None) -> dict[str, float]:
        """Cramer-Rao bound: the smallest standard deviations that any unbiased estimate can have.

        Parameters
        ----------
        probings : sequence of int or None      indices of those that are made; None: all

        Returns
        -------
        constant's name -> float        nu [-], G and E [Pa]; infinite where not identifiable
        """
        information = self.of(range(len(self.parts)) if probings is None else probings)
        covariance = np.linalg.pinv(information, hermitian=True)
        young = 2 * self.shear_modulus * (1 + self.poisson_ratio)
        bound = {}
        for (name, direction), value in zip(
            directions(self.poisson_ratio).items(), (1.0, self.shear_modulus, young), strict=True
        ):
            identifiable = np.allclose(information @ covariance @ direction, direction, atol=1e-6)
            std = float(np.sqrt(direction @ covariance @ direction))
            bound[name] = value * std if identifiable else np.inf
        return bound


def fisher_information(
    probes: Sequence[ProbeObservations],
    *,
    poisson_ratio: float,
    shear_modulus: float,
    errors: Mapping[str, float] | None = None,
) -> Information:
    """Information of some probings at given constants.

    Parameters
    ----------
    probes : sequence of ProbeObservations  all with standard deviations; their residuals determine
                                            the correlation of neighbouring points
    poisson_ratio : float [-]
    shear_modulus : float [Pa]              > 0
    errors : mapping or None                name -> value of shared errors that are not 0, in their
                                            priors' standard deviations

    Returns
    -------
    Information

    Raises
    ------
    InputError                              a probing has no standard deviations
    """
    for probe in probes:
        if probe.std is None:
            raise InputError(
                f"probing {probe.name!r} has no std; the bound needs the noise of every point"
            )
    rows = tuple(observed_rows_of(probe) for probe in probes)
    problem = make_problem(
        rows, Gaussian(), poisson_ratio=poisson_ratio, shear_modulus=shear_modulus
    )
    theta = np.zeros(problem.layout.size)
    theta[:2] = poisson_ratio, np.log(shear_modulus)
    theta[problem.layout.errors] = [(errors or {}).get(error.name, 0.0) for error in problem.shared]
    excess = stated_excess(Evaluation(problem, theta))
    at = Evaluation(replace(problem, information=problem.information / excess), theta)
    moved = _moved(problem, theta)
    information = Information(at.normal.parts, moved, (), poisson_ratio, shear_modulus)
    bound = information.bound()
    determined = {name: bool(np.isfinite(bound[name])) for name in CONSTANT_NAMES}
    budget = uncertainty_budget(posterior_of(at, _ANY_RATIO, np.inf), determined)
    return replace(information, budget=budget)


def _moved(problem: Problem, theta: Float[np.ndarray, " t"]) -> Float[np.ndarray, "k d d"]:
    """`Information.moved`."""
    residuals, derivatives = problem.linearised(theta)
    common = problem.layout.common
    return np.stack([
        table[:common] @ table[:common].T / np.square(probe.measured - residual).sum()
        for probe, residual, table in zip(problem.probes, residuals, derivatives, strict=True)
    ])  # fmt: skip

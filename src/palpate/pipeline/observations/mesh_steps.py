"""Steps between the models of several meshes of one body, and how far beyond them the truth lies.

A finer mesh moves every prediction a little; the truth lies at a multiple of that step, which
depends on the order of convergence and is known roughly. The expected part of it is added to the
model, the rest is an error with a prior.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.estimation import (
    Nuisance,
    NuisanceParameter,
    ProbeObservations,
    ResponseModel,
    ResponseTerms,
    padded,
)


@dataclass(frozen=True, slots=True, eq=False)
class MeshStep:
    """Change of one probing's response from one mesh to another, or from one fit between vertices
    to another.

    Attributes
    ----------
    name : str                      of its error, worded so that it can end a sentence
    share : float [-]               expected multiple of the step at which the truth lies
    std : float [-]                 its standard deviation, > 0
    before, after : ProbeObservations    the probing with both models
    """

    name: str
    share: float
    std: float
    before: ProbeObservations
    after: ProbeObservations

    def change(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows c"]:
        """The step in the response (`ResponseModel`)."""
        before, after = self.before.response, self.after.response
        return after.value(poisson_ratio) - before.value(poisson_ratio)

    def error(self) -> Nuisance:
        """What is not known of the multiple, one parameter for all probings."""

        def effects(at: ResponseTerms) -> Float[np.ndarray, "r t c 1"]:
            steps = [
                side.response_terms(at.poisson_ratio)[at.rows] for side in (self.before, self.after)
            ]
            count = max(step.shape[1] for step in steps)
            first, second = (padded(step[..., None], count) for step in steps)
            return self.std * (second - first)

        parameter = NuisanceParameter(self.name, self.std, of="mesh", is_model_error=True)
        return Nuisance((parameter,), effects)


@dataclass(frozen=True, slots=True, eq=False)
class ExtrapolatedResponse:
    """Response of one probing (`ResponseModel`) with the expected part of some steps added.

    Attributes
    ----------
    model : ResponseModel
    steps : tuple of MeshStep
    """

    model: ResponseModel
    steps: tuple[MeshStep, ...]

    def value(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows c"]:
        """See `ResponseModel`."""
        value = self.model.value(poisson_ratio)
        for step in self.steps:
            if step.share:
                value = value + step.share * step.change(poisson_ratio)
        return value


def extrapolated(probe: ProbeObservations, steps: Sequence[MeshStep]) -> ProbeObservations:
    """A probing whose model is carried on along some steps, with the errors of that.

    Parameters
    ----------
    probe : ProbeObservations
    steps : sequence of MeshStep    of this probing

    Returns
    -------
    ProbeObservations
    """
    errors = (step.error() for step in steps)
    return replace(
        probe,
        response=ExtrapolatedResponse(probe.response, tuple(steps)),
        nuisances=(*probe.nuisances, *errors),
    )

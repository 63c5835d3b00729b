"""Round parts of a body, where they explain its displacements better than any smooth field does.

A smooth field spreads a small stiff part over its length, so what it says of the part's modulus is
a bound. Here the logarithm of the modulus over that of the rest, which is G, is a step:

    m(x) = sum_k c_k (1 - tanh((|x - x_k| - r_k) / w)) / 2,

w half an edge of the elements. Centres, radii and contrasts are parameters that all probings share;
the responses are expanded about them anew until they stand still.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from palpate.estimation import Evaluation, FitSettings, ProbeObservations, joint_minimum
from palpate.field.field_fit import FieldFit, log_bayes_factor, modes_in
from palpate.field.field_map import FieldPosterior, map_of
from palpate.field.field_prior import FieldModes
from palpate.field.field_responses import (
    CoefficientPrior,
    FieldExpansion,
    FieldModel,
    PushModel,
)
from palpate.records import HALF_95, FieldEstimate, ModulusMap, Session, StiffPart
from palpate.shapes import Points

# Parameters of a part: its centre, the logarithm of its radius, its contrast.
_EACH = 5
# Before the data: a centre anywhere in the body; a radius within a factor of two or so of this
# share of the cube root of its volume; a contrast within a factor of 30 (95 %).
_RADIUS, _RADIUS_STD, _CONTRAST = 0.15, 0.7, float(np.log(30.0)) / HALF_95
# Most rounds; longest steps of a centre over the radius, of the logarithm of the radius and of the
# contrast; share of these that ends the rounds.
_MOST_ROUNDS, _LONGEST, _SETTLED = 12, np.array([0.7, 0.7, 0.7, 0.4, 0.8]), 0.03
# A smooth field makes a small part about so many times as wide as it is.
_BLURRED = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class InclusionFit:
    """Round parts with what the data say about them.

    Attributes
    ----------
    smooth : FieldEstimate          the smooth field in whose place they are
    is_known : (m,) bool            elements of which that field is known
    expansion : FieldExpansion      about the parts that fit best
    prior : CoefficientPrior        of the changes of their parameters
    about : (k, 5) float            parameters about which it is expanded: centre [m], logarithm of
                                    the radius, contrast
    log_evidence : float            over that of a body that is the same everywhere
    observations : list of ProbeObservations    with their response, their parameters as errors that
                                    all probings share
    """

    smooth: FieldEstimate
    is_known: Bool[np.ndarray, " m"]
    expansion: FieldExpansion
    prior: CoefficientPrior
    about: Float[np.ndarray, "k 5"]
    log_evidence: float
    observations: list[ProbeObservations]

    def with_field(
        self, session: Session, observations: Sequence[ProbeObservations]
    ) -> list[ProbeObservations]:
        """As of every `UnevenBody`."""
        return self.expansion.under(session, observations).observations(self.prior)

    def described(self, minimum: Evaluation) -> tuple[FieldEstimate, ModulusMap]:
        """What a fit of `observations` says of the parts, and the modulus of every element over
        that of the rest.

        Parameters
        ----------
        minimum : Evaluation
        """
        where, scale = modes_in(minimum), self.prior.mixing[1:]
        moved = self.prior.mean[1:] + scale @ minimum.theta[where]
        covariance = scale @ minimum.normal.covariance[np.ix_(where, where)] @ scale.T
        parts = self.about + moved.reshape(-1, _EACH)
        described = _stiff_parts(parts, np.sqrt(np.diag(covariance)).reshape(-1, _EACH))
        estimate = replace(self.smooth, log_evidence=self.log_evidence, parts=described)
        body = self.expansion.model.body
        points, width = body.points.reshape(-1, 3), _width(self.expansion.model)
        fields = body.means(_fields(parts, points, width))
        mapped = map_of(body.solid, fields[:, 0], fields[:, 1:], covariance, self.is_known)
        return estimate, mapped


def _stiff_parts(
    parts: Float[np.ndarray, "k 5"], std: Float[np.ndarray, "k 5"]
) -> tuple[StiffPart, ...]:
    """The parts, the largest effect first."""
    described = []
    for part, error in zip(parts, std, strict=True):
        x, y, z = (float(coordinate) for coordinate in part[:3])
        low, middle, high = (
            float(np.exp(part[4] + side * HALF_95 * error[4])) for side in (-1.0, 0.0, 1.0)
        )
        size = 2.0 * float(np.exp(part[3]))
        place_std = float(error[:3].max())
        described.append(StiffPart((x, y, z), size, middle, low, high, place_std=place_std))
    return tuple(
        sorted(described, key=lambda candidate: -abs(np.log(candidate.ratio)) * candidate.size**3)
    )


def fit_inclusions(
    field: FieldFit,
    posterior: FieldPosterior,
    observations: Sequence[ProbeObservations],
    settings: FitSettings,
) -> InclusionFit | None:
    """Expand about the round parts that fit best, beginning with those of a smooth field.

    Parameters
    ----------
    field : FieldFit
    posterior : FieldPosterior      of its fit
    observations : sequence of ProbeObservations    with the homogeneous body's response
    settings : FitSettings

    Returns
    -------
    InclusionFit or None            None: the field has no such parts, or they do not settle; pokes
                                    without pictures tell too little
    """
    starts = [part for part in posterior.parts() if not part.depth]
    if not starts or not isinstance(field.expansion.model, PushModel):
        return None
    parts = np.array([
        [*part.centre, np.log(0.5 * part.size / _BLURRED), _BLURRED * np.log(part.ratio)]
        for part in starts
    ])  # fmt: skip
    model = field.expansion.model
    plain = joint_minimum(observations, settings)
    ratio = field.expansion.poisson_ratio
    before = np.zeros_like(parts)
    for _ in range(_MOST_ROUNDS):
        expansion = _with_parts(model, parts).expanded(
            np.eye(1 + parts.size)[0], ratio, field.expansion.homogeneous
        )
        prior = _prior(model, parts)
        minimum = joint_minimum(expansion.observations(prior), settings)
        step = (prior.mean + prior.mixing @ minimum.theta[modes_in(minimum)])[1:]
        step = step.reshape(parts.shape)
        limit = _LONGEST * np.where(np.arange(_EACH) < 3, np.exp(parts[:, 3:4]), 1.0)
        change = float(np.abs(step / limit).max())
        if change < _SETTLED:
            expansion = expansion.with_slope()
            evidence = log_bayes_factor(minimum, plain, settings)
            observed = expansion.observations(prior)
            return InclusionFit(
                field.estimate(posterior), posterior.is_known, expansion, prior, parts, evidence,
                observed,
            )  # fmt: skip
        # Of steps that alternate the middle is nearer.
        step = step / max(change, 2.0 if (step * before / limit**2).sum() < 0.0 else 1.0)
        parts, before = parts + step, step
    return None


def _with_parts(model: FieldModel, parts: Float[np.ndarray, "k 5"]) -> FieldModel:
    """The model with round parts as its first mode, and the derivatives by their parameters."""
    points = model.body.points.reshape(-1, 3)
    fields = _fields(parts, points, _width(model))
    return replace(model, modes=FieldModes(fields, np.zeros(0), (), np.zeros(len(points))))


def _width(model: FieldModel) -> float:
    """Half an edge of the elements [m]."""
    return 0.5 * float(np.sqrt(2.0) * 6.0 * np.median(model.body.volume)) ** (1.0 / 3.0)


def _fields(
    parts: Float[np.ndarray, "k 5"], points: Points, width: float
) -> Float[np.ndarray, "p f"]:
    """Logarithm of the modulus at points, and its derivatives by the parameters of the parts."""
    value, slopes = np.zeros(len(points)), []
    for *centre, log_radius, contrast in parts:
        offset, radius = points - np.array(centre), float(np.exp(log_radius))
        distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-9 * radius)
        bend = np.tanh((distance - radius) / width)
        inside, steep = 0.5 * (1.0 - bend), 0.5 * contrast * (1.0 - bend**2) / width
        value += contrast * inside
        toward = offset / distance[:, None]
        slopes += [*(steep[:, None] * toward).T, steep * radius, inside]
    return np.stack([value, *slopes], axis=1)


def _prior(model: FieldModel, parts: Float[np.ndarray, "k 5"]) -> CoefficientPrior:
    """Prior of the changes of the parameters from given ones; the parts themselves are certain."""
    body = model.body
    size = float(body.volume.sum()) ** (1.0 / 3.0)
    points, weight = body.points.reshape(-1, 3), body.weight.ravel()
    middle = weight @ points / weight.sum()
    spread = np.sqrt(weight @ (points - middle) ** 2 / weight.sum())
    mean = np.tile([*middle, np.log(_RADIUS * size), 0.0], (len(parts), 1)) - parts
    std = np.tile([*spread, _RADIUS_STD, _CONTRAST], len(parts))
    names = tuple(
        f"{what} of round part {k + 1}"
        for k in range(len(parts))
        for what in ("x", "y", "z", "radius", "contrast")
    )
    none = np.zeros(1 + parts.size)
    mixing = np.vstack([np.zeros(parts.size), np.diag(std)])
    return CoefficientPrior(names, mixing, np.append(1.0, mean.ravel()), none, none)

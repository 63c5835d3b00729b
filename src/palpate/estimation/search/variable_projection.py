"""Variable projection: the best shear modulus for each Poisson's ratio; only nu is searched for.

With weights held fixed, displacement is linear in beta = 1 / G, and the unknown true forces are
eliminated in closed form in the eigenbasis of their 3 x 3 information. The misfit of a probing is

    Q(beta) = yy - 2 beta yq + beta^2 qq - sum_j (beta c_j - beta^2 d_j)^2 / (1 + beta^2 lambda_j)

with q the displacement times G under the measured force and y the measurement. Motions of supports
do not depend on beta and are eliminated first. With exact forces the sum is empty and the best beta
is yq / qq; otherwise a few Newton steps follow from there, for all Poisson's ratios at once.

Source
------
Golub and Pereyra, The differentiation of pseudo-inverses and nonlinear least squares problems whose
variables separate, SIAM J. Numer. Anal. 10 (1973).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float, Int

from palpate.estimation.observed_rows import ObservedRows, weighted_square
from palpate.estimation.responses import ResponseTable, interpolation_weights

_MAX_NEWTON_STEPS = 8
_NEWTON_TOLERANCE = 1e-10
_LONGEST_STEP = 0.7
_SMALLEST_COMPLIANCE = 1e-9
_GRID = 49


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedProbes:
    """Coefficients of Q(beta) for every probing and Poisson's ratio, with forces eliminated.

    Parameters
    ----------
    yy : (k, g) float                   see the module's docstring
    yq, qq : (k, g) float
    c, d, information : (k, g, 3) float  terms of the sum; information is lambda
    """

    yy: Float[np.ndarray, "k g"]
    yq: Float[np.ndarray, "k g"]
    qq: Float[np.ndarray, "k g"]
    c: Float[np.ndarray, "k g 3"]
    d: Float[np.ndarray, "k g 3"]
    information: Float[np.ndarray, "k g 3"]


@dataclass(frozen=True, slots=True, eq=False)
class FixedWeights:
    """A misfit with its robust weights held fixed, for any set of probings.

    A probing enters only through the products of its responses R at all pairs of nodes. With all
    pairs the products at any ratio are exactly those of interpolated responses; interpolating the
    products themselves would leave an error above the noise where the signal is strong.

    Parameters
    ----------
    poisson_range : (float, float) [-]
    poisson_ratio : (m,) float [-]                      nodes, rising
    response_response : (k, m, c, m, c) float           R' W R
    response_measured : (k, m, c) float                 R' W y
    measured_measured : (k,) float [-]                  y' W y
    force : (k, 3) float [N]
    force_root : (k, 3) float [N]                       1 sigma over the root of its robust weight
    motion, motion_std : (k, q) float                   of supports, q = c - 4
    """

    poisson_range: tuple[float, float]
    poisson_ratio: Float[np.ndarray, " m"]
    response_response: Float[np.ndarray, "k m c m c"]
    response_measured: Float[np.ndarray, "k m c"]
    measured_measured: Float[np.ndarray, " k"]
    force: Float[np.ndarray, "k 3"]
    force_root: Float[np.ndarray, "k 3"]
    motion: Float[np.ndarray, "k q"]
    motion_std: Float[np.ndarray, "k q"]

    def subset(self, chosen: int | Int[np.ndarray, " j"]) -> "FixedWeights":
        """The same for a subset of the probings.

        Parameters
        ----------
        chosen : int or (j,) int    their indices

        Returns
        -------
        FixedWeights                of 1 or j probings
        """
        index = np.atleast_1d(chosen)
        by_probe = {
            item.name: getattr(self, item.name)[index]
            for item in fields(self)
            if item.name not in ("poisson_range", "poisson_ratio")
        }
        return replace(self, **by_probe)

    def at(self, poisson_ratio: Float[np.ndarray, " g"]) -> ProjectedProbes:
        """Eliminate the true forces of all probings.

        Parameters
        ----------
        poisson_ratio : (g,) float [-]  within the range of the table

        Returns
        -------
        ProjectedProbes                 at each of these ratios
        """
        weight = interpolation_weights(self.poisson_ratio, poisson_ratio)
        half = np.einsum("kaibj,gb->kgiaj", self.response_response, weight, optimize=True)
        square = (weight[:, None, None, :] @ half)[..., 0, :]
        mixed = np.einsum("gm,kmi->kgi", weight, self.response_measured)
        yy, mixed, square = self._without_motions(mixed, square)
        load = np.concatenate([self.force, np.ones((len(self.force), 1))], axis=1)
        carried = np.einsum("kgij,kj->kgi", square, load)
        root = self.force_root[:, None, :]
        inner = square[..., :3, :3] * root[..., :, None] * root[..., None, :]
        value, vector = np.linalg.eigh(inner)
        to_eigenbasis = vector.swapaxes(-1, -2)
        return ProjectedProbes(
            yy=yy,
            yq=np.einsum("kgi,ki->kg", mixed, load),
            qq=np.einsum("kgi,ki->kg", carried, load),
            c=(to_eigenbasis @ (mixed[..., :3] * root)[..., None])[..., 0],
            d=(to_eigenbasis @ (carried[..., :3] * root)[..., None])[..., 0],
            information=np.maximum(value, 0.0),
        )

    def _without_motions(
        self, mixed: Float[np.ndarray, "k g c"], square: Float[np.ndarray, "k g c c"]
    ) -> tuple[Float[np.ndarray, "k g"], Float[np.ndarray, "k g 4"], Float[np.ndarray, "k g 4 4"]]:
        """Products of the measurement and of the four load columns, with known motions subtracted
        and uncertain ones eliminated."""
        yy = np.repeat(self.measured_measured[:, None], mixed.shape[1], axis=1)
        from_motion = np.einsum("kgij,kj->kgi", square[..., 4:], self.motion)
        yy = yy - np.einsum("kgi,ki->kg", 2 * mixed[..., 4:] - from_motion[..., 4:], self.motion)
        root = self.motion_std[:, None, :]
        crossed = square[..., 4:, :4] * root[..., None]
        rest = ((mixed - from_motion)[..., 4:] * root)[..., None]
        inner = square[..., 4:, 4:] * root[..., :, None] * root[..., None, :]
        solved = np.linalg.solve(
            inner + np.eye(inner.shape[-1]), np.concatenate([crossed, rest], axis=-1)
        )
        eliminated = crossed.swapaxes(-1, -2) @ solved
        return (
            yy - (rest * solved[..., -1:])[..., 0].sum(-1),
            (mixed - from_motion)[..., :4] - eliminated[..., -1],
            square[..., :4, :4] - eliminated[..., :-1],
        )


def fixed_weights(
    probes: Sequence[ObservedRows],
    table: ResponseTable,
    level: Float[np.ndarray, " 8"],
    weights: Sequence[Float[np.ndarray, " _"]],
    force_weights: Float[np.ndarray, " k"],
    explained: Sequence[Float[np.ndarray, " _"]] | None = None,
) -> FixedWeights:
    """The misfit for given noise levels and robust weights.

    Parameters
    ----------
    probes : sequence of k ObservedRows
    table : ResponseTable                   of these probings
    level : (8,) float                      see `noise_levels`
    weights : one (p,) float for each       of the points
    force_weights : (k,) float              of the measured forces
    explained : one (r,) float [m] for each probing, or None    displacement explained by the
                                            nuisance parameters; None: zero

    Returns
    -------
    FixedWeights
    """
    count = len(table.poisson_ratio)
    measured = [probe.measured for probe in probes]
    if explained is not None:
        measured = [value - part for value, part in zip(measured, explained, strict=True)]
    products = np.stack(
        [
            weighted_square(
                np.vstack([response.reshape(-1, len(value)), value]),
                probe.per_row(weight) / probe.sigma(level) ** 2,
            )
            for probe, response, weight, value in zip(
                probes, table.response, weights, measured, strict=True
            )
        ]
    )
    observed = [probe.observations for probe in probes]
    columns = 4 + len(observed[0].motion)
    shape = (len(products), count, columns)
    return FixedWeights(
        table.poisson_range,
        table.poisson_ratio,
        products[:, :-1, :-1].reshape(*shape, count, columns),
        products[:, :-1, -1].reshape(shape),
        products[:, -1, -1],
        np.stack([one.force for one in observed]),
        np.stack([one.force_std for one in observed]) / np.sqrt(force_weights)[:, None],
        np.stack([one.motion for one in observed]),
        np.stack([one.motion_std for one in observed]),
    )


def deviance_of(
    probes: ProjectedProbes, compliance: Float[np.ndarray, "*l g"]
) -> tuple[Float[np.ndarray, "*l g"], Float[np.ndarray, "*l g"], Float[np.ndarray, "*l g"]]:
    """Misfit of all probings at given beta = 1 / G, with its derivatives in log beta.

    Parameters
    ----------
    probes : ProjectedProbes
    compliance : (..., g) float [1/Pa]  > 0, for each Poisson's ratio

    Returns
    -------
    three (..., g) float                misfit, first and second derivative
    """
    beta = compliance[..., None, :]
    b3 = beta[..., None]
    numerator = b3 * (probes.c - b3 * probes.d)
    numerator_slope = probes.c - 2 * b3 * probes.d
    denominator = 1 + b3**2 * probes.information
    denominator_slope = 2 * b3 * probes.information
    ratio = numerator / denominator
    value = probes.yy - beta * (2 * probes.yq - beta * probes.qq) - (numerator * ratio).sum(-1)
    first = 2 * (beta * probes.qq - probes.yq) - 2 * (
        ratio * (numerator_slope - 0.5 * ratio * denominator_slope)
    ).sum(-1)
    drag = 2 * probes.d + ratio * probes.information
    curved = (numerator_slope - ratio * denominator_slope) ** 2 / denominator - ratio * drag
    second = 2 * probes.qq - 2 * curved.sum(-1)
    first, second = beta * first, beta * (first + beta * second)
    return value.sum(-2), first.sum(-2), second.sum(-2)


def best_compliance(
    probes: ProjectedProbes,
) -> tuple[Float[np.ndarray, " g"], Float[np.ndarray, " g"]]:
    """Best beta = 1 / G for every Poisson's ratio, and the misfit of all probings there.

    Parameters
    ----------
    probes : ProjectedProbes

    Returns
    -------
    ((g,) float [1/Pa], (g,) float)     beta > 0
    """
    mixed, square = probes.yq.sum(0), probes.qq.sum(0)
    scale = np.sqrt(np.maximum(probes.yy.sum(0), np.finfo(float).tiny) / square)
    smallest = _SMALLEST_COMPLIANCE * scale
    beta = np.maximum(mixed / square, smallest)
    for _ in range(_MAX_NEWTON_STEPS):
        _, first, second = deviance_of(probes, beta)
        step = -first / np.where(second > 0, second, np.abs(first) + np.finfo(float).tiny)
        beta = np.maximum(beta * np.exp(np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)), smallest)
        if np.abs(step).max() < _NEWTON_TOLERANCE:
            break
    return beta, deviance_of(probes, beta)[0]


def best_constants(weights: FixedWeights) -> tuple[float, float]:
    """Poisson's ratio and shear modulus at the global minimum for fixed weights.

    Parameters
    ----------
    weights : FixedWeights

    Returns
    -------
    (float [-], float [Pa])
    """
    grid = np.linspace(*weights.poisson_range, _GRID)
    nu, _ = refined_minimum(grid, best_compliance(weights.at(grid))[1])
    compliance, _ = best_compliance(weights.at(np.array([nu])))
    return nu, float(1 / compliance[0])


def refined_minimum(
    place: Float[np.ndarray, " g"], height: Float[np.ndarray, " g"]
) -> tuple[float, float]:
    """Position and value of the minimum of a tabulated curve, refined by a parabola.

    Parameters
    ----------
    place : (g,) float          evenly spaced, ascending
    height : (g,) float

    Returns
    -------
    (float, float)              an end of the table if the lowest value lies there
    """
    best = int(np.argmin(height))
    if best in (0, len(place) - 1):
        return float(place[best]), float(height[best])
    left, middle, right = height[best - 1 : best + 2]
    second_difference = left - 2 * middle + right
    shift = 0.5 * (left - right) / second_difference if second_difference > 0 else 0.0
    spacing = place[1] - place[0]
    return float(place[best] + shift * spacing), float(middle - 0.25 * shift * (left - right))

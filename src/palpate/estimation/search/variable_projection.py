"""Variable projection: the best shear modulus for every Poisson's ratio, without a search in two.

With weights held fixed, displacement is linear in beta = 1 / G, and the unknown true forces drop
out in closed form in the eigenbasis of their 3 x 3 information. What is left of a probing is

    Q(beta) = yy - 2 beta yq + beta^2 qq - sum_j (beta c_j - beta^2 d_j)^2 / (1 + beta^2 lambda_j)

with q the displacement times G under the measured force. With exact forces the sum is empty and the
best beta is yq / qq; otherwise a few Newton steps from there, for all Poisson's ratios at once.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.responses import GramTable

_NEWTON_STEPS = 8
_SMALLEST = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedProbes:
    """What is left of every probing at every Poisson's ratio, forces eliminated.

    Shapes are broadcastable to (l, k, g): sets of probings, probings, Poisson's ratios.

    Parameters
    ----------
    yy, yq, qq : float                  see the file's head
    c, d, information : (..., 3) float  parts of the sum; information is lambda
    """

    yy: Float[np.ndarray, "..."]
    yq: Float[np.ndarray, "..."]
    qq: Float[np.ndarray, "..."]
    c: Float[np.ndarray, "... 3"]
    d: Float[np.ndarray, "... 3"]
    information: Float[np.ndarray, "... 3"]

    def apart(self) -> "ProjectedProbes":
        """Every probing as a set of its own: from (1, k, g) to (k, 1, g)."""
        fields = (self.yy, self.yq, self.qq, self.c, self.d, self.information)
        return ProjectedProbes(*(field.swapaxes(0, 1) for field in fields))


def projected(
    gram: GramTable, force: Float[np.ndarray, "k 3"], force_root: Float[np.ndarray, "k 3"]
) -> ProjectedProbes:
    """Eliminate the true forces of all probings at the Poisson's ratios of a Gram table.

    Parameters
    ----------
    gram : GramTable
    force : (k, 3) float [N]            measured
    force_root : (k, 3) float [N]       1 sigma, already divided by the root of its robust weight

    Returns
    -------
    ProjectedProbes                     with the shape (1, k, g)
    """
    load = np.concatenate([force, np.ones((len(force), 1))], axis=1)
    carried = np.einsum("kgij,kj->kgi", gram.response_response, load)
    root = force_root[:, None, :]
    inner = gram.response_response[..., :3, :3] * root[..., :, None] * root[..., None, :]
    value, vector = np.linalg.eigh(inner)
    turn = vector.swapaxes(-1, -2)
    mixed = (turn @ (gram.response_measured[..., :3] * root)[..., None])[..., 0]
    pushed = (turn @ (carried[..., :3] * root)[..., None])[..., 0]
    return ProjectedProbes(
        yy=gram.measured_measured[None, :, None],
        yq=np.einsum("kgi,ki->kg", gram.response_measured, load)[None],
        qq=np.einsum("kgi,ki->kg", carried, load)[None],
        c=mixed[None],
        d=pushed[None],
        information=np.maximum(value, 0.0)[None],
    )


def deviance_of(
    probes: ProjectedProbes,
    compliance: Float[np.ndarray, "l g"],
    multiplicity: Float[np.ndarray, "l k"] | None = None,
) -> tuple[Float[np.ndarray, "l g"], Float[np.ndarray, "l g"], Float[np.ndarray, "l g"]]:
    """Misfit at given beta = 1 / G with its first and second derivative in log beta.

    Parameters
    ----------
    probes : ProjectedProbes
    compliance : (l, g) float [1/Pa]    beta, for each set and each Poisson's ratio
    multiplicity : (l, k) float or None how often each probing counts in each set, None = once
    """
    beta = compliance[:, None, :]
    b3 = beta[..., None]
    top = b3 * (probes.c - b3 * probes.d)
    top1 = probes.c - 2 * b3 * probes.d
    below = 1 + b3**2 * probes.information
    below1 = 2 * b3 * probes.information
    ratio = top / below
    value = probes.yy - beta * (2 * probes.yq - beta * probes.qq) - (top * ratio).sum(-1)
    first = 2 * (beta * probes.qq - probes.yq) - 2 * (ratio * (top1 - 0.5 * ratio * below1)).sum(-1)
    drag = 2 * probes.d + ratio * probes.information
    curved = (top1 - ratio * below1) ** 2 / below - ratio * drag
    second = 2 * probes.qq - 2 * curved.sum(-1)
    first, second = beta * first, beta * (first + beta * second)
    summed = [_total(part, multiplicity) for part in (value, first, second)]
    return summed[0], summed[1], summed[2]


def best_compliance(
    probes: ProjectedProbes, multiplicity: Float[np.ndarray, "l k"] | None = None
) -> tuple[Float[np.ndarray, "l g"], Float[np.ndarray, "l g"]]:
    """Best beta = 1 / G for every set of probings and every Poisson's ratio, and its misfit.

    Returns
    -------
    ((l, g) float [1/Pa], (l, g) float)
    """
    mixed, square = _total(probes.yq, multiplicity), _total(probes.qq, multiplicity)
    power = np.maximum(_total(probes.yy, multiplicity), np.finfo(float).tiny)
    scale = np.sqrt(power / square)
    beta = np.maximum(mixed / square, _SMALLEST * scale)
    for _ in range(_NEWTON_STEPS):
        _, first, second = deviance_of(probes, beta, multiplicity)
        step = -first / np.where(second > 0, second, np.abs(first) + np.finfo(float).tiny)
        beta = np.maximum(beta * np.exp(np.clip(step, -0.7, 0.7)), _SMALLEST * scale)
        if np.abs(step).max() < 1e-10:
            break
    return beta, deviance_of(probes, beta, multiplicity)[0]


def _total(
    part: Float[np.ndarray, "..."], multiplicity: Float[np.ndarray, "l k"] | None
) -> Float[np.ndarray, "l g"]:
    """Sum over the probings of each set."""
    return part.sum(1) if multiplicity is None else (part * multiplicity[:, :, None]).sum(1)


def parabola_minimum(place: Float[np.ndarray, " g"], height: Float[np.ndarray, " g"]) -> float:
    """Place of the global minimum of a tabulated curve, sharpened by a parabola, inside the range.

    Parameters
    ----------
    place : (g,) float          evenly spaced, rising
    height : (g,) float
    """
    best = int(np.argmin(height))
    if best in (0, len(place) - 1):
        return float(place[best])
    left, middle, right = height[best - 1 : best + 2]
    bend = left - 2 * middle + right
    shift = 0.5 * (left - right) / bend if bend > 0 else 0.0
    return float(place[best] + shift * (place[1] - place[0]))

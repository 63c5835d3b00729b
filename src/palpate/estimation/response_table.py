"""Responses tabulated once over Poisson's ratio: the whole likelihood costs next to nothing.

The response is smooth in Poisson's ratio, so its values at Chebyshev nodes give it everywhere. With
weights held fixed a probing enters the likelihood only through small Gram matrices at those nodes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.observations import ObservedRows

__all__ = ["GramTable", "ResponseTable", "gram_table", "interpolation_weights", "response_table"]

# Nodes for a range of 0.5, more in proportion. Nearest pole of an elastic response at nu about 1
# or 0.6 at worst: error below 1e-4 of the response; the final estimate uses exact responses.
_NODES_A_HALF = 9


@dataclass(frozen=True, slots=True, eq=False)
class ResponseTable:
    """Responses of all probings at the Chebyshev nodes of a range of Poisson's ratio.

    Parameters
    ----------
    poisson_ratio : (m,) float [-]                  nodes, rising
    response : tuple of (m, 4, r) float [m Pa/N]    one for each probing, column-major
    """

    poisson_ratio: Float[np.ndarray, " m"]
    response: tuple[Float[np.ndarray, "m 4 _"], ...]

    def at(self, poisson_ratio: float) -> tuple[Float[np.ndarray, "4 _"], ...]:
        """Interpolated responses of all probings, transposed."""
        weight = interpolation_weights(self.poisson_ratio, np.array([poisson_ratio]))[0]
        return tuple(np.tensordot(weight, response, axes=1) for response in self.response)


@dataclass(frozen=True, slots=True, eq=False)
class GramTable:
    """Weighted products of response and measurement of every probing at every node.

    Parameters
    ----------
    poisson_ratio : (m,) float [-]
    response_response : (k, m, 4, 4) float      R' W R
    response_measured : (k, m, 4) float         R' W y
    measured_measured : (k,) float              y' W y
    """

    poisson_ratio: Float[np.ndarray, " m"]
    response_response: Float[np.ndarray, "k m 4 4"]
    response_measured: Float[np.ndarray, "k m 4"]
    measured_measured: Float[np.ndarray, " k"]

    def at(self, poisson_ratio: Float[np.ndarray, " g"]) -> "GramTable":
        """The same products at other Poisson's ratios inside the range."""
        weight = interpolation_weights(self.poisson_ratio, poisson_ratio)
        return GramTable(
            poisson_ratio,
            np.einsum("gm,kmij->kgij", weight, self.response_response, optimize=True),
            np.einsum("gm,kmi->kgi", weight, self.response_measured, optimize=True),
            self.measured_measured,
        )


def response_table(
    probes: Sequence[ObservedRows], poisson_range: tuple[float, float]
) -> ResponseTable:
    """Tabulate the responses of all probings over a range of Poisson's ratio.

    Parameters
    ----------
    probes : sequence of ObservedRows
    poisson_range : (float, float) [-]      ends, lower one first
    """
    low, high = poisson_range
    count = _NODES_A_HALF + int(np.ceil(_NODES_A_HALF * max(0.0, 2 * (high - low) - 1)))
    angle = np.pi * (np.arange(count) + 0.5) / count
    node = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angle)
    response = tuple(
        np.stack([np.ascontiguousarray(probe.value(float(nu)).T) for nu in node])
        for probe in probes
    )
    return ResponseTable(node, response)


def gram_table(
    table: ResponseTable,
    measured: Sequence[Float[np.ndarray, " _"]],
    weight: Sequence[Float[np.ndarray, " _"]],
) -> GramTable:
    """Products of every probing for given row weights (robust weight over variance) [1/m^2]."""
    both, mixed, plain = [], [], []
    for response, y, w in zip(table.response, measured, weight, strict=True):
        weighted = response * w
        both.append(weighted @ response.transpose(0, 2, 1))
        mixed.append(weighted @ y)
        plain.append(y @ (w * y))
    return GramTable(table.poisson_ratio, np.stack(both), np.stack(mixed), np.array(plain))


def interpolation_weights(
    node: Float[np.ndarray, " m"], target: Float[np.ndarray, " g"]
) -> Float[np.ndarray, "g m"]:
    """Barycentric interpolation from Chebyshev nodes of the first kind to other places.

    Source
    ------
    Berrut and Trefethen, Barycentric Lagrange interpolation, SIAM Review 46 (2004), eq. 5.3.
    """
    count = len(node)
    factor = np.sin(np.pi * (np.arange(count) + 0.5) / count) * (-1.0) ** np.arange(count)
    distance = target[:, None] - node
    exact = distance == 0
    weight = factor / np.where(exact, 1.0, distance)
    weight = np.where(exact.any(axis=1, keepdims=True), exact.astype(float), weight)
    return weight / weight.sum(axis=1, keepdims=True)

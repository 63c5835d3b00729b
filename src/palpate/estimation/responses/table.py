"""Responses tabulated once over Poisson's ratio: the whole likelihood costs next to nothing.

The response is smooth in Poisson's ratio, so its values at Chebyshev nodes give it everywhere. With
weights held fixed a probing enters the likelihood only through small Gram matrices at those nodes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.observations import ObservedRows

# Nodes for a range of 0.5, more in proportion. Nearest pole of an elastic response at nu about 1
# or 0.6 at worst: error below 1e-4 of the response; the final estimate uses exact responses.
_NODES_A_HALF = 9
# Multiplications below which OpenBLAS keeps to one thread.
_UNTHREADED = 2**18


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
        return tuple(np.einsum("m,mir->ir", weight, response) for response in self.response)


@dataclass(frozen=True, slots=True, eq=False)
class GramTable:
    """Weighted products of response and measurement of every probing at some Poisson's ratios.

    Parameters
    ----------
    response_response : (k, g, 4, 4) float      R' W R
    response_measured : (k, g, 4) float         R' W y
    measured_measured : (k,) float              y' W y
    """

    response_response: Float[np.ndarray, "k g 4 4"]
    response_measured: Float[np.ndarray, "k g 4"]
    measured_measured: Float[np.ndarray, " k"]


@dataclass(frozen=True, slots=True, eq=False)
class NodeProducts:
    """Weighted products of the responses at all pairs of nodes.

    With all pairs the products elsewhere are exactly those of interpolated responses. Interpolating
    the products themselves would leave an error that no noise hides where the signal is strong.

    Parameters
    ----------
    poisson_ratio : (m,) float [-]
    response_response : (k, m, 4, m, 4) float
    response_measured : (k, m, 4) float
    measured_measured : (k,) float
    """

    poisson_ratio: Float[np.ndarray, " m"]
    response_response: Float[np.ndarray, "k m 4 m 4"]
    response_measured: Float[np.ndarray, "k m 4"]
    measured_measured: Float[np.ndarray, " k"]

    def at(self, poisson_ratio: Float[np.ndarray, " g"]) -> GramTable:
        """Products at Poisson's ratios inside the range."""
        weight = interpolation_weights(self.poisson_ratio, poisson_ratio)
        half = np.einsum("kaibj,gb->kgiaj", self.response_response, weight, optimize=True)
        both = (weight[:, None, None, :] @ half)[..., 0, :]
        mixed = np.einsum("gm,kmi->kgi", weight, self.response_measured)
        return GramTable(both, mixed, self.measured_measured)

    def only(self, index: int) -> "NodeProducts":
        """One probing as a set of its own."""
        chosen = slice(index, index + 1)
        return NodeProducts(
            self.poisson_ratio,
            self.response_response[chosen],
            self.response_measured[chosen],
            self.measured_measured[chosen],
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


def node_products(
    table: ResponseTable,
    measured: Sequence[Float[np.ndarray, " _"]],
    weight: Sequence[Float[np.ndarray, " _"]],
) -> NodeProducts:
    """Products of every probing for given row weights (robust weight over variance) [1/m^2]."""
    products = []
    count = len(table.poisson_ratio)
    for response, y, w in zip(table.response, measured, weight, strict=True):
        stacked = np.vstack([response.reshape(4 * count, -1), y])
        products.append(_weighted_square(stacked, w))
    every = np.stack(products)
    shape = (len(products), count, 4)
    return NodeProducts(
        table.poisson_ratio,
        every[:, :-1, :-1].reshape(*shape, count, 4),
        every[:, :-1, -1].reshape(shape),
        every[:, -1, -1],
    )


def _weighted_square(
    stacked: Float[np.ndarray, "s r"], weight: Float[np.ndarray, " r"]
) -> Float[np.ndarray, "s s"]:
    """Matrix product of rows with themselves, in pieces too small for BLAS to start threads.

    Threads that wait for each other cost ten times the product where other work is running.
    """
    size, rows = stacked.shape
    piece = max(1, _UNTHREADED // size**2)
    weighted = stacked * weight
    total = np.zeros((size, size))
    for first in range(0, rows, piece):
        chosen = slice(first, first + piece)
        total += weighted[:, chosen] @ stacked[:, chosen].T
    return total


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

"""Responses tabulated once over Poisson's ratio: evaluating the likelihood then costs little.

The response is smooth in Poisson's ratio, so interpolation between Chebyshev nodes suffices.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BarycentricInterpolator

from palpate.estimation.observed_rows import ObservedRows

# Nodes for a range of up to 0.5, more in proportion. With the nearest pole of the response at nu
# about 1, or 0.6 at worst, the relative error is below 1e-4; the final estimate is exact.
_NODES_PER_HALF = 9


@dataclass(frozen=True, slots=True, eq=False)
class ResponseTable:
    """Responses of all probings at the Chebyshev nodes of a range of Poisson's ratio.

    Parameters
    ----------
    poisson_range : (float, float) [-]              ends, lower one first
    poisson_ratio : (m,) float [-]                  nodes, ascending
    response : tuple of (m, c, r) float             one for each probing: `ObservedRows.value`,
                                                    transposed
    """

    poisson_range: tuple[float, float]
    poisson_ratio: Float[np.ndarray, " m"]
    response: tuple[Float[np.ndarray, "m _ _"], ...]

    def at(self, poisson_ratio: float) -> tuple[Float[np.ndarray, "_ _"], ...]:
        """Interpolated responses of all probings.

        Parameters
        ----------
        poisson_ratio : float [-]       within the range

        Returns
        -------
        tuple of (c, r) float           `ObservedRows.value`, transposed
        """
        weight = interpolation_weights(self.poisson_ratio, np.array([poisson_ratio]))[0]
        return tuple(np.einsum("m,mir->ir", weight, response) for response in self.response)


def response_table(
    probes: Sequence[ObservedRows], poisson_range: tuple[float, float]
) -> ResponseTable:
    """Tabulate the responses of all probings over a range of Poisson's ratio.

    Parameters
    ----------
    probes : sequence of ObservedRows
    poisson_range : (float, float) [-]      ends, lower one first

    Returns
    -------
    ResponseTable

    Raises
    ------
    InputError                              a response has the wrong shape or is not finite
    """
    low, high = poisson_range
    count = _NODES_PER_HALF + int(np.ceil(_NODES_PER_HALF * max(0.0, 2 * (high - low) - 1)))
    angle = np.pi * (np.arange(count) + 0.5) / count
    node = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angle)
    response = tuple(
        np.stack([np.ascontiguousarray(probe.value(float(nu)).T) for nu in node])
        for probe in probes
    )
    return ResponseTable(poisson_range, node, response)


def interpolation_weights(
    node: Float[np.ndarray, " m"], target: Float[np.ndarray, " g"]
) -> Float[np.ndarray, "g m"]:
    """Barycentric interpolation from Chebyshev nodes of the first kind to other points.

    Parameters
    ----------
    node : (m,) float               Chebyshev nodes of some interval, ascending
    target : (g,) float             points in that interval

    Returns
    -------
    (g, m) float                    takes values at the nodes to values at the targets

    Source
    ------
    Berrut and Trefethen, Barycentric Lagrange interpolation, SIAM Review 46 (2004), eq. 5.3.
    """
    count = len(node)
    factor = np.sin(np.pi * (np.arange(count) + 0.5) / count) * (-1.0) ** np.arange(count)
    return np.asarray(BarycentricInterpolator(node, np.eye(count), wi=factor)(target))

"""The part of the model's own error whose shape nobody knows, as a correlated term of known
size."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from palpate.estimation.measured_components import MeasuredComponents
from palpate.geometry import morton_order
from palpate.shapes import Points

# The model's error is taken as a process whose correlation decays over this fraction of the body
# on all scales, as far as its modes resolve; this share of its variance varies from point to point.
# Against bodies of known truth, lengths of 0.1 to 1 and shares of 0.1 to 0.6 move no estimate by
# more than a fifth of its standard deviation (benchmarks/exact_bodies.py).
_LENGTH, _WHITE = 0.3, 0.3
_MODES = 40
# Places from which the modes are computed.
_MOST_PLACES = 200
# The error at a point is at most the largest among its neighbours: this share of all points, and at
# least so many.
_NEIGHBOURHOOD, _FEWEST_NEIGHBOURS = 0.02, 12


@dataclass(frozen=True, slots=True, eq=False)
class UnknownRows:
    """The model's error of unknown shape in the rows of one probing: a correlated term in their
    covariance, of the size that the model's errors of known shape have about each point.

    Its part that is correlated is a sum of patterns whose coefficients have unit variance: first
    the errors of known shape themselves, as they differ from probing to probing, then smooth modes,
    each for x, y and z.

    Attributes
    ----------
    probe : MeasuredComponents
    fields : (f, r) float [m]       errors of known shape
    modes : (p, m) float [m]        smooth modes, one value for each point
    variance : (r,) float [m^2]     of what varies from point to point
    size : (p,) float [m]           standard deviation of each component of a point, in all
    """

    probe: MeasuredComponents
    fields: Float[np.ndarray, "f r"]
    modes: Float[np.ndarray, "p m"]
    variance: Float[np.ndarray, " r"]
    size: Float[np.ndarray, " p"]

    @property
    def count(self) -> int:
        """Number of coefficients: of the fields, then of the modes along x, along y, along z."""
        return len(self.fields) + 3 * self.modes.shape[1]

    def total_variance(self) -> Float[np.ndarray, " r"]:
        """Variance of every row, of rows that are not whitened [m^2]."""
        smooth = np.square(self.modes).sum(axis=1)[self.probe.point_of_row]
        return np.square(self.fields).sum(axis=0) + smooth + self.variance

    def moved(self, coefficients: Float[np.ndarray, " n"]) -> Float[np.ndarray, " r"]:
        """Displacement of the rows, (r,) [m]."""
        known, smooth = np.split(coefficients, [len(self.fields)])
        by_point = self.modes @ smooth.reshape(3, -1).T
        rows = by_point[self.probe.point_of_row, self.probe.component_of_row]
        return known @ self.fields + self.probe.whitened(rows)

    def with_columns(
        self, columns: Float[np.ndarray, "s r"], weight: Float[np.ndarray, " r"]
    ) -> Float[np.ndarray, "s n"]:
        """Weighted products of some columns with the patterns, n = `count`."""
        probe, f, m = self.probe, len(self.fields), self.modes.shape[1]
        weighted = columns * weight
        unwhitened = probe.whitened(weighted.T).T
        products = np.empty((len(columns), self.count))
        products[:, :f] = weighted @ self.fields.T
        points, components = probe.point_of_row, probe.component_of_row
        for i in range(3):
            rows = np.flatnonzero(components == i)
            at = slice(f + i * m, f + (i + 1) * m)
            products[:, at] = unwhitened[:, rows] @ self.modes[points[rows]]
        return products

    def products(
        self, columns: Float[np.ndarray, "s r"], weight: Float[np.ndarray, " r"]
    ) -> tuple[Float[np.ndarray, "s n"], Float[np.ndarray, "n n"]]:
        """Weighted products of some columns with the patterns, and of the patterns with each
        other, n = `count`."""
        f, m = len(self.fields), self.modes.shape[1]
        every = self.with_columns(np.vstack([columns, self.fields]), weight)
        cross, known = every[: len(columns)], every[len(columns) :]
        # Of a point's rows with each other, as components were before they were whitened.
        inner = self.probe.component_products(weight)
        whole = np.zeros((self.count, self.count))
        for i in range(3):
            at = slice(f + i * m, f + (i + 1) * m)
            for j in range(i, 3):
                if inner[:, i, j].any():
                    other = slice(f + j * m, f + (j + 1) * m)
                    whole[at, other] = (self.modes * inner[:, i, j, None]).T @ self.modes
                    whole[other, at] = whole[at, other].T
        whole[:f], whole[:, :f] = known, known.T
        return cross, whole


def unknown_rows(
    probe: MeasuredComponents,
    fields: Float[np.ndarray, "r f"],
    patterns_at: Callable[[Points], Float[np.ndarray, "_ m"]],
) -> UnknownRows:
    """The model's error of unknown shape in the rows of a probing.

    Parameters
    ----------
    probe : MeasuredComponents
    fields : (r, f) float [m]       displacement per standard deviation of each error of the model;
                                    none: the model is exact
    patterns_at : function          of `correlated_patterns`

    Returns
    -------
    UnknownRows
    """
    square = np.add.reduceat((probe.unwhitened(fields) ** 2).sum(axis=1), probe.start)
    size = np.sqrt(square / probe.components)
    on_surface = np.isfinite(probe.position[:, 0])
    places, patterns = probe.position[on_surface], np.zeros((len(size), 0))
    if size.any() and len(places) >= _FEWEST_NEIGHBOURS:
        count = max(_FEWEST_NEIGHBOURS, int(_NEIGHBOURHOOD * len(places)))
        size[on_surface] = size[on_surface][cKDTree(places).query(places, count)[1]].max(axis=1)
        smooth = patterns_at(places)
        patterns = np.zeros((len(size), smooth.shape[1]))
        patterns[on_surface] = smooth
    # The tip has no neighbours, and few points show no pattern: all of their error is their own.
    white = size**2 * np.maximum(1.0 - (patterns**2).sum(axis=1), 0.0)
    return UnknownRows(
        probe,
        np.ascontiguousarray(fields.T),
        patterns * size[:, None],
        white[probe.point_of_row] * probe.whitening_power(),
        size,
    )


def correlated_patterns(
    places: Points,
) -> Callable[[Points], Float[np.ndarray, "_ m"]]:
    """Leading modes of a process of correlation exp(-distance / length), of variance 1 less what
    varies from point to point, as functions of place.

    Parameters
    ----------
    places : (n, 3) float [m]       all that are observed

    Returns
    -------
    function                        (k, 3) float [m] -> (k, m) float [-]: the modes there, none
                                    where so few places show no pattern

    Source
    ------
    Nystroem extension from a subset of the points: Williams and Seeger, Using the Nystroem method
    to speed up kernel machines, NIPS 13 (2001).
    """
    if len(places) < _FEWEST_NEIGHBOURS:
        return lambda points: np.zeros((len(points), 0))
    places = np.unique(places, axis=0)
    length = _LENGTH * float(np.linalg.norm(np.ptp(places, axis=0)))
    chosen = places[morton_order(places)][:: -(-len(places) // _MOST_PLACES)]
    value, vector = np.linalg.eigh(np.exp(-cdist(chosen, chosen) / length))
    value, vector = value[::-1][:_MODES], vector[:, ::-1][:, :_MODES]
    combination = np.sqrt(1.0 - _WHITE) * vector / np.sqrt(value)
    return lambda points: np.exp(-cdist(points, chosen) / length) @ combination

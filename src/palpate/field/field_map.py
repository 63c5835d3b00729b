"""What is known of a field of moduli: its map, the parts that are stiffer or softer, and what a map
changes in the displacements of a held body: finite elements with it and without, in its elements.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array, kron
from scipy.sparse.csgraph import connected_components

from palpate.records import HALF_95, ModulusMap, Session, StiffPart
from palpate.shapes import Points
from palpate.solids import (
    GradedStiffness,
    Solid,
    held_nodes,
    make_graded_body,
    quadratic_solid,
    surface_values,
    with_moduli,
)

# The modulus is known where the data leave less than this share of the prior's standard deviation.
_KNOWN = 0.5
# An element belongs to a part that differs by so many standard deviations from the rest.
_SIGNIFICANT = 2.0
# A part that differs by less than this factor, at the near end of its interval, is not mentioned.
_MENTIONED = 1.1
# A part has at least this share of the body's volume: fewer elements are noise of the mesh.
_SMALLEST_PART = 0.002
_MOST_PARTS = 3
# Directions of a field's uncertainty that predictions take along.
_MOST_DIRECTIONS = 24
# Quadratic elements lock above this Poisson's ratio; the change hardly depends on it.
_LARGEST_RATIO = 0.495


@dataclass(frozen=True, slots=True, eq=False)
class FieldPosterior:
    """What data and prior say of a body's modulus, relative to its mean over the volume.

    Attributes
    ----------
    solid : Solid
    volume : (m,) float [m^3]       of every element
    fields : (m, j) float [-]       logarithm of the modulus per unit of each coefficient
    coefficients : (j,) float       standard normal before the data
    covariance : (j, j) float       of the coefficients, after the data
    layers : int                    the last coefficients: of what depends on the depth alone
    depth : (m,) float [m]          of every element below the free surface
    """

    solid: Solid
    volume: Float[np.ndarray, " m"]
    fields: Float[np.ndarray, "m j"]
    coefficients: Float[np.ndarray, " j"]
    covariance: Float[np.ndarray, "j j"]
    layers: int
    depth: Float[np.ndarray, " m"]

    @property
    def log_modulus(self) -> Float[np.ndarray, " m"]:
        """Logarithm of each element's modulus over the mean one."""
        return self.fields @ self.coefficients

    @property
    def std(self) -> Float[np.ndarray, " m"]:
        """Standard deviation of `log_modulus`."""
        return np.sqrt(np.einsum("ej,jk,ek->e", self.fields, self.covariance, self.fields))

    def map(self) -> ModulusMap:
        """The modulus of every element."""
        return map_of(self.solid, self.log_modulus, self.fields, self.covariance, self.is_known)

    @property
    def known_share(self) -> float:
        """Share of the volume in which the modulus is known."""
        return float(self.volume[self.is_known].sum() / self.volume.sum())

    @property
    def is_known(self) -> Bool[np.ndarray, " m"]:
        """Elements about which the data say more than the prior."""
        return self.std < _KNOWN * np.sqrt(np.square(self.fields).sum(axis=1))

    @property
    def centre(self) -> Points:
        """Centre of every element [m]."""
        return self.solid.nodes[self.solid.elements[:, :4]].mean(axis=1)

    def parts(self) -> tuple[StiffPart, ...]:
        """Parts that differ from the rest, those of the largest effect first; before them the
        outermost layer, where what lies at one depth differs from what lies deeper."""
        if self.layers:
            inner = slice(-self.layers)
            others = replace(
                self,
                fields=self.fields[:, inner],
                coefficients=self.coefficients[inner],
                covariance=self.covariance[inner, inner],
                layers=0,
            )
            return (*self._outermost(), *others.parts())
        log_modulus, known = self.log_modulus, self.is_known
        if not known.any():
            return ()
        middle = _weighted_median(log_modulus[known], self.volume[known])
        differs = known & (np.abs(log_modulus - middle) > _SIGNIFICANT * self.std)
        rest = known & ~differs
        parts = []
        for sign in (1.0, -1.0):
            chosen = differs & (sign * (log_modulus - middle) > 0.0)
            for part in self._connected(chosen):
                if self.volume[part].sum() > _SMALLEST_PART * self.volume.sum() and rest.any():
                    parts.append(self._part(part, rest))
        parts = [part for part in parts if _is_mentioned(part)]
        parts.sort(key=lambda part: -abs(np.log(part.ratio)) * part.size**3)
        return tuple(parts[:_MOST_PARTS])

    def _outermost(self) -> Iterator[StiffPart]:
        """The layer below the free surface that explains most of how the modulus varies with the
        depth, where it differs from the rest."""
        order = np.argsort(self.depth, kind="stable")
        values = (self.fields[:, -self.layers :] @ self.coefficients[-self.layers :])[order]
        volume = self.volume[order]
        above = np.cumsum(volume)[:-1]
        below = volume.sum() - above
        outer = np.cumsum(volume * values)[:-1]
        inner = float(volume @ values) - outer
        # Elements of one depth stay together.
        between = above * below * np.square(outer / above - inner / below)
        last = int(np.where(np.diff(self.depth[order]) > 0.0, between, -1.0).argmax())
        limit = 0.5 * float(self.depth[order[last : last + 2]].sum())
        inside = self.depth < limit
        part = self._part(np.flatnonzero(inside), ~inside)
        if _is_mentioned(part):
            yield replace(part, depth=limit)

    def _connected(self, chosen: Bool[np.ndarray, " m"]) -> Iterator[Int[np.ndarray, " p"]]:
        """Groups of chosen elements that share corners."""
        elements = np.flatnonzero(chosen)
        corners = self.solid.elements[elements, :4]
        entries = (np.ones(corners.size), (np.repeat(np.arange(len(elements)), 4), corners.ravel()))
        incidence = coo_array(entries, shape=(len(elements), len(self.solid.nodes))).tocsr()
        count, label = connected_components(incidence @ incidence.T, directed=False)
        for k in range(count):
            yield elements[label == k]

    def _part(self, part: Int[np.ndarray, " p"], rest: Bool[np.ndarray, " m"]) -> StiffPart:
        volume = self.volume[part]
        inside = volume @ self.fields[part] / volume.sum()
        outside = self.volume[rest] @ self.fields[rest] / self.volume[rest].sum()
        difference = inside - outside
        ratio = float(difference @ self.coefficients)
        std = float(np.sqrt(difference @ self.covariance @ difference))
        low, high = ratio - HALF_95 * std, ratio + HALF_95 * std
        weight = volume * np.abs(self.log_modulus[part] - outside @ self.coefficients)
        x, y, z = (float(coordinate) for coordinate in weight @ self.centre[part] / weight.sum())
        size = float(6.0 * volume.sum() / np.pi) ** (1.0 / 3.0)
        ratio, low, high = (float(np.exp(value)) for value in (ratio, low, high))
        return StiffPart((x, y, z), size, ratio, low, high)


def _is_mentioned(part: StiffPart) -> bool:
    return part.low > _MENTIONED or part.high < 1.0 / _MENTIONED


def map_of(
    solid: Solid,
    log_modulus: Float[np.ndarray, " m"],
    fields: Float[np.ndarray, "m j"],
    covariance: Float[np.ndarray, "j j"],
    is_known: Bool[np.ndarray, " m"],
) -> ModulusMap:
    """The modulus of every element of a solid.

    Parameters
    ----------
    solid : Solid
    log_modulus : (m,) float
    fields : (m, j) float           its derivative by some coefficients
    covariance : (j, j) float       of these
    is_known : (m,) bool            where the data tell it
    """
    used, corners = np.unique(solid.elements[:, :4], return_inverse=True)
    std = np.sqrt(np.einsum("ej,jk,ek->e", fields, covariance, fields))
    return ModulusMap(
        solid.nodes[used], corners.reshape(-1, 4), log_modulus, std, is_known,
        leading_directions(fields, covariance),
    )  # fmt: skip


def leading_directions(
    fields: Float[np.ndarray, "m j"], covariance: Float[np.ndarray, "j j"]
) -> Float[np.ndarray, "k m"]:
    """Independent changes of a field, a standard deviation each, the largest first.

    Parameters
    ----------
    fields : (m, j) float           per unit of each coefficient
    covariance : (j, j) float       of the coefficients
    """
    value, vector = np.linalg.eigh(covariance)
    every = fields @ (vector * np.sqrt(np.maximum(value, 0.0)))
    order = np.argsort(-np.square(every).sum(axis=0), kind="stable")
    return every[:, order[:_MOST_DIRECTIONS]].T


def _weighted_median(values: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"]) -> float:
    order = np.argsort(values)
    share = np.cumsum(weight[order]) / weight.sum()
    return float(values[order][np.searchsorted(share, 0.5)])


@dataclass(frozen=True, slots=True, eq=False)
class MapResponse:
    """A body with a map of moduli and the same body without.

    Attributes
    ----------
    uneven, even : GradedStiffness
    directions : (m q, k) float     independent changes of the map, a standard deviation each
    """

    uneven: GradedStiffness
    even: GradedStiffness
    directions: Float[np.ndarray, "mq k"]

    @property
    def solid(self) -> Solid:
        """The elements of the map, quadratic."""
        return self.uneven.body.solid

    def change(self, load: Float[np.ndarray, "n3 p"]) -> Float[np.ndarray, "n3 p"]:
        """What the map changes in the displacement of all nodes, times the mean modulus.

        Parameters
        ----------
        load : (3 n, p) float [N]

        Returns
        -------
        (3 n, p) float [m Pa]
        """
        return self.uneven.displacements(load) - self.even.displacements(load)

    def at(self, points: Points) -> csr_array:
        """Displacements at points of the surface from those of all nodes, (3 p, 3 n)."""
        return csr_array(kron(surface_values(self.solid, points), np.eye(3)))


def make_map_response(session: Session, modulus: ModulusMap, poisson_ratio: float) -> MapResponse:
    """Finite elements of a body with a map of moduli.

    Parameters
    ----------
    session : Session               whose object the map is of
    modulus : ModulusMap
    poisson_ratio : float [-]

    Returns
    -------
    MapResponse

    Raises
    ------
    MeshError                       a map of another object
    SingularSystemError             the support does not hold the object
    """
    solid = quadratic_solid(modulus.nodes, modulus.tetrahedra, mesh=session.mesh)
    body = make_graded_body(solid, held_nodes(solid, session.held_triangles))
    ratio = min(poisson_ratio, _LARGEST_RATIO)
    uneven, even = (
        with_moduli(body, body.constant @ field, ratio)
        for field in (modulus.log_modulus, 0.0 * modulus.log_modulus)
    )
    return MapResponse(uneven, even, body.constant @ modulus.directions.T)

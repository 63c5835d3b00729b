"""A shear modulus that differs from place to place, as estimated."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from palpate.arrays import fix_fields
from palpate.errors import InputError
from palpate.geometry import TriangleMesh, is_outer, place_text
from palpate.shapes import Indices, Points

# Elements that may hold a point: the nearest ones; and how far outside one still counts, over its
# size.
_NEAREST, _OUTSIDE = 24, -0.02
# Logarithm of a modulus over the mean one that no body has.
_LARGEST = 50.0
# Corners of a tetrahedron's faces; and of triangles that part its first corners, so many of them,
# from the others: where edges between the two are cut.
_FACES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
_CROSSED = (
    (1, np.array([[[0, 1], [0, 2], [0, 3]]])),
    (2, np.array([[[0, 2], [0, 3], [1, 3]], [[0, 2], [1, 3], [1, 2]]])),
    (3, np.array([[[0, 3], [1, 3], [2, 3]]])),
)


@dataclass(frozen=True, slots=True)
class StiffPart:
    """A part of the body whose shear modulus differs from that of the rest.

    Parameters
    ----------
    centre : (float, float, float) [m]
    size : float [m]                diameter of a ball of its volume, > 0
    ratio : float [-]               its modulus over that of the rest, means of logarithms, > 0
    low, high : float [-]           95 % interval of the ratio, of a smooth field where not round
    depth : float [m]               of the outermost layer of the body, which it is; 0: it is none
    place_std : float [m] or None   standard deviation of the centre of a part that is round, whose
                                    size is that at the ratio; None: it is not

    Raises
    ------
    InputError                      not positive, or a ratio out of its interval
    """

    centre: tuple[float, float, float]
    size: float
    ratio: float
    low: float
    high: float
    depth: float = 0.0
    place_std: float | None = None

    def __post_init__(self) -> None:
        if not (
            0.0 < self.size < math.inf
            and 0.0 <= self.depth < math.inf
            and 0.0 < self.low <= self.ratio <= self.high
            and all(map(math.isfinite, self.centre))
        ):
            raise InputError(
                f"a part has size {self.size:g} m, depth {self.depth:g} m, centre {self.centre} m"
                f" and ratio {self.ratio:g} in {self.low:g} to {self.high:g}; they must be finite,"
                " all but the centre positive, the ratio within its interval"
            )

    @property
    def sentence(self) -> str:
        """For a reader, without full stop: a smooth field rounds edges, so a small part differs by
        more than its interval says."""
        least, word = (self.low, "stiff") if self.ratio >= 1.0 else (1.0 / self.high, "soft")
        centre = place_text(self.centre, decimals=0)
        if self.place_std is not None:
            ratio, most = self.ratio, self.high
            if self.ratio < 1.0:
                ratio, most = 1.0 / self.ratio, 1.0 / self.low
            ratio, most = (float(f"{value:.2g}") for value in (ratio, most))
            return (
                f"a round part near {centre} (+- {1e3 * self.place_std:.1f}) is {least:.2g} to"
                f" {most:g} times as {word} as the rest; at {ratio:g} times it is about"
                f" {1e3 * self.size:.0f} mm across, and larger if it differs less"
            )
        what = f"a part about {1e3 * self.size:.0f} mm across near {centre}"
        if self.depth:
            what = f"the outermost {1e3 * self.depth:.2g} mm or so"
        return f"{what} is at least {least:.2g} times as {word} as the rest"


@dataclass(frozen=True, slots=True)
class FieldEstimate:
    """What the data say about a modulus that differs from place to place.

    Parameters
    ----------
    std : float [-]                 standard deviation of log G before the data, of most evidence
    length : float [m]              over which it varies
    log_evidence : float            how much likelier the data are than with one modulus (log)
    known : float [-]               share of the volume in which the data tell the modulus, 0 to 1
    parts : tuple of StiffPart      that differ from the rest, the largest effect first

    Raises
    ------
    InputError                      a number out of range
    """

    std: float
    length: float
    log_evidence: float
    known: float
    parts: tuple[StiffPart, ...] = ()

    def __post_init__(self) -> None:
        if not (self.std > 0.0 and self.length > 0.0 and 0.0 <= self.known <= 1.0):
            raise InputError(
                f"a field of moduli has std {self.std:g}, length {self.length:g} m and is known in"
                f" {self.known:g} of the body; the first two must be positive, the last 0 to 1"
            )

    @property
    def is_of_parts(self) -> bool:
        """Whether round parts differ from a rest of one modulus, which the constants are of."""
        return any(part.place_std is not None for part in self.parts)

    @property
    def sentences(self) -> tuple[str, ...]:
        """For a reader, without full stops."""
        what, reference = "a field of moduli", "means over the body"
        if self.is_of_parts:
            what, reference = "round parts of another modulus", "those of the rest"
        verdict = (
            "the modulus is not the same everywhere: the data are exp"
            f"({self.log_evidence:.0f}) times as likely with {what} as with one, and the"
            f" constants are {reference}"
        )
        return (verdict, *(part.sentence for part in self.parts))


@dataclass(frozen=True, slots=True, eq=False)
class ModulusMap:
    """Shear modulus of every element of a body.

    Parameters
    ----------
    nodes : (n, 3) float [m]
    tetrahedra : (m, 4) int
    log_modulus : (m,) float        logarithm of the modulus over the mean one, or that of the rest
    std : (m,) float                standard deviation of it
    is_known : (m,) bool            where the data tell it
    directions : (k, m) float       independent changes of `log_modulus`, a standard deviation each:
                                    those that matter most

    Raises
    ------
    InputError                      arrays that do not belong together
    """

    nodes: Points
    tetrahedra: Int[np.ndarray, "m 4"]
    log_modulus: Float[np.ndarray, " m"]
    std: Float[np.ndarray, " m"]
    is_known: Bool[np.ndarray, " m"]
    directions: Float[np.ndarray, "k m"]

    def __post_init__(self) -> None:
        count = len(self.tetrahedra)
        fix_fields(self, directions=(None, count))
        fix_fields(self, nodes=(None, 3), log_modulus=(count,), std=(count,))
        fix_fields(self, integer=True, tetrahedra=(None, 4))
        if (largest := float(np.abs(self.log_modulus).max(initial=0.0))) > _LARGEST:
            raise InputError(f"log_modulus reaches {largest:g}; must be {_LARGEST:g} at most")
        if (least := float(self.std.min(initial=0.0))) < 0.0:
            raise InputError(f"std is {least:g} in an element; must not be negative")
        if self.tetrahedra.min(initial=0) < 0 or self.tetrahedra.max(initial=0) >= len(self.nodes):
            raise InputError(f"tetrahedra name nodes outside 0 to {len(self.nodes) - 1}")
        if self.is_known.shape != (count,):
            raise InputError(f"is_known has shape {self.is_known.shape}; must be ({count},)")

    def element_at(self, points: Points) -> Int[np.ndarray, " n"]:
        """Element that holds each point; -1 outside the body.

        Parameters
        ----------
        points : (n, 3) float [m]
        """
        corner = self.nodes[self.tetrahedra]
        inverse = np.linalg.inv(np.swapaxes(corner[:, 1:] - corner[:, :1], 1, 2))
        nearest = cKDTree(corner.mean(axis=1)).query(points, min(_NEAREST, len(corner)))[1]
        near = nearest.reshape(len(points), -1)
        share = np.einsum("nkab,nkb->nka", inverse[near], points[:, None] - corner[near, 0])
        least = np.minimum(share.min(axis=2), 1.0 - share.sum(axis=2))
        best = least.argmax(axis=1)
        rows = np.arange(len(points))
        return np.where(least[rows, best] > _OUTSIDE, near[rows, best], -1)

    def boundary(self, selected: Bool[np.ndarray, " m"]) -> tuple[TriangleMesh, Indices]:
        """Surface of some of the elements.

        Parameters
        ----------
        selected : (m,) bool

        Returns
        -------
        TriangleMesh                of all nodes
        (f,) int                    element of every triangle
        """
        chosen = np.flatnonzero(selected)
        faces = self.tetrahedra[chosen][:, _FACES].reshape(-1, 3)
        outer = np.flatnonzero(is_outer(faces))
        element = chosen[outer // len(_FACES)]
        inside = self.nodes[self.tetrahedra[element]].mean(axis=1)
        return _facing_away(self.nodes, faces[outer], inside), element

    @property
    def rest(self) -> float:
        """Median of the known modulus, relative as in the map."""
        known = np.flatnonzero(self.is_known)
        order = known[np.argsort(self.log_modulus[known])]
        share = np.cumsum(self._volume[order])
        return float(np.exp(self.log_modulus[order][np.searchsorted(share, 0.5 * share[-1])]))

    def isosurface(self, ratio: float) -> TriangleMesh | None:
        """Surface on which the modulus has a given value, where the data determine it.

        Parameters
        ----------
        ratio : float                   the value, relative as in the map

        Returns
        -------
        TriangleMesh or None            facing lower values; None: the modulus passes it nowhere
        """
        corner, volume, count = self.tetrahedra.ravel(), np.repeat(self._volume, 4), len(self.nodes)
        about = np.bincount(corner, volume, count)
        total = np.bincount(corner, volume * np.repeat(self.log_modulus, 4), count)
        at_node = total / np.where(about > 0.0, about, 1.0)
        # Means over the elements about a node flatten a small part: at a level that keeps its
        # volume.
        inside = 4.0 * float(self._volume[self.log_modulus > np.log(ratio)].sum())
        order = np.argsort(-at_node)
        return self._surface(at_node - np.interp(inside, np.cumsum(about[order]), at_node[order]))

    @property
    def _volume(self) -> Float[np.ndarray, " m"]:
        """Six times the volume of every element [m^3]."""
        corner = self.nodes[self.tetrahedra]
        return np.abs(np.linalg.det(corner[:, 1:] - corner[:, :1]))

    def _surface(self, height: Float[np.ndarray, " n"]) -> TriangleMesh | None:
        """Where a function of the nodes, linear within elements, crosses zero."""
        corners = self.tetrahedra[self.is_known]
        corners = np.take_along_axis(
            corners, np.argsort(height[corners] <= 0.0, axis=1, kind="stable"), axis=1
        )
        count = (height[corners] > 0.0).sum(axis=1)
        edges = np.concatenate(
            [corners[count == above][:, columns].reshape(-1, 3, 2) for above, columns in _CROSSED]
        )
        if not len(edges):
            return None
        ends, vertex = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
        high, low = height[ends].T
        share = (high / (high - low))[:, None]
        vertices = (1.0 - share) * self.nodes[ends[:, 0]] + share * self.nodes[ends[:, 1]]
        return _facing_away(vertices, vertex.reshape(-1, 3), self.nodes[edges[:, 0, 0]])


def _facing_away(
    vertices: Points, triangles: Int[np.ndarray, "f 3"], inside: Float[np.ndarray, "f 3"]
) -> TriangleMesh:
    """A surface whose triangles face away from a point for each."""
    corner = vertices[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    inward = np.einsum("fi,fi->f", normal, corner[:, 0] - inside) < 0.0
    return TriangleMesh(vertices, np.where(inward[:, None], triangles[:, ::-1], triangles))

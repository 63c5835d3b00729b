"""Twelve bodies of unlike shape, 50 to 120 mm large, each as a surface of about 600 vertices.

All stand on z = 0. The contacts are places where a tool of 5 mm can press.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool
from scipy.interpolate import PchipInterpolator

from palpate.geometry import TriangleMesh
from palpate.lab.specimens import revolved, straight_rings

_MM = 1e-3


@dataclass(frozen=True, slots=True)
class Shape:
    """A body.

    Attributes
    ----------
    make : function                 length of a triangle's sides [m] -> TriangleMesh
    edge : float [m]                for about 600 vertices
    towards : (k, 3) float          directions whose farthest points are pressed
    held : float [m]                triangles whose vertices are all below this height are held
    poisson_ratio : float [-]       of its material
    """

    make: Callable[[float], TriangleMesh]
    edge: float
    towards: tuple[tuple[float, float, float], ...] = (
        (0.05, 0.08, 1.0),
        (1.0, 0.25, 0.35),
        (-0.45, 1.0, 0.4),
    )
    held: float = 1e-6
    poisson_ratio: float = 0.3


def cells(occupied: Bool[np.ndarray, "i j k"], lines: Sequence[np.ndarray]) -> TriangleMesh:
    """Surface of some cells of a rectangular grid, two triangles a face.

    Parameters
    ----------
    occupied : (i, j, k) bool       which cells are body
    lines : three float arrays [m]  planes of the grid along x, y and z, one more than cells
    """
    padded = np.pad(occupied, 1)
    number: dict[tuple[int, ...], int] = {}
    triangles = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, 1):
            beside = np.roll(padded, 1 - 2 * side, axis=axis)
            for cell in np.argwhere(padded & ~beside) - 1:
                corner = []
                for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)):
                    node = cell.copy()
                    node[axis] += side
                    node[u] += p
                    node[v] += q
                    corner.append(number.setdefault(tuple(node.tolist()), len(number)))
                a, b, c, d = corner
                even = int(cell[u] + cell[v]) % 2 == 0
                cut = [[a, b, c], [a, c, d]] if even else [[a, b, d], [b, c, d]]
                triangles += cut if side else [triangle[::-1] for triangle in cut]
    index = np.array(list(number))
    vertices = np.stack([np.asarray(lines[a])[index[:, a]] for a in range(3)], axis=1)
    return TriangleMesh(vertices, np.array(triangles))


def _lines(edge: float, *stops: float) -> np.ndarray:
    """Planes through all of some places [mm], evenly spaced between them."""
    parts = [np.array([stops[0] * _MM])]
    for start, end in pairwise(stops):
        count = max(round((end - start) * _MM / edge), 1)
        parts.append(np.linspace(start * _MM, end * _MM, count + 1)[1:])
    return np.concatenate(parts)


def box_mesh(x: float, y: float, z: float) -> Callable[[float], TriangleMesh]:
    """A box of given sides [mm] that stands on z = 0, centred on the z axis."""

    def make(edge: float) -> TriangleMesh:
        lines = [_lines(edge, -x / 2, x / 2), _lines(edge, -y / 2, y / 2), _lines(edge, 0, z)]
        return cells(np.ones([len(line) - 1 for line in lines], dtype=bool), lines)

    return make


def _bracket(edge: float) -> TriangleMesh:
    """An L: a foot of 60 x 36 x 18 mm with a wall of 18 mm that rises to 60."""
    lines = [_lines(edge, -30, -12, 30), _lines(edge, -18, 18), _lines(edge, 0, 18, 60)]
    middle = [0.5 * (line[1:] + line[:-1]) for line in lines]
    x, _, z = np.meshgrid(*middle, indexing="ij")
    return cells((z < 18 * _MM) | (x < -12 * _MM), lines)


def _arch(edge: float) -> TriangleMesh:
    """Half a ring of 24 mm by 24 mm, on both its feet, its middle line of radius 36 mm."""
    lines = [_lines(edge, 0, np.pi * 36), _lines(edge, -12, 12), _lines(edge, -12, 12)]
    straight = cells(np.ones([len(line) - 1 for line in lines], dtype=bool), lines)
    along, across, out = straight.vertices.T
    angle, radius = along / (36 * _MM), 36 * _MM - out
    coordinates = [-radius * np.cos(angle), across, radius * np.sin(angle)]
    bent = np.stack(coordinates, axis=1)
    bent[np.abs(bent[:, 2]) < 1e-9, 2] = 0.0
    return TriangleMesh(bent, straight.triangles[:, ::-1])


def _profile(*points: tuple[float, float]) -> Callable[[float], TriangleMesh]:
    """Body of revolution with straight flanks between radii and heights [mm]."""

    def make(edge: float) -> TriangleMesh:
        rings = [np.zeros((1, 2))]
        for start, end in pairwise(points):
            piece = straight_rings(
                (start[0] * _MM, start[1] * _MM), (end[0] * _MM, end[1] * _MM), edge
            )
            rings.append(piece[1:])
        return revolved(np.concatenate(rings), edge)

    return make


def _curve(
    contour: Callable[[np.ndarray], np.ndarray], length: float
) -> Callable[[float], TriangleMesh]:
    """Body of revolution over a disc, its flank a curve (radius, height) over 0 to 1, up to the
    axis."""

    def make(edge: float) -> TriangleMesh:
        flank = contour(np.linspace(0, 1, max(round(length / (0.9 * edge)), 8) + 1))
        flank[-1, 0] = 0.0 if abs(flank[-1, 0]) < 1e-9 else flank[-1, 0]
        base = straight_rings((0.0, 0.0), (float(flank[0, 0]), 0.0), edge)
        rings = [base, flank[1:]]
        if flank[-1, 0] > 0.0:
            count = len(straight_rings((0.0, 0.0), (float(flank[-1, 0]), 0.0), edge))
            top = np.linspace(flank[-1], [0.0, flank[-1, 1]], count)
            rings.append(top[1:])
        return revolved(np.concatenate(rings), edge)

    return make


def _egg(s: np.ndarray) -> np.ndarray:
    """An egg of 64 mm, its lower end cut off."""
    angle = np.linspace(-0.75, 0.5 * np.pi, len(s))
    z = 32 * np.sin(angle)
    z -= z[0]
    radius = 24 * np.cos(angle) * (1 - 0.18 * np.sin(angle))
    return np.stack([radius, z], axis=1) * _MM


def _hourglass(s: np.ndarray) -> np.ndarray:
    radius = 17 + 8 * np.cos(2 * np.pi * s)
    return np.stack([radius, 60 * s], axis=1) * _MM


def _mushroom(s: np.ndarray) -> np.ndarray:
    """A stem of 14 mm under a cap of 30 mm, rounded where they meet."""
    stops = np.array([[14, 0], [14, 9], [14, 18], [17, 23.5], [23, 25.5], [28, 27], [30, 31],
                      [29, 37], [24, 44.5], [15, 50.5], [0, 53]], dtype=float)  # fmt: skip
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(stops, axis=0), axis=1))])
    return PchipInterpolator(arc / arc[-1], stops)(s) * _MM


# Angle of the ring's section at which its flat foot cuts it, from the lowest line.
_FOOT = 0.9


def _torus(edge: float) -> TriangleMesh:
    """A ring of radius 30 mm and 13 mm thick radius, cut flat below, lying."""
    around = max(round(2 * np.pi * 30 * _MM / edge), 12)
    half = 13 * np.sin(_FOOT)
    below = max(round(2 * half * _MM / edge), 3)
    above = round(2 * (np.pi - _FOOT) * 13 * _MM / edge)
    angles = np.linspace(_FOOT, 2 * np.pi - _FOOT, above, endpoint=False) - 0.5 * np.pi
    out = np.concatenate([np.linspace(-half, half, below, endpoint=False), 13 * np.cos(angles)])
    up = np.concatenate([np.zeros(below), 13 * (np.cos(_FOOT) + np.sin(angles))])
    across = len(out)
    i, j = (g.ravel() for g in np.meshgrid(np.arange(around), np.arange(across), indexing="ij"))
    phi, radius = 2 * np.pi * i / around, 30 + out[j]
    coordinates = [radius * np.cos(phi), radius * np.sin(phi), np.where(j < below, 0.0, up[j])]
    ahead, over = (i + 1) % around * across + j, i * across + (j + 1) % across
    both = (i + 1) % around * across + (j + 1) % across
    here = i * across + j
    even = ((i + j) % 2 == 0)[:, None]
    first = np.where(even, np.stack([here, ahead, both], 1), np.stack([here, ahead, over], 1))
    second = np.where(even, np.stack([here, both, over], 1), np.stack([ahead, both, over], 1))
    return TriangleMesh(np.stack(coordinates, axis=1) * _MM, np.concatenate([first, second]))


BODIES = {
    "slab": Shape(
        box_mesh(80, 60, 16), 4.6e-3, ((0, 0, 1), (0.4, 0.3, 1), (-0.3, 0.3, 1)), poisson_ratio=0.45
    ),
    "block": Shape(box_mesh(60, 45, 45), 5.2e-3),
    "egg": Shape(_curve(_egg, 80e-3), 4.1e-3, poisson_ratio=0.4),
    "arch": Shape(
        _arch, 5.2e-3, ((0, 0, 1), (0.7, 0.2, 0.8), (-0.6, 0.3, 0.9)), poisson_ratio=0.1
    ),
    "mushroom": Shape(
        _curve(_mushroom, 84e-3), 4.1e-3, ((0.02, 0.05, 1), (1, 0.2, 0.6), (-0.5, 1, 0.5)),
        poisson_ratio=0.2,
    ),
    "bracket": Shape(_bracket, 4.6e-3, ((-0.3, 0.1, 1), (0.2, 0.1, 1), (-1, 0.3, 0.4))),
    "hourglass": Shape(_curve(_hourglass, 66e-3), 4.2e-3, poisson_ratio=0.35),
    "cone": Shape(_profile((0, 0), (32, 0), (10, 55), (0, 55)), 4.2e-3, poisson_ratio=0.0),
    "beam": Shape(
        box_mesh(20, 20, 110), 4.4e-3, ((0.1, 0.1, 1), (1, 0.1, 0.4), (0.1, 1, 0.2)),
        poisson_ratio=0.25,
    ),
    "plate": Shape(box_mesh(80, 5, 50), 4.3e-3, ((0.1, -1, 0.3), (0.4, -1, 0.5), (-0.35, -1, 0.4))),
    "cylinder": Shape(_profile((0, 0), (20, 0), (20, 60), (0, 60)), 4.6e-3, poisson_ratio=0.45),
    "torus": Shape(
        _torus, 5.0e-3, ((0.7, 0.2, 1), (-0.6, 0.5, 1), (0.1, -1, 0.8)), poisson_ratio=0.15
    ),
}  # fmt: skip

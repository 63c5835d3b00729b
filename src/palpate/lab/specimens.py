"""The facility's own specimens: closed surfaces with their supported base in the plane z = 0."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from palpate.errors import InputError
from palpate.geometry import TriangleMesh

# Least number of vertices on a ring.
_MIN_RING = 6
# Radius of the rod over its edge length: 2 pi times as many sides around it.
_ROD_SIDES = 8.0
# Bumps of the toy: direction from its middle, height over the radius, width [degrees].
_BUMPS = (
    ((0.55, 0.0, 0.80), 0.60, 15.0),  # ears
    ((-0.55, 0.0, 0.80), 0.60, 15.0),
    ((0.0, -0.95, 0.15), 0.35, 20.0),  # snout
    ((0.0, 0.9, 0.45), -0.35, 32.0),  # dent in the back
)


@dataclass(frozen=True, slots=True)
class Shape:
    """A kind of specimen.

    Attributes
    ----------
    make : function                 lengths and `edge` [m], all by keyword -> TriangleMesh
    lengths : tuple of str          names of these lengths
    summary : str                   one line for a list of shapes
    """

    make: Callable[..., TriangleMesh]
    lengths: tuple[str, ...]
    summary: str


def half_ball(*, radius: float, edge: float) -> TriangleMesh:
    """Half ball on its flat face, centre at the origin.

    Parameters
    ----------
    radius, edge : float [m]        `edge`: approximate length of a triangle's sides

    Returns
    -------
    TriangleMesh                    closed, outward; vertices on the sphere

    Raises
    ------
    InputError                      lengths that are not positive; an edge too long for the shape
    """
    _check(edge, radius=radius)
    base = straight_rings((0.0, 0.0), (radius, 0.0), edge)
    return revolved(np.concatenate([base, _arc(radius, 0.0, 0.5 * np.pi, edge)[1:]]), edge)


def glued_ball(*, radius: float, patch_radius: float, edge: float) -> TriangleMesh:
    """Ball glued to the plane z = 0 on a flat circular patch.

    Parameters
    ----------
    radius : float [m]
    patch_radius : float [m]        less than the radius
    edge : float [m]

    Returns
    -------
    TriangleMesh

    Raises
    ------
    InputError                      lengths that are not positive; a patch wider than the ball
    """
    _check(edge, radius=radius, patch_radius=patch_radius)
    if patch_radius >= radius:
        raise InputError(
            f"patch_radius is {patch_radius:g} m; must be less than the ball's radius of"
            f" {radius:g} m"
        )
    below = np.arccos(patch_radius / radius)
    arc = _arc(radius, -below, 0.5 * np.pi, edge)
    arc[:, 1] += radius * np.sin(below)
    base = straight_rings((0.0, 0.0), (patch_radius, 0.0), edge)
    return revolved(np.concatenate([base, arc[1:]]), edge)


def cylinder(*, radius: float, height: float, edge: float) -> TriangleMesh:
    """Upright cylinder.

    Parameters
    ----------
    radius, height, edge : float [m]

    Returns
    -------
    TriangleMesh

    Raises
    ------
    InputError                      lengths that are not positive; an edge too long for the shape
    """
    _check(edge, radius=radius, height=height)
    contour = [
        straight_rings((0.0, 0.0), (radius, 0.0), edge),
        straight_rings((radius, 0.0), (radius, height), edge)[1:],
        straight_rings((radius, height), (0.0, height), edge)[1:],
    ]
    return revolved(np.concatenate(contour), edge)


def block(*, length: float, width: float, height: float, edge: float) -> TriangleMesh:
    """Block with sides along x, y and z; the middle of its base is the origin.

    Parameters
    ----------
    length, width, height, edge : float [m]

    Returns
    -------
    TriangleMesh

    Raises
    ------
    InputError                      lengths that are not positive; an edge too long for the shape
    """
    size = np.array([length, width, height])
    _check(edge, length=length, width=width, height=height)
    cells = np.maximum(np.rint(size / edge), 1).astype(np.int64)
    number: dict[tuple[int, ...], int] = {}
    triangles = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, 1):
            for i, j in np.ndindex(cells[u], cells[v]):
                corner = []
                for p, q in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)):
                    index = [0, 0, 0]
                    index[axis], index[u], index[v] = int(side * cells[axis]), int(p), int(q)
                    corner.append(number.setdefault(tuple(index), len(number)))
                a, b, c, d = corner
                cut = [[a, b, c], [a, c, d]] if (i + j) % 2 == 0 else [[a, b, d], [b, c, d]]
                triangles += cut if side else [triangle[::-1] for triangle in cut]
    vertices = np.array(list(number), dtype=float) * (size / cells) - [length / 2, width / 2, 0.0]
    return TriangleMesh(vertices, np.array(triangles))


def toy(*, radius: float, edge: float) -> TriangleMesh:
    """A head with two ears, a snout and a dent: irregular and not convex.

    Parameters
    ----------
    radius : float [m]              of the ball that the bumps are added to
    edge : float [m]

    Returns
    -------
    TriangleMesh

    Raises
    ------
    InputError                      lengths that are not positive; an edge too long for the shape
    """
    ball = glued_ball(radius=radius, patch_radius=0.6 * radius, edge=edge)
    middle = np.array([0.0, 0.0, 0.8 * radius])
    away = ball.vertices - middle
    direction = away / np.linalg.norm(away, axis=1)[:, None]
    growth = np.zeros(len(away))
    for toward, height, width in _BUMPS:
        axis = np.array(toward) / np.linalg.norm(toward)
        angle = np.degrees(np.arccos(np.clip(direction @ axis, -1.0, 1.0)))
        growth += height * np.exp(-0.5 * (angle / width) ** 2)
    # The bumps fade out towards the base, which stays flat.
    fade = np.clip(ball.vertices[:, 2] / (0.5 * radius), 0.0, 1.0)
    scale = 1.0 + fade**2 * (3.0 - 2.0 * fade) * growth
    return replace(ball, vertices=middle + away * scale[:, None])


def rod(end: Float[np.ndarray, "k 2"], *, radius: float, length: float) -> TriangleMesh:
    """The arm's rod with its tip down; not a specimen, but visible in the pictures.

    Parameters
    ----------
    end : (k, 2) float [m]          radius and height of the contour of its end, from the axis to
                                    the shaft
    radius : float [m]              of the tip, > 0
    length : float [m]              height of its upper end, > 0

    Returns
    -------
    TriangleMesh                    along z, tip at the lower end

    Raises
    ------
    InputError                      lengths that are not positive
    """
    _check(radius, radius=radius, length=length)
    top = [[end[-1, 0], length], [0.0, length]]
    return revolved(np.concatenate([end, top]), radius / _ROD_SIDES)


SHAPES = {
    "half-ball": Shape(half_ball, ("radius",), "half ball on its flat face, as in the paper"),
    "glued-ball": Shape(
        glued_ball, ("radius", "patch_radius"), "ball glued on a flat patch of its surface"
    ),
    "block": Shape(block, ("length", "width", "height"), "block along x, y and z"),
    "cylinder": Shape(cylinder, ("radius", "height"), "upright cylinder"),
    "toy": Shape(toy, ("radius",), "head with ears, a snout and a dent: irregular, not convex"),
}


def _check(edge: float, **lengths: float) -> None:
    for name, value in {**lengths, "edge": edge}.items():
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{name} is {value:g} m; must be positive")
    shortest = min(lengths, key=lambda name: lengths[name])
    if edge > lengths[shortest]:
        raise InputError(
            f"edge is {edge:g} m, longer than the {shortest} of {lengths[shortest]:g} m; take a"
            " fifth of it or less"
        )


def straight_rings(
    start: tuple[float, float], end: tuple[float, float], edge: float
) -> Float[np.ndarray, "k 2"]:
    """Evenly spaced rings along a straight line.

    Parameters
    ----------
    start, end : (radius, height) [m]
    edge : float [m]                approximate spacing

    Returns
    -------
    (k, 2) float [m]                radius and height of each ring, both ends included
    """
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    return np.linspace(start, end, max(int(np.rint(length / edge)), 1) + 1)


def _arc(radius: float, start: float, end: float, edge: float) -> Float[np.ndarray, "k 2"]:
    """Rings along an arc about the origin, between two angles above the horizontal [rad]."""
    count = max(int(np.rint(radius * (end - start) / (0.87 * edge))), 2) + 1
    angle = np.linspace(start, end, count)
    contour = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if np.isclose(end, 0.5 * np.pi):
        contour[-1, 0] = 0.0
    return contour


def revolved(contour: Float[np.ndarray, "k 2"], edge: float) -> TriangleMesh:
    """Surface of revolution about z; the contour leads from the axis out, up and back to it.

    Parameters
    ----------
    contour : (k, 2) float [m]      radius and height of each ring; the first and last are on the
                                    axis
    edge : float [m]                spacing of the vertices on a ring

    Returns
    -------
    TriangleMesh                    closed, outward
    """
    rings, vertices, count = [], [], 0
    for k, (radius, height) in enumerate(contour):
        size = 1 if radius == 0.0 else max(_MIN_RING, int(np.rint(2.0 * np.pi * radius / edge)))
        # Alternate rings are rotated by half a step: the triangles become nearly equilateral.
        angle = 2.0 * np.pi * (np.arange(size) + 0.5 * (k % 2)) / size
        ring = [radius * np.cos(angle), radius * np.sin(angle), np.full(size, height)]
        vertices.append(np.stack(ring, axis=1))
        rings.append(count + np.arange(size))
        count += size
    strips = [_strip(lower, upper, k % 2) for k, (lower, upper) in enumerate(pairwise(rings))]
    return TriangleMesh(np.concatenate(vertices), np.concatenate(strips))


def _strip(
    lower: Int[np.ndarray, " n"], upper: Int[np.ndarray, " m"], odd: int
) -> Int[np.ndarray, "t 3"]:
    """Triangles between two rings; of the two diagonals always the one shorter in angle."""
    n, m = len(lower), len(upper)
    # Angles of the next vertices of both rings; in ties the lower ring comes first.
    ahead_lower = (np.arange(n) + 1 + 0.5 * odd) / n
    ahead_upper = (np.arange(m) + 1 + 0.5 * (1 - odd)) / m
    order = np.argsort(np.concatenate([ahead_lower, ahead_upper]), kind="stable")
    on_lower = order < n
    i: Int[np.ndarray, " t"] = np.cumsum(on_lower) - on_lower
    j = np.arange(n + m) - i
    ahead = np.where(on_lower, lower[(i + 1) % n], upper[(j + 1) % m])
    strip = np.stack([lower[i % n], ahead, upper[j % m]], axis=1)
    # A ring of one vertex, on the axis, has no edges.
    return strip[(ahead != strip[:, 0]) & (ahead != strip[:, 2])]

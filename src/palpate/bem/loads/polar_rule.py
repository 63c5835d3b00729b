"""Quadrature in polar coordinates about a corner of a cell, over what a round patch covers of it.

Cells of a mesh are often wider than a contact. A rule for whole cells then straddles the rim of the
patch; this one ends there.
"""

import numpy as np
from jaxtyping import Float

from palpate.bem.loads.half_space import PressureDisc, chord_points

# Smallest part of an interval that is integrated by itself.
_LEAST_PART = 1e-2
# Fraction of a ray below which its part within a patch is taken as empty: where a rim touches the
# origin, points of such a part would coincide with it by rounding.
_SHORTEST = 1e-10


def polar_points(
    place: Float[np.ndarray, "c 3 3"],
    corners: Float[np.ndarray, "c 3 3"],
    disc: PressureDisc | None,
    count: int,
) -> tuple[Float[np.ndarray, "c q 3"], Float[np.ndarray, "c q"]]:
    """Quadrature of cells of triangles in polar coordinates about their first corners.

    Of a round patch only that part is covered which lies in the cell. Points are denser at the ends
    of its radii and angles, where the pressure may vary as a square root or its inverse, and where
    they pass its centre.

    Parameters
    ----------
    place : (c, 3, 3) float [m]     corners of the cells, as if they were flat
    corners : (c, 3, 3) float [-]   their barycentric coordinates in the triangle
    disc : PressureDisc or None     the round patch, where there is one
    count : int                     points on either half of a radius, and of the range of angles

    Returns
    -------
    barycentric : (c, q, 3) float [-]    q = 4 count^2
    weight : (c, q) float [-]       sum to half the cell's share of its triangle
    """
    near, side = place[:, 1] - place[:, 0], place[:, 2] - place[:, 1]
    angles = _whole(np.ones(len(place)))
    if disc is not None:
        centre = disc.centre - place[:, 0]
        angles = _seen_interval(near, side, centre, disc.radius)
    t, weight_t = chord_points(*angles, count)
    radii = _whole(np.ones(t.shape))
    if disc is not None:
        ray = near[:, None] + t[..., None] * side[:, None]
        radii = _crossed_interval(ray, centre[:, None], disc.radius)
    s, weight_s = chord_points(*radii, count)
    weight = s * weight_s * weight_t[..., None] * np.abs(np.linalg.det(corners))[:, None, None]
    t = np.broadcast_to(t[..., None], s.shape)
    shares = np.stack([1.0 - s, s * (1.0 - t), s * t], axis=-1)
    barycentric = np.einsum("cstk,ckj->cstj", shares, corners)
    return barycentric.reshape(-1, 4 * count**2, 3), weight.reshape(-1, 4 * count**2)


def _whole(
    ones: Float[np.ndarray, "*p"],
) -> tuple[Float[np.ndarray, "*p"], Float[np.ndarray, "*p"], Float[np.ndarray, "*p"]]:
    """Begin, middle and end of intervals from 0 to 1."""
    return 0.0 * ones, 0.5 * ones, ones


def _crossed_interval(
    ray: Float[np.ndarray, "p q 3"], centre: Float[np.ndarray, "p 1 3"], radius: float
) -> tuple[Float[np.ndarray, "p q"], Float[np.ndarray, "p q"], Float[np.ndarray, "p q"]]:
    """Where rays from the origin enter a ball, come nearest to its centre, and leave it, as
    fractions of their length, 0 to 1; equal where they miss it."""
    square = (ray**2).sum(axis=-1)
    nearest = (ray * centre).sum(axis=-1) / square
    depth = radius**2 - ((nearest[..., None] * ray - centre) ** 2).sum(axis=-1)
    half = np.sqrt(np.clip(depth, 0.0, None) / square)
    begin, end = np.clip(nearest - half, 0.0, 1.0), np.clip(nearest + half, 0.0, 1.0)
    end = np.where(end - begin > _SHORTEST, end, begin)
    return begin, _divided(begin, nearest, end), end


def _divided(
    start: Float[np.ndarray, "*p"], middle: Float[np.ndarray, "*p"], end: Float[np.ndarray, "*p"]
) -> Float[np.ndarray, "*p"]:
    """A given middle of intervals, or half way where it lies at their ends or outside."""
    margin = _LEAST_PART * (end - start)
    inside = (middle > start + margin) & (middle < end - margin)
    return np.where(inside, middle, 0.5 * (start + end))


def _seen_interval(
    near: Float[np.ndarray, "p 3"],
    side: Float[np.ndarray, "p 3"],
    centre: Float[np.ndarray, "p 3"],
    radius: float,
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    """Interval of t, within 0 to 1, in which the rays from the origin towards near + t side hit a
    ball, empty where none does; between its ends, the ray that passes nearest to the centre."""
    beyond = (centre**2).sum(axis=1) - radius**2
    a, b = (near * centre).sum(axis=1), (side * centre).sum(axis=1)
    # Hit where beyond |ray|^2 <= (ray . centre)^2, a quadratic in t.
    first = beyond * (near**2).sum(axis=1) - a**2
    second = 2.0 * (beyond * (near * side).sum(axis=1) - a * b)
    third = beyond * (side**2).sum(axis=1) - b**2
    root = np.sqrt(np.clip(second**2 - 4.0 * third * first, 0.0, None))
    # The form without cancellation: the first term vanishes where the side is parallel to a tangent
    # from the origin.
    larger = -0.5 * (second + np.copysign(root, second))
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = np.sort(np.nan_to_num(np.stack([larger / third, first / larger])), axis=0)
        across = np.cross(np.cross(near, side), centre)
        straight = -(near * across).sum(axis=1) / (side * across).sum(axis=1)
    breaks = np.stack([0.0 * a, *np.clip(roots, 0.0, 1.0), 0.0 * a + 1.0])
    between = 0.5 * (breaks[1:] + breaks[:-1])
    hit = first + second * between + third * between**2 <= 0.0
    hit = (hit & (a + between * b > 0.0)) | (beyond <= 0.0)
    start = np.where(hit, breaks[:-1], 1.0).min(axis=0)
    end = np.maximum(np.where(hit, breaks[1:], 0.0).max(axis=0), start)
    return start, _divided(start, np.nan_to_num(straight), end), end

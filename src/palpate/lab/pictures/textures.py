"""Reflectance of a surface as a function of the position at rest: it moves with the material.

Textures are evaluated at points and are smooth: the rim of a `speckle` dot is `RIM` times its
diameter wide, and `natural` has no wavelength below the given one. Points closer than a quarter of
that rim or wavelength, like the vertices of a render mesh, resolve them fully.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from palpate.errors import InputError
from palpate.geometry import TriangleMesh, triangle_areas
from palpate.shapes import Points, PointScalars

# Fraction of the surface that dots cover; reflectance of dots and background.
_COVERAGE, _DARK, _BRIGHT = 0.5, 0.1, 0.9
# Width of the smooth rim of a dot, as a fraction of its diameter.
RIM = 0.3
# Waves per octave; from about thirty on their sum looks normally distributed.
_WAVES = 48
# Points whose waves are summed at once: some 40 MB.
_CHUNK = 16384
# Largest number of dots: more points to a mistake in the unit of length.
_MAX_DOTS = 5_000_000
# The sum of the waves saturates at this many standard deviations, to keep it within 0 to 1.
_REACH = 2.0


def texture(
    kind: str,
    points: Points,
    surface: TriangleMesh,
    *,
    size: float,
    rng: np.random.Generator,
) -> PointScalars:
    """Reflectance at points of an object at rest.

    Parameters
    ----------
    kind : "speckle", "natural" or "poor"   natural: wavelengths from `size` to eight times `size`;
                                    poor: faint, to four times `size`, like a bare moulded body,
                                    and deliberately hard to match
    points : (n, 3) float [m]       on the surface, at rest
    surface : TriangleMesh          the surface itself
    size : float [m]                > 0; diameter of a dot, or shortest wavelength
    rng : Generator

    Returns
    -------
    (n,) float [-]                  0 to 1

    Raises
    ------
    InputError                      more dots than can be drawn
    """
    if kind == "speckle":
        return speckle(points, surface, size=size, rng=rng)
    longest, contrast = (8.0, 0.15) if kind == "natural" else (4.0, 0.02)
    return natural(points, coarsest=longest * size, finest=size, contrast=contrast, rng=rng)


def speckle(
    points: Points, surface: TriangleMesh, *, size: float, rng: np.random.Generator
) -> PointScalars:
    """Dark, overlapping dots at random positions on a bright surface, like sprayed paint.

    Half of the surface is covered. The dots are balls around points of the surface, with a smooth
    rim of `RIM` times their diameter.

    Parameters
    ----------
    points : (n, 3) float [m]       on the surface, at rest
    surface : TriangleMesh          that carries the dots
    size : float [m]                > 0; diameter of a dot at half contrast; three to five pixels
                                    are best for matching
    rng : Generator                 of the dots' positions

    Returns
    -------
    (n,) float [-]                  reflectance, 0.1 to 0.9

    Raises
    ------
    InputError                      more dots than can be drawn
    """
    areas = triangle_areas(surface)
    centres = _random_points(surface, areas, rng.poisson(dot_count(surface, size)), rng)
    if len(centres) == 0:
        return np.full(len(points), _BRIGHT)
    distance, _ = cKDTree(centres).query(points)
    # 1 inside, 0 outside; a cubic step of width RIM size around half the diameter.
    inside = np.clip(0.5 + (0.5 * size - distance) / (RIM * size), 0.0, 1.0)
    return _BRIGHT + (_DARK - _BRIGHT) * inside**2 * (3.0 - 2.0 * inside)


def dot_count(surface: TriangleMesh, size: float) -> float:
    """Expected number of dots of a speckle pattern.

    Parameters
    ----------
    surface : TriangleMesh          that carries the dots
    size : float [m]                > 0; diameter of a dot

    Returns
    -------
    float

    Raises
    ------
    InputError                      more than `_MAX_DOTS`

    Source
    ------
    Boolean model: discs of area a, lambda of them in unit area, cover 1 - exp(-lambda a).
    """
    area = triangle_areas(surface).sum()
    expected = float(-np.log1p(-_COVERAGE) / (0.25 * np.pi * size**2) * area)
    if expected > _MAX_DOTS:
        raise InputError(
            f"size is {size:g} m; dots of it on {area:.3g} m^2 are {expected:.2g}, and at most"
            f" {_MAX_DOTS:.0e} are drawn: make them larger, and check the unit of length"
        )
    return expected


def natural(
    points: Points,
    *,
    coarsest: float,
    finest: float,
    contrast: float,
    rng: np.random.Generator,
) -> PointScalars:
    """Random blotches of all sizes, as on stone, skin or foam: octaves of smooth random waves.

    Every octave has twice the power of the next finer one, like the scale-free spectrum of
    photographs of natural objects.

    Parameters
    ----------
    points : (n, 3) float [m]       at rest; anywhere in space
    coarsest, finest : float [m]    longest and shortest wavelength, > 0
    contrast : float [-]            standard deviation of the reflectance, 0 to 0.25
    rng : Generator                 of the waves

    Returns
    -------
    (n,) float [-]                  reflectance, in 0 to 1 and 0.5 on average
    """
    octaves = max(1, int(np.ceil(np.log2(coarsest / finest) - 1e-9)))
    total = np.zeros(len(points))
    power = 0.0
    for k in range(octaves):
        shortest = finest * 2.0**k
        weight = 2.0 ** (0.5 * k)
        total += weight * _waves(points, shortest, min(2.0 * shortest, coarsest), rng)
        power += weight**2
    # Smooth saturation keeps the reflectance within 0 to 1: 5 % of the points would lie beyond two
    # standard deviations.
    return 0.5 + contrast * _REACH * np.tanh(total / (_REACH * np.sqrt(power)))


def _random_points(
    surface: TriangleMesh,
    areas: Float[np.ndarray, " m"],
    count: int,
    rng: np.random.Generator,
) -> Float[np.ndarray, "k 3"]:
    """Random points, uniformly distributed over the area of a surface."""
    place = np.cumsum(areas)
    triangle = np.searchsorted(place, rng.random(count) * place[-1])
    corner = surface.vertices[surface.triangles[np.minimum(triangle, len(areas) - 1)]]
    a, b = rng.random((2, count))
    root = np.sqrt(a)
    weight = np.stack([1.0 - root, root * (1.0 - b), root * b], axis=1)
    return np.einsum("kc,kca->ka", weight, corner)


def _waves(
    points: Points, shortest: float, longest: float, rng: np.random.Generator
) -> PointScalars:
    """Sum of plane waves with random directions and wavelengths in a range; unit variance."""
    direction = rng.normal(size=(_WAVES, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    length = shortest * (longest / shortest) ** rng.random(_WAVES)
    number = (2.0 * np.pi / length)[:, None] * direction
    phase = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
    total = np.empty(len(points))
    for start in range(0, len(points), _CHUNK):
        part = slice(start, start + _CHUNK)
        total[part] = np.cos(points[part] @ number.T + phase).sum(axis=1)
    return np.sqrt(2.0 / _WAVES) * total

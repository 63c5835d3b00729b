"""Reflectance of a surface as a function of the position at rest: it moves with the material.

All kinds are given at points and are smooth between them: `speckle` has rims of `RIM` times a
dot's diameter, `natural` and `poor` hold no wave shorter than the one asked for. Points closer than
a quarter of that rim or wave, as vertices of a render mesh are, lose nothing.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from palpate.errors import InputError
from palpate.geometry import TriangleMesh, triangle_areas
from palpate.shapes import Points, PointScalars

# Width of the smooth rim of a dot, as a share of its diameter.
RIM = 0.3
# Waves of one octave; their sum is normal to the eye from about thirty on.
_WAVES = 48
# Points whose waves are summed at once: some 40 MB.
_CHUNK = 16384
# Most dots that are drawn: a mistake in the unit of length asks for more.
_MOST_DOTS = 5_000_000
# The sum of the waves reaches this many of its standard deviations before it is bent to fit 0 to 1.
_REACH = 2.0


def speckle(
    points: Points,
    surface: TriangleMesh,
    *,
    size: float,
    coverage: float = 0.5,
    dark: float = 0.1,
    bright: float = 0.9,
    rng: np.random.Generator,
) -> PointScalars:
    """Dark dots at random places of a bright surface, overlapping, as sprayed paint leaves them.

    The dots are balls around points of the surface. A spot of paint whose rim is `RIM` wide has
    no detail finer than that.

    Parameters
    ----------
    points : (n, 3) float [m]       on the surface, at rest
    surface : TriangleMesh          that carries the dots
    size : float [m]                diameter of a dot at half its depth; three to five pixels are
                                    best for matching
    coverage : float [-]            share of the area inside dots
    dark, bright : float [-]        reflectance of dots and ground, 0 to 1
    rng : Generator                 of the places

    Returns
    -------
    (n,) float [-]                  reflectance

    Raises
    ------
    InputError                      out of range; more dots than can be drawn

    Source
    ------
    Boolean model: discs of area a, lambda of them in unit area, cover 1 - exp(-lambda a).
    """
    if not 0.0 < coverage < 1.0:
        raise InputError(f"coverage is {coverage:g}; must be between 0 and 1")
    if not (0.0 <= dark <= 1.0 and 0.0 <= bright <= 1.0):
        raise InputError(f"dark is {dark:g}, bright {bright:g}; must be in 0 to 1")
    _check_length("size of a dot", size)
    areas = triangle_areas(surface)
    expected = -np.log1p(-coverage) / (0.25 * np.pi * size**2) * areas.sum()
    if expected > _MOST_DOTS:
        raise InputError(
            f"dots of {size:g} m on {areas.sum():.3g} m^2 are {expected:.2g}; at most"
            f" {_MOST_DOTS:.0e} are drawn: make them larger, and check the unit of length"
        )
    centres = _random_points(surface, areas, rng.poisson(expected), rng)
    if len(centres) == 0:
        return np.full(len(points), bright)
    distance, _ = cKDTree(centres).query(points)
    # 1 inside, 0 outside; a cubic step of width RIM size around half the diameter.
    inside = np.clip(0.5 + (0.5 * size - distance) / (RIM * size), 0.0, 1.0)
    return bright + (dark - bright) * inside**2 * (3.0 - 2.0 * inside)


def natural(
    points: Points,
    *,
    coarsest: float,
    finest: float,
    mean: float = 0.5,
    contrast: float = 0.15,
    rng: np.random.Generator,
) -> PointScalars:
    """Blotches of all sizes, as stone, skin or foam has them: octaves of smooth random waves.

    Every octave has twice the power of the next finer one: the spectrum of photographs of natural
    things, in which no size stands out.

    Parameters
    ----------
    points : (n, 3) float [m]       at rest; anywhere
    coarsest, finest : float [m]    longest and shortest wavelength
    mean : float [-]                reflectance on average
    contrast : float [-]            standard deviation of the reflectance; at most half of what
                                    the mean leaves to 0 and to 1
    rng : Generator                 of the waves

    Returns
    -------
    (n,) float [-]                  reflectance, in 0 to 1

    Raises
    ------
    InputError                      out of range
    """
    _check_length("shortest wavelength", finest)
    if not coarsest >= finest:
        raise InputError(
            f"the longest wavelength is {coarsest:g} m, the shortest {finest:g} m; swap them"
        )
    room = min(mean, 1.0 - mean)
    if not 0.0 <= contrast <= room / _REACH:
        raise InputError(
            f"contrast is {contrast:g} about a mean of {mean:g}; must be 0 to {room / _REACH:g},"
            " half of what the mean leaves to black and white"
        )
    octaves = max(1, int(np.ceil(np.log2(coarsest / finest) - 1e-9)))
    total = np.zeros(len(points))
    power = 0.0
    for k in range(octaves):
        shortest = finest * 2.0**k
        weight = 2.0 ** (0.5 * k)
        total += weight * _waves(points, shortest, min(2.0 * shortest, coarsest), rng)
        power += weight**2
    # Bent smoothly, so that no reflectance leaves 0 to 1: five of a hundred points lie beyond two
    # standard deviations.
    return mean + contrast * _REACH * np.tanh(total / (_REACH * np.sqrt(power)))


def poor(
    points: Points,
    *,
    size: float,
    mean: float = 0.5,
    contrast: float = 0.02,
    rng: np.random.Generator,
) -> PointScalars:
    """Faint, smooth blotches: what a bare moulded body shows. Hard to match, and meant to be.

    Parameters
    ----------
    points : (n, 3) float [m]       at rest
    size : float [m]                shortest wavelength; the longest is four times that
    mean, contrast : float [-]      as `natural`
    rng : Generator

    Returns
    -------
    (n,) float [-]                  reflectance

    Raises
    ------
    InputError                      out of range
    """
    return natural(points, coarsest=4.0 * size, finest=size, mean=mean, contrast=contrast, rng=rng)


def _check_length(name: str, value: float) -> None:
    if not value > 0.0:
        raise InputError(f"{name} is {value:g} m; must be positive")


def _random_points(
    surface: TriangleMesh,
    areas: Float[np.ndarray, " m"],
    count: int,
    rng: np.random.Generator,
) -> Float[np.ndarray, "k 3"]:
    """Points spread evenly over the area of a surface."""
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
    """Plane waves of all directions and of wavelengths in a range; variance 1 on average."""
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

"""Analytic textures under known warps: pictures whose displacement is known exactly.

A warp is given by its inverse, which says what rest point a place of the moved picture shows, so
the texture is evaluated there and nothing is interpolated.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numba import njit, prange

# A speckle is cut off where it has fallen to exp(-4.5^2 / 2), 4e-5 of its peak.
_REACH = 4.5
# Speckles are spread this far beyond the picture [px], for motions of up to 100 px and a turn.
_MARGIN = 160


@dataclass(frozen=True, slots=True, eq=False)
class Warp:
    """A motion in the picture, x = X + u(X), by its inverse: X(x).

    Attributes
    ----------
    inverse : places (n, 2) of the moved picture [px] -> their rest points (n, 2) [px]
    """

    inverse: Callable[[np.ndarray], np.ndarray]

    def source(self, shape: tuple[int, int]) -> Float[np.ndarray, "rows columns 2"]:
        """The rest point that every pixel centre of the moved picture shows [px]."""
        return self.inverse(pixel_grid(shape).reshape(-1, 2)).reshape(*shape, 2)

    def displacement(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """u at rest points [px]: the inverse is solved by fixed point, to rounding.

        Converges where the inverse differs from a shift by a gradient below one: turns to 50
        degrees.
        """
        position = points.copy()
        for _ in range(200):
            step = points - self.inverse(position)
            position = position + step
            if np.abs(step).max() < 1e-12:
                break
        return position - points

    def flow(self, shape: tuple[int, int]) -> Float[np.ndarray, "rows columns 2"]:
        """u at every pixel centre of the rest picture [px]."""
        return self.displacement(pixel_grid(shape).reshape(-1, 2)).reshape(*shape, 2)


def pixel_grid(shape: tuple[int, int]) -> Float[np.ndarray, "rows columns 2"]:
    """Column and row of every pixel centre."""
    row, column = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return np.stack([column, row], axis=-1)


def affine(
    matrix: Float[np.ndarray, "2 2"], shift: tuple[float, float], centre: tuple[float, float]
) -> Warp:
    """x = centre + matrix (X - centre) + shift, in columns and rows [px]."""
    back = np.linalg.inv(matrix)
    middle, away = np.array(centre), np.array(centre) + np.array(shift)
    return Warp(lambda position: middle + (position - away) @ back.T)


def turned(degrees: float, strain: float = 0.0) -> Float[np.ndarray, "2 2"]:
    """Matrix of a turn after a stretch by `strain` along columns and by -strain / 2 along rows."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s], [s, c]]) @ np.diag([1.0 + strain, 1.0 - strain / 2])


def inverse_quadratic(coefficients: Float[np.ndarray, "2 6"], centre: tuple[float, float]) -> Warp:
    """X = x + coefficients @ (1, a, b, a^2, a b, b^2), (a, b) = x - centre [px]."""

    def inverse(position: np.ndarray) -> np.ndarray:
        a, b = (position - np.array(centre)).T
        return position + np.stack([np.ones_like(a), a, b, a * a, a * b, b * b], 1) @ coefficients.T

    return Warp(inverse)


STILL = Warp(lambda place: place)


class Speckle:
    """A texture of Gaussian speckles at random places, mean grey 110 with a contrast of 45.

    Parameters
    ----------
    size : int or (rows, columns) [px]
    seed : int
    sigma : float [px]              of a speckle, times 0.8 to 1.3; fewer are strewn when they are
                                    larger, so that they overlap as much
    """

    def __init__(self, size: int | tuple[int, int], seed: int, sigma: float = 1.7) -> None:
        self.shape = (size, size) if isinstance(size, int) else size
        rng = np.random.default_rng(seed)
        wide = np.array(self.shape[::-1], dtype=float) + 2 * _MARGIN
        density = 0.0715 * (1.7 / sigma) ** 2
        count = int(density * wide.prod())
        centre = rng.uniform(0.0, 1.0, (count, 2)) * wide - _MARGIN
        width = sigma * rng.uniform(0.8, 1.3, count)
        peak = rng.uniform(0.5, 1.0, count)
        # Campbell's theorem: mean and variance of the sum of speckles strewn at random, from
        # E[peak] = 3/4, E[peak^2] = 7/12, E[(width / sigma)^2] = 1.1233.
        area = 1.1233 * np.pi * sigma**2
        self._mean, self._std = density * 0.75 * 2.0 * area, np.sqrt(density * 7 / 12 * area)
        self._cell = _REACH * 1.3 * sigma + 1.0
        self._cells = tuple(int(n) for n in np.ceil(wide[::-1] / self._cell) + 1)
        cell = ((centre + _MARGIN) / self._cell).astype(np.int64)
        flat = cell[:, 1] * self._cells[1] + cell[:, 0]
        order = np.argsort(flat, kind="stable")
        self._first = np.searchsorted(flat[order], np.arange(np.prod(self._cells) + 1))
        self.speckles = np.column_stack([centre, 0.5 / width**2, peak])[order]

    def image(self, warp: Warp = STILL) -> Float[np.ndarray, "rows columns"]:
        """The moved picture in grey levels, each pixel the mean of 3 x 3 places spread over it."""
        third = np.array([-1.0, 0.0, 1.0]) / 3.0
        offset = np.stack(np.meshgrid(third, third), axis=-1).reshape(9, 2)
        position = pixel_grid(self.shape)[:, :, None] + offset
        source = warp.inverse(position.reshape(-1, 2)).reshape(*self.shape, 9, 2)
        total = _speckle_sum(source, self.speckles, self._first, self._cell, self._cells)
        return self.grey(total).astype(np.float32)

    def grey(self, total: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Grey levels of a sum of speckles."""
        return 110.0 + 45.0 * (total - self._mean) / self._std


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _speckle_sum(source, speckle, first, cell, cells):
    """Mean over the last places of the sum of all speckles; `first` bounds those of each cell."""
    rows, columns, places = source.shape[:3]
    total = np.zeros((rows, columns))
    for row in prange(rows):
        for column in range(columns):
            x0, y0 = source[row, column, places // 2]
            j = int((x0 + _MARGIN) / cell)
            i = int((y0 + _MARGIN) / cell)
            grey = 0.0
            for a in range(max(i - 1, 0), min(i + 2, cells[0])):
                low, high = max(j - 1, 0), min(j + 2, cells[1])
                if low >= high:
                    continue
                for k in range(first[a * cells[1] + low], first[a * cells[1] + high - 1 + 1]):
                    x, y, narrow, peak = speckle[k]
                    if narrow * ((x - x0) ** 2 + (y - y0) ** 2) > 0.5 * (_REACH + 0.3) ** 2:
                        continue
                    for q in range(places):
                        dx = source[row, column, q, 0] - x
                        dy = source[row, column, q, 1] - y
                        grey += peak * np.exp(-narrow * (dx * dx + dy * dy))
            total[row, column] = grey / places
    return total


def noisy(
    grey: Float[np.ndarray, "rows columns"], sigma: float, seed: int
) -> Float[np.ndarray, "rows columns"]:
    """What an 8-bit camera makes of a picture: noise of `sigma` grey levels, rounded, clipped."""
    noise = np.random.default_rng(seed).normal(0.0, sigma, grey.shape)
    return np.clip(np.round(grey + noise), 0.0, 255.0).astype(np.float32)


def window_correlation(first, at, second, there, half):
    """Correlation of two windows between pixels, by numpy's own; NaN greys are not expected.

    `at` and `there` are (column, row); one of the two may lie between whole pixels.
    """

    def window(grey, position):
        column, row = (int(np.floor(value)) for value in position)
        right, down = position[0] - column, position[1] - row
        rows, columns = (
            np.arange(row - half, row + half + 1),
            np.arange(column - half, column + half + 1),
        )
        near = grey[np.ix_(rows, columns)]
        if not (right or down):
            return near.ravel()
        share = max(right, down)
        far = grey[np.ix_(rows + (down > 0), columns + (right > 0))]
        return ((1.0 - share) * near + share * far).ravel()

    return np.corrcoef(window(first, at), window(second, there))[0, 1]

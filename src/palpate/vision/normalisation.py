"""Normalised pictures: local differences of lighting and gain removed, only texture left."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.special import erfinv

# Side of the windows in which pictures are normalised and compared [px]: that of the default
# refinement.
WINDOW = 21
# Side of the windows in which edges are examined [px], and their minimum contrast-to-noise.
_EDGE_WINDOW = 7
_EDGE_CONTRAST = 30.0
# Quantile of slope over contrast in such windows that is taken as the middle of a sharp edge.
_SOFT = 0.95
# Blur variance of a pixel's own area, a lower bound for any camera [px^2].
_PIXEL_VARIANCE = 1.0 / 12.0


@dataclass(frozen=True, slots=True, eq=False)
class NormalisedImage:
    """A picture prepared for searching.

    Attributes
    ----------
    grey : (rows, columns) float32 [grey levels]    rescaled to 0 to 255
    levels : (rows, columns) uint8 [grey levels]    mean 128 and standard deviation 40 in every
                                            window with texture, less where noise contributes
    mean, variance : (rows, columns) float32 [grey levels, grey levels^2]   of `grey` in the
                                            surrounding window of 21 px
    textured : (rows, columns) bool         where the variance of the texture exceeds three times
                                            that of the noise
    width : float [px]                      of the texture, as the sigma of Gaussian speckles; 0 if
                                            there is none
    """

    grey: Float[np.ndarray, "rows columns"]
    levels: UInt8[np.ndarray, "rows columns"]
    mean: Float[np.ndarray, "rows columns"]
    variance: Float[np.ndarray, "rows columns"]
    textured: Bool[np.ndarray, "rows columns"]
    width: float


def make_normalised_image(grey: Float[np.ndarray, "rows columns"]) -> NormalisedImage:
    """Normalise a picture by its local mean and contrast.

    Parameters
    ----------
    grey : (rows, columns) float [grey levels]  finite, of any scale

    Returns
    -------
    NormalisedImage
    """
    low, high = float(grey.min()), float(grey.max())
    scale = 255.0 / (high - low) if high > low else 1.0
    grey = (np.ascontiguousarray(grey, dtype=np.float32) - np.float32(low)) * np.float32(scale)
    noise = _noise(grey)
    mean, variance = moments(grey)
    # (4 sigma)^2 of noise is added to the variance, so that pure noise is not amplified to texture.
    levels = (grey - mean) / np.sqrt(variance + np.float32(16.0 * noise**2))
    levels = cv2.addWeighted(levels, 40.0, levels, 0.0, 128.0, dtype=cv2.CV_8U)  # rounds and clips
    textured = variance > 4.0 * noise**2
    return NormalisedImage(
        grey, levels, mean, variance, textured, _width(grey, variance, textured, noise)
    )


def _noise(grey: Float[np.ndarray, "rows columns"]) -> float:
    """Standard deviation of the pixel noise [grey levels], biased upwards rather than downwards.

    Source: Immerkaer, Fast noise variance estimation, CVIU 64(2), 1996, but with the lower quartile
    instead of the mean (0.3186 sigma for a normal distribution), so that sharp texture may fill
    most of the picture.
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    rough = np.abs(cv2.filter2D(grey, -1, mask)[1:-1:2, 1:-1:2])
    # At least the noise of rounding to whole grey levels.
    return max(float(np.percentile(rough, 25.0)) / (6.0 * 0.3186), 12.0**-0.5)


def moments(
    grey: Float[np.ndarray, "rows columns"], side: int = WINDOW
) -> tuple[Float[np.ndarray, "rows columns"], Float[np.ndarray, "rows columns"]]:
    """Mean and variance of the grey levels in the window around every pixel.

    Parameters
    ----------
    grey : (rows, columns) float32 or float64 [grey levels]
    side : int [px]                 of the window, odd

    Returns
    -------
    mean : (rows, columns) float [grey levels]          the picture is mirrored at its edge
    variance : (rows, columns) float [grey levels^2]    >= 0; both in the precision of `grey`
    """
    size = (side, side)
    mean = cv2.blur(grey, size)
    return mean, np.maximum(cv2.sqrBoxFilter(grey, -1, size) - mean * mean, 0.0)


def _width(
    grey: Float[np.ndarray, "rows columns"],
    variance: Float[np.ndarray, "rows columns"],
    textured: Bool[np.ndarray, "rows columns"],
    noise: float,
) -> float:
    """Width of the texture [px] as the sigma of Gaussian speckles: root of variance over squared
    gradient, both without noise. The two Sobel operators keep 0.375 of the noise variance.
    """
    column, row = cv2.Sobel(grey, -1, 1, 0, scale=0.125), cv2.Sobel(grey, -1, 0, 1, scale=0.125)
    count = int(textured.sum())
    steep = float((column**2 + row**2)[textured].sum()) - 0.375 * count * noise**2
    strong = float(variance[textured].sum()) - count * noise**2
    return float(np.sqrt(strong / steep)) if steep > 0.0 else 0.0


def point_spread_variance(grey: Float[np.ndarray, "rows columns"]) -> float:
    """Variance of the point spread function of lens and sensor, estimated from a picture.

    No edge is sharper than the camera, but all may be softer. So the width of the sharpest edges is
    an upper bound and the area of a pixel a lower bound. The mean of the variance is returned, with
    a log-uniform prior between the two.

    Parameters
    ----------
    grey : (rows, columns) float [grey levels]      finite

    Returns
    -------
    float [px^2]                    variance along one axis, at least 1 / 12
    """
    around = np.ones((_EDGE_WINDOW, _EDGE_WINDOW), dtype=np.uint8)
    grey = np.ascontiguousarray(grey, dtype=np.float32)
    contrast = cv2.dilate(grey, around) - cv2.erode(grey, around)
    across = 0.5 * (np.roll(grey, -1, axis=1) - np.roll(grey, 1, axis=1))
    down = 0.5 * (np.roll(grey, -1, axis=0) - np.roll(grey, 1, axis=0))
    slope = np.maximum(np.abs(across), np.abs(down))
    interior = (slice(_EDGE_WINDOW, -_EDGE_WINDOW),) * 2
    strong = contrast[interior] > _EDGE_CONTRAST * _noise(grey)
    if not strong.any():
        return _PIXEL_VARIANCE
    # Slope (half the difference over two pixels) over step height, of the sharpest edges.
    sharp = np.quantile(slope[interior][strong] / contrast[interior][strong], _SOFT)
    steepest = min(float(sharp), 0.499)
    max_variance = 0.5 / float(erfinv(2.0 * steepest)) ** 2
    ratio = max_variance / _PIXEL_VARIANCE
    return _PIXEL_VARIANCE * (ratio - 1.0) / np.log(ratio) if ratio > 1.001 else _PIXEL_VARIANCE


def cropped(picture: NormalisedImage, box: tuple[slice, slice]) -> NormalisedImage:
    """Crop a normalised picture.

    Parameters
    ----------
    picture : NormalisedImage
    box : (slice, slice) [px]       rows and columns of the part

    Returns
    -------
    NormalisedImage                 mean, variance and width are kept from the whole picture
    """
    return NormalisedImage(
        np.ascontiguousarray(picture.grey[box]),
        np.ascontiguousarray(picture.levels[box]),
        np.ascontiguousarray(picture.mean[box]),
        np.ascontiguousarray(picture.variance[box]),
        np.ascontiguousarray(picture.textured[box]),
        picture.width,
    )

"""A picture normalised: no difference of lighting or gain is left in it, only texture."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.special import erfinv

# Side of the windows in which pictures are normalised and compared [px]: that of the usual
# refinement.
WINDOW = 21
# Windows in which edges are looked at [px], and how far their contrast stands over the noise.
_EDGE_WINDOW = 7
_EDGE_CONTRAST = 30.0
# Of the pixels in such windows, the share that lies off the middle of an edge or on a soft one.
_SOFT = 0.95
# What a pixel's own area spreads light by, the least that any camera does [px^2].
_PIXEL_SPREAD = 1.0 / 12.0


@dataclass(frozen=True, slots=True, eq=False)
class NormalisedImage:
    """A picture ready to be searched.

    Attributes
    ----------
    grey : (rows, columns) float32 [grey levels]    stretched to 0 to 255
    levels : (rows, columns) uint8 [grey levels]    mean 128 and contrast 40 in every window with
                                            texture, less where noise is a part of it
    mean, variance : (rows, columns) float32 [grey levels, and squared]     of `grey` in the window
                                            of 21 px around
    textured : (rows, columns) bool         signal has three times the variance of noise there
    width : float [px]                      of the texture, as the sigma of Gaussian speckles; 0
                                            where there is none
    """

    grey: Float[np.ndarray, "rows columns"]
    levels: UInt8[np.ndarray, "rows columns"]
    mean: Float[np.ndarray, "rows columns"]
    variance: Float[np.ndarray, "rows columns"]
    textured: Bool[np.ndarray, "rows columns"]
    width: float


def make_normalised_image(grey: Float[np.ndarray, "rows columns"]) -> NormalisedImage:
    """Local mean and contrast of a picture, and the picture without them.

    Parameters
    ----------
    grey : (rows, columns) float [grey levels]  finite, of any scale

    Returns
    -------
    NormalisedImage
    """
    # Any scale: 255 grey levels, whatever they were.
    low, high = float(grey.min()), float(grey.max())
    scale = 255.0 / (high - low) if high > low else 1.0
    grey = (np.ascontiguousarray(grey, dtype=np.float32) - np.float32(low)) * np.float32(scale)
    noise = _noise(grey)
    mean, variance = moments(grey)
    # Four times the noise: where there is nothing else, it is not blown up to look like texture.
    levels = (grey - mean) / np.sqrt(variance + np.float32(16.0 * noise**2))
    levels = cv2.addWeighted(levels, 40.0, levels, 0.0, 128.0, dtype=cv2.CV_8U)  # rounds and clips
    textured = variance > 4.0 * noise**2
    return NormalisedImage(
        grey, levels, mean, variance, textured, _width(grey, variance, textured, noise)
    )


def _noise(grey: Float[np.ndarray, "rows columns"]) -> float:
    """Standard deviation of the pixel noise [grey levels], rather too large than too small.

    Source: Immerkaer, Fast noise variance estimation, CVIU 64(2), 1996; but a quartile in place of
    the mean (0.3186 of a normal distribution's sigma), so that sharp texture may fill most of the
    picture.
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    rough = np.abs(cv2.filter2D(grey, -1, mask)[1:-1:2, 1:-1:2])
    # What rounding to whole grey levels leaves, where nothing else does.
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
    mean : (rows, columns) float [grey levels]          the picture is mirrored beyond its edge
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
    """Width of the texture [px]: of speckles of that sigma, variance over squared gradient.

    Sobel's two operators keep 0.375 of the variance of noise.
    """
    column, row = cv2.Sobel(grey, -1, 1, 0, scale=0.125), cv2.Sobel(grey, -1, 0, 1, scale=0.125)
    count = int(textured.sum())
    steep = float((column**2 + row**2)[textured].sum()) - 0.375 * count * noise**2
    strong = float(variance[textured].sum()) - count * noise**2
    return float(np.sqrt(strong / steep)) if steep > 0.0 else 0.0


def point_spread(grey: Float[np.ndarray, "rows columns"]) -> float:
    """Variance of the spot that lens and chip make of a point, as far as the picture tells [px^2].

    No edge is sharper than the camera, but all may be softer: what is known is an upper bound, the
    width of the sharpest edges, and a lower one, the area of a pixel. Of the scale in between
    nothing is known, and the mean of what is left is returned.

    Parameters
    ----------
    grey : (rows, columns) float [grey levels]      finite

    Returns
    -------
    float [px^2]                    along one axis, at least 1 / 12
    """
    around = np.ones((_EDGE_WINDOW, _EDGE_WINDOW), dtype=np.uint8)
    grey = np.ascontiguousarray(grey, dtype=np.float32)
    contrast = cv2.dilate(grey, around) - cv2.erode(grey, around)
    across = 0.5 * (np.roll(grey, -1, axis=1) - np.roll(grey, 1, axis=1))
    down = 0.5 * (np.roll(grey, -1, axis=0) - np.roll(grey, 1, axis=0))
    slope = np.maximum(np.abs(across), np.abs(down))
    inner = (slice(_EDGE_WINDOW, -_EDGE_WINDOW),) * 2
    strong = contrast[inner] > _EDGE_CONTRAST * _noise(grey)
    if not strong.any():
        return _PIXEL_SPREAD
    # Half the step from one pixel before a blurred edge to one behind, over its height.
    sharp = np.quantile(slope[inner][strong] / contrast[inner][strong], _SOFT)
    share = min(float(sharp), 0.499)
    widest = 0.5 / float(erfinv(2.0 * share)) ** 2
    ratio = widest / _PIXEL_SPREAD
    return _PIXEL_SPREAD * (ratio - 1.0) / np.log(ratio) if ratio > 1.001 else _PIXEL_SPREAD


def cropped(picture: NormalisedImage, box: tuple[slice, slice]) -> NormalisedImage:
    """A part of a picture.

    Parameters
    ----------
    picture : NormalisedImage
    box : (slice, slice) [px]       rows and columns of the part

    Returns
    -------
    NormalisedImage                 mean, variance and width are those of the whole picture
    """
    return NormalisedImage(
        np.ascontiguousarray(picture.grey[box]),
        np.ascontiguousarray(picture.levels[box]),
        np.ascontiguousarray(picture.mean[box]),
        np.ascontiguousarray(picture.variance[box]),
        np.ascontiguousarray(picture.textured[box]),
        picture.width,
    )

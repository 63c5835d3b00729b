"""Image sensor model: from the radiance that reaches a camera to stored grey levels.

Grey levels are on the 8-bit scale, 255 is white, even if more bits are stored.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int, UInt8, UInt16

from palpate.errors import InputError
from palpate.lab.config import Pictures

_WHITE = 255.0
# In 16-bit files the 12 bits are the most significant ones, as in machine vision cameras.
_SHIFT = 4
# Step of the blur radii between which pictures are blended [px]: a quarter of a pixel changes the
# sharpness by less than a tenth.
_RADIUS_STEP = 0.25
# Subdivision of a pixel's side for the area of a disc inside it: accurate to 1 % for a disc of one
# pixel, to 0.1 % from two pixels on.
_PARTS = 32
# The exposure puts this quantile of the illuminated pixels at this grey level.
_BRIGHT_LEVEL, _BRIGHT_SHARE = 220.0, 0.995
# Pixels darker than this fraction of the brightest are background when the exposure is chosen.
_DARK = 0.02

Picture = Float32[np.ndarray, "rows columns"]


def grey_picture(
    radiance: Picture, settings: Pictures, *, gain: float, rng: np.random.Generator
) -> UInt8[np.ndarray, "rows columns"] | UInt16[np.ndarray, "rows columns"]:
    """A stored picture: blur, shot noise, read noise, rounding, and clipping at black and white.

    Parameters
    ----------
    radiance : (rows, columns) float32  negative values count as zero
    settings : Pictures                 response, full well, noise and bits of the image sensor
    gain : float                        grey levels per unit of radiance
    rng : Generator                     of the noise; another state for each picture

    Returns
    -------
    (rows, columns) uint8, or uint16 with 12 bits as the most significant ones
    """
    light = np.maximum(radiance, 0.0)
    if settings.response > 0.0:
        light = cv2.GaussianBlur(
            light, (0, 0), sigmaX=settings.response, borderType=cv2.BORDER_REPLICATE
        )
    grey = gain * light.astype(np.float64)
    if settings.full_well is not None:
        per_grey = settings.full_well / _WHITE
        grey = rng.poisson(grey * per_grey) / per_grey
    if settings.noise > 0.0:
        grey += rng.normal(0.0, settings.noise, grey.shape)
    top = 2**settings.bits - 1
    level = np.clip(np.rint(grey * (top / _WHITE)), 0, top)
    return level.astype(np.uint8) if settings.bits == 8 else level.astype(np.uint16) << _SHIFT


def shot_noise(settings: Pictures, grey: float) -> float:
    """Standard deviation of the shot noise, in grey levels.

    Parameters
    ----------
    settings : Pictures             its full well
    grey : float                    grey level, 0 to 255

    Returns
    -------
    float                           0 for an image sensor without shot noise
    """
    return 0.0 if settings.full_well is None else float(np.sqrt(grey * _WHITE / settings.full_well))


def exposure_gain(pictures: Sequence[Float32[np.ndarray, "_ _"]]) -> float:
    """Gain at which the bright parts of the bodies have grey level 220.

    Parameters
    ----------
    pictures : sequence of (rows, columns) float32   radiance; one gain for all of them

    Returns
    -------
    float                           grey levels per unit of radiance

    Raises
    ------
    InputError                      pictures that are entirely black
    """
    values = np.concatenate([picture.ravel() for picture in pictures])
    brightest = float(values.max(initial=0.0))
    if not brightest > 0.0:
        raise InputError("the pictures are black; put light on the bodies, or turn the cameras")
    return _BRIGHT_LEVEL / float(np.quantile(values[values > _DARK * brightest], _BRIGHT_SHARE))


def blur_radius(
    depth: Float[np.ndarray, "rows columns"], *, focus: float, aperture: float, focal: float
) -> Float[np.ndarray, "rows columns"]:
    """Radius of the circle of confusion of each pixel.

    Parameters
    ----------
    depth : (rows, columns) float [m]   along the optical axis; NaN or infinite: no surface
    focus : float [m]               depth in focus, > 0
    aperture : float [m]            diameter of the lens opening, > 0
    focal : float [px]              > 0; camera constant of the camera matrix, focused at `focus`

    Returns
    -------
    (rows, columns) float [px]      NaN where the depth is NaN; finite where it is infinite

    Raises
    ------
    InputError                      lengths that are not positive

    Source
    ------
    Similar triangles behind a thin lens: the diameter is aperture focal |1 / focus - 1 / depth|.
    """
    if not min(focus, aperture, focal) > 0.0:
        raise InputError(
            f"focus is {focus:g} m, aperture {aperture:g} m, focal length {focal:g} px; all must"
            " be positive"
        )
    return 0.5 * aperture * focal * np.abs(1.0 / focus - 1.0 / depth)


def defocused(radiance: Picture, radius: float | Float[np.ndarray, "rows columns"]) -> Picture:
    """A picture out of focus: every pixel is the mean over a disc around it.

    Each pixel uses its own radius, so that a sharp body keeps a sharp outline in front of a blurred
    one; the outline of a blurred body is slightly too sharp.

    Parameters
    ----------
    radiance : (rows, columns) float32
    radius : float or (rows, columns) float [px]    >= 0; NaN counts as 0

    Returns
    -------
    (rows, columns) float32

    Raises
    ------
    InputError                      a negative radius
    """
    wanted = np.nan_to_num(np.broadcast_to(radius, radiance.shape), nan=0.0)
    if wanted.min() < 0.0:
        raise InputError(f"radius of blur is {wanted.min():g} px; must not be negative")
    low, high = float(wanted.min()), float(wanted.max())
    steps = int(np.ceil((high - low) / _RADIUS_STEP))
    if steps == 0:
        return _disc_mean(radiance, low)
    place = (wanted - low) * (steps / (high - low))
    picture = np.zeros_like(radiance)
    for k in range(steps + 1):
        weight = np.maximum(1.0 - np.abs(place - k), 0.0)
        if weight.any():
            blurred = _disc_mean(radiance, low + k * (high - low) / steps)
            picture += (weight * blurred).astype(np.float32)
    return picture


def _disc_mean(radiance: Picture, radius: float) -> Picture:
    """Mean over a disc, weighted by the area of each pixel inside it; border pixels are
    replicated."""
    if radius == 0.0:
        return radiance
    reach = int(np.ceil(radius + 0.5))
    part = (np.arange((2 * reach + 1) * _PARTS) + 0.5) / _PARTS - 0.5 - reach
    inside: Int[np.ndarray, "k k"] = (np.hypot(part, part[:, None]) < radius).astype(np.int64)
    size = 2 * reach + 1
    weight = inside.reshape(size, _PARTS, size, _PARTS).sum(axis=(1, 3)).astype(np.float64)
    if not weight.any():  # far smaller than a pixel
        return radiance
    return np.asarray(
        cv2.filter2D(radiance, -1, weight / weight.sum(), borderType=cv2.BORDER_REPLICATE)
    )

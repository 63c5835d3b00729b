"""Pictures of the bench: bodies, light, lenses, image sensors; each picture with its own noise.

Grey levels are on the 8-bit scale, 255 is white, even if more bits are stored.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int, UInt, UInt8, UInt16

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.lab.config import LabConfig, Pictures
from palpate.lab.render_mesh import make_render_mesh, texture
from palpate.lab.scene import DrawnBody, Lamp, Light, Variant, render
from palpate.records import Camera, Rig, camera_centre, picture_size
from palpate.shapes import PointScalars, Vertices
from palpate.vision import surface_map

# Longest edge of the rendered triangles [px]; the texture is linear between their vertices.
_EDGE_PX = 1.5
# Reflectance of the rod; fraction of the light that is ambient.
_ROD_GREY = 0.03
_AMBIENT = 0.55
# Distance of the lamp from the reference camera, in units of that camera's distance.
_LAMP_DISTANCE = 0.8
# Least ratio of the texture's contrast to the noise, both in grey levels, for matching subsets.
_MIN_CONTRAST = 5.0
# Grey level at which the shot noise is compared with the contrast.
_MID_GREY = 127.5
# Number of instants that are averaged over an exposure.
_FRAMES = 5
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


@dataclass(frozen=True, slots=True, eq=False)
class Studio:
    """Everything that is the same for all pictures.

    Attributes
    ----------
    config : LabConfig
    rig : Rig                       true rig
    mesh : TriangleMesh             fine mesh of the object at rest, for rendering
    grey : (v,) float [-]           its reflectance, 0 to 1
    light : Light
    gain : float                    grey levels per unit of radiance
    variant : Variant               of Mitsuba
    """

    config: LabConfig
    rig: Rig
    mesh: TriangleMesh
    grey: PointScalars
    light: Light
    gain: float
    variant: Variant


def make_studio(
    config: LabConfig, rig: Rig, variant: Variant, *, rng: np.random.Generator
) -> Studio:
    """Prepare texture, light and exposure.

    Parameters
    ----------
    config : LabConfig
    rig : Rig                       true rig
    variant : Variant               of Mitsuba
    rng : Generator                 of the texture

    Returns
    -------
    Studio

    Raises
    ------
    InputError                      a texture whose contrast is too low for the sensor's noise
    """
    surface = config.specimen.mesh
    mesh = make_render_mesh(surface, rig.cameras, edge=_EDGE_PX)
    look = config.look
    grey = texture(look.texture, mesh.vertices, surface, size=look.size, rng=rng)
    studio = Studio(config, rig, mesh, grey, _light(config, rig), 1.0, variant)
    radiance = _radiance(studio, mesh.vertices, None, 0)
    studio = replace(studio, gain=exposure_gain(radiance))
    _check_contrast(studio, radiance[rig.reference])
    return studio


def photograph(
    studio: Studio,
    instants: Sequence[Vertices],
    rod: TriangleMesh | None = None,
    *,
    rng: np.random.Generator,
) -> tuple[UInt[np.ndarray, "_ _"], ...]:
    """One picture from each camera.

    Parameters
    ----------
    studio : Studio
    instants : sequence of (v, 3) float [m]     the rendered vertices at one instant, or at several
                                    during the exposure
    rod : TriangleMesh or None      the arm's rod, if visible
    rng : Generator                 of this picture's noise

    Returns
    -------
    tuple of (rows, columns) uint8 or uint16    one for each camera
    """
    settings = studio.config.pictures
    seeds = rng.integers(0, 2**32, size=len(instants))
    frames = [
        _radiance(studio, vertices, rod, int(seed))
        for vertices, seed in zip(instants, seeds, strict=True)
    ]
    pictures = []
    for camera, moments in zip(studio.rig.cameras, zip(*frames, strict=True), strict=True):
        light = np.stack(moments).mean(axis=0, dtype=np.float64).astype(np.float32)
        if settings.aperture > 0.0:
            light = defocused(light, _blur(studio, camera, instants[-1]))
        gain = studio.gain * max(1.0 + settings.gain_drift * rng.standard_normal(), 0.1)
        pictures.append(grey_picture(light, settings, gain=gain, rng=rng))
    return tuple(pictures)


def exposure(config: LabConfig, before: Vertices, after: Vertices) -> list[Vertices]:
    """Instants during an exposure.

    Parameters
    ----------
    config : LabConfig              its motion blur
    before, after : (v, 3) float [m]    vertices of two load steps; the exposure ends at `after`

    Returns
    -------
    list of (v, 3) float [m]        vertices at each instant; one instant without motion blur
    """
    blur = config.pictures.motion_blur
    if blur == 0.0:
        return [after]
    return [after - s * (after - before) for s in np.linspace(blur, 0.0, _FRAMES)]


def _light(config: LabConfig, rig: Rig) -> Light:
    """A lamp next to the reference camera, and ambient light."""
    vertices = config.specimen.mesh.vertices
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    reference = rig.cameras[rig.reference]
    pose, eye = reference.T_camera_object, camera_centre(reference)
    distance = float(np.linalg.norm(eye - middle))
    position = eye + _LAMP_DISTANCE * distance * (0.8 * pose[0, :3] - 0.6 * pose[1, :3])
    side = config.pictures.lamp
    # The irradiance of the object does not depend on the lamp's size and distance.
    radiance = (1.0 - _AMBIENT) * np.pi * float(np.sum((position - middle) ** 2)) / side**2
    return Light(_AMBIENT, Lamp(position, middle, side, radiance))


def _radiance(
    studio: Studio, vertices: Vertices, rod: TriangleMesh | None, seed: int
) -> tuple[np.ndarray, ...]:
    """Rendered radiance for every camera."""
    mesh = TriangleMesh(vertices, studio.mesh.triangles)
    bodies = [DrawnBody(mesh, studio.grey, studio.config.look.gloss)]
    if rod is not None:
        bodies.append(DrawnBody(rod, np.full(len(rod.vertices), _ROD_GREY)))
    cameras, samples = studio.rig.cameras, studio.config.pictures.samples
    return render(bodies, cameras, studio.light, variant=studio.variant, samples=samples, seed=seed)


def _blur(studio: Studio, camera: Camera, vertices: Vertices) -> Float[np.ndarray, "rows columns"]:
    """Defocus radius [px] in each pixel of a camera that is focused on the object's middle."""
    seen = surface_map(camera, picture_size(camera)[::-1], vertices, studio.mesh.triangles)
    depth = np.asarray(seen.point @ camera.T_camera_object[2, :3] + camera.T_camera_object[2, 3])
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    focus = float(camera.T_camera_object[2, :3] @ middle + camera.T_camera_object[2, 3])
    aperture, focal = studio.config.pictures.aperture, float(camera.matrix[0, 0])
    return blur_radius(depth, focus=focus, aperture=aperture, focal=focal)


def _check_contrast(studio: Studio, radiance: np.ndarray) -> None:
    """Refuse a texture that image correlation cannot track, before anything else is rendered."""
    sensor, grey = studio.config.pictures, studio.gain * radiance
    lit = grey > 0.1 * grey.max()
    # The spread of the reflectance alone: shading is no texture.
    contrast = float(np.std(studio.grey) / max(np.mean(studio.grey), 1e-9) * np.mean(grey[lit]))
    noise = float(np.hypot(sensor.noise, shot_noise(sensor, _MID_GREY)))
    if contrast < _MIN_CONTRAST * noise:
        raise InputError(
            f"the texture '{studio.config.look.texture}' shows {contrast:.1f} grey levels of"
            f" contrast beside a noise of {noise:.1f}; {_MIN_CONTRAST:g} times the noise is needed:"
            " take 'speckle', or less noise"
        )


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

    Source
    ------
    Similar triangles behind a thin lens: the diameter is aperture focal |1 / focus - 1 / depth|.
    """
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
    """
    wanted = np.nan_to_num(np.broadcast_to(radius, radiance.shape), nan=0.0)
    low, high = float(wanted.min()), float(wanted.max())
    steps = int(np.ceil((high - low) / _RADIUS_STEP))
    if steps == 0:
        return _disc_mean(radiance, low)
    step_number = (wanted - low) * (steps / (high - low))
    picture = np.zeros_like(radiance)
    for k in range(steps + 1):
        weight = np.maximum(1.0 - np.abs(step_number - k), 0.0)
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

"""Pictures of the bench: bodies, light, lenses, image sensors; each picture with its own noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.lab.config import LabConfig
from palpate.lab.pictures.mitsuba_variant import Variant
from palpate.lab.pictures.render_mesh import make_render_mesh
from palpate.lab.pictures.scene import DrawnBody, Lamp, Light, render
from palpate.lab.pictures.sensor import (
    blur_radius,
    defocused,
    exposure_gain,
    grey_picture,
    shot_noise,
)
from palpate.lab.pictures.textures import texture
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

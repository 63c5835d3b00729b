"""Videos of presses with the log of a force gauge: the raw recordings of a bench.

Each press is solved at a few depths, and the object at rest is rendered once for each camera, at
twice the resolution. A frame is that picture warped by the projected displacement, which is
interpolated over the depth; pictures are never interpolated in time. The rod is drawn without its
shadow, and shading does not change with the surface's slope. Every frame has its own noise.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from scipy.interpolate import CubicSpline
from scipy.ndimage import distance_transform_edt, map_coordinates, spline_filter

from palpate.errors import RecordError
from palpate.lab.arm import rod_at, solid_under, specimen_body
from palpate.lab.config import LabConfig
from palpate.lab.scene import Variant
from palpate.lab.studio import make_studio, photograph
from palpate.records import Camera, Rig, picture_size
from palpate.shapes import Vector3
from palpate.solids import Solid, Tip, press, press_to_force, surface_values
from palpate.vision import project, surface_map, video_frame_count

# Grey level of the rod.
_ROD = 8.0
Picture = Float[np.ndarray, "_ _"]


@dataclass(frozen=True, slots=True, eq=False)
class Film:
    """Time course of the presses, and how they are recorded.

    Attributes
    ----------
    presses, depths : int           number of presses; number of solved depths of each
    frame_rate, gauge_rate : float [Hz]
    clock_offset : float [s]        by which the gauge's clock is ahead of the cameras'
    approach : float [s]            duration of the approach, and of the retreat
    ramp : float [s]                duration of loading, and of unloading
    hold : float [s]                duration of the plateau at full depth
    pause : tuple of float [s]      time without tool after each press, used cyclically
    far : float [m]                 distance from which the tool approaches
    weight : (3,) float [N]         of the tool, included in the gauge's readings
    gauge_noise : float [N]         standard deviation of each component of a reading
    drift : float [N]               total zero drift over the recording
    """

    presses: int = 10
    depths: int = 6
    frame_rate: float = 30.0
    gauge_rate: float = 500.0
    clock_offset: float = 0.4
    approach: float = 0.6
    ramp: float = 0.7
    hold: float = 1.5
    pause: tuple[float, ...] = (1.6, 2.0, 1.8)
    far: float = 0.06
    weight: Vector3 = field(default_factory=lambda: np.array([0.03, -0.05, -0.9]))
    gauge_noise: float = 0.002
    drift: float = 0.02

    @property
    def start_times(self) -> Float[np.ndarray, " k"]:
        """Time of first contact of each press, gauge's clock [s]."""
        times, time = [], 2.0
        for k in range(self.presses):
            times.append(time)
            time += 2.0 * (self.ramp + self.approach) + self.hold + self.pause[k % len(self.pause)]
        return np.array(times)

    @property
    def duration(self) -> float:
        """Duration of the recording [s]."""
        return float(self.start_times[-1] + 2.0 * self.ramp + self.hold + self.approach + 1.5)

    def depth_fraction(
        self, time: Float[np.ndarray, " n"], begin: float
    ) -> Float[np.ndarray, " n"]:
        """Depth of the tool as a fraction of its largest depth; before and after contact minus its
        distance as a fraction of `far`."""
        out = begin + self.ramp + self.hold
        inside = _smooth((time - begin) / self.ramp) - _smooth((time - out) / self.ramp)
        before = np.clip((begin - time) / self.approach, 0.0, None)
        after = np.clip((time - out - self.ramp) / self.approach, 0.0, None)
        away = before + after
        return np.where(away > 0.0, -away, inside)


def _smooth(share: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Smooth step from 0 to 1 with zero slope at both ends."""
    s = np.clip(share, 0.0, 1.0)
    return s**2 * (3.0 - 2.0 * s)


@dataclass(frozen=True, slots=True, eq=False)
class SolvedPress:
    """One press of a body at several depths.

    Attributes
    ----------
    tip : Tip
    point : (3,) float [m]          commanded contact point
    radius : float [m]              contact radius at full depth
    full_tip_position : (3,) float [m]  position of the tip at full depth
    depth : float [m]               full depth
    depth_fraction : (s,) float [-] depth of each state as a fraction of the full depth, from 0 to 1
    force : (s, 3) float [N]        of the tool on the body in each state
    solid : Solid
    displacements : (s, n, 3) float [m]     nodal displacements in each state
    """

    tip: Tip
    point: Vector3
    radius: float
    full_tip_position: Vector3
    depth: float
    depth_fraction: Float[np.ndarray, " s"]
    force: Float[np.ndarray, "s 3"]
    solid: Solid
    displacements: Float[np.ndarray, "s n 3"]

    def force_at(self, fraction: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Force of the tool on the body at fractions, (n,), of the full depth; (n, 3) [N]."""
        # Hertz: the force grows as depth to the power 1.5, so it is smooth in the depth's root.
        law = CubicSpline(np.sqrt(self.depth_fraction), self.force)
        touching = np.clip(fraction, 0.0, 1.0)
        return np.where(touching[:, None] > 0.0, law(np.sqrt(touching)), 0.0)

    def tip_position(self, fraction: float, far: float) -> Vector3:
        """Position of the tip's reference point [m], at a value of `Film.depth_fraction`."""
        approaching = fraction < 0.0
        along = -self.depth + far * fraction if approaching else self.depth * (fraction - 1.0)
        return self.full_tip_position + along * self.tip.direction


def solve_press(config: LabConfig, tip: Tip, number: int, film: Film) -> SolvedPress:
    """Solve a press to the force of a configuration's probe, at several depths.

    Parameters
    ----------
    config : LabConfig
    tip : Tip                       of `aim`
    number : int                    index of the probe, which must have a force
    film : Film                     its number of depths

    Returns
    -------
    SolvedPress

    Raises
    ------
    InputError, MeshError, NotConvergedError    as in `solid_under` and `press_to_force`
    """
    probe, specimen = config.probes[number], config.specimen
    solid = solid_under(specimen, tip, probe, config.material)
    body = specimen_body(config, solid)
    last = press_to_force(body, tip, float(probe.force or 0.0))
    fractions = np.arange(film.depths + 1) / film.depths
    states = press(body, tip, fractions[1:] * last.depth)
    displacements = [np.zeros_like(solid.nodes), *(state.displacement for state in states)]
    force = np.array([np.zeros(3), *(state.force for state in states)])
    return SolvedPress(
        tip,
        probe.point,
        last.radius,
        last.tip_position,
        last.depth,
        fractions,
        force,
        solid,
        np.stack(displacements),
    )


def gauge_readings(
    film: Film, presses: Sequence[SolvedPress], *, rng: np.random.Generator
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """The gauge's log: force of the tool on the body plus weight, drift and noise.

    Parameters
    ----------
    film : Film
    presses : sequence of SolvedPress
    rng : Generator                 of the noise

    Returns
    -------
    time : (n,) float [s]           the gauge's own clock
    force : (n, 3) float [N]
    """
    time = np.arange(0.0, film.duration, 1.0 / film.gauge_rate)
    force = np.zeros((len(time), 3))
    for solved, begin in zip(presses, film.start_times, strict=True):
        force += solved.force_at(film.depth_fraction(time, begin))
    share = time / time[-1]
    course = (share + 0.3 * np.sin(2.0 * np.pi * share))[:, None] * [1.0, -0.7, 1.0]
    noise = film.gauge_noise * rng.standard_normal((len(time), 3))
    return time, force + film.weight + film.drift * course + noise


def rest_pictures(config: LabConfig, rig: Rig, variant: Variant) -> list[Picture]:
    """Noise-free pictures of the object at rest, at twice the resolution of the cameras.

    Parameters
    ----------
    config : LabConfig
    rig : Rig
    variant : Variant               of Mitsuba

    Returns
    -------
    list of (2 rows, 2 columns) float32 [grey levels]   one for each camera
    """
    sharp = replace(config.pictures, noise=0.0, response=0.0, bits=12, samples=9)
    double = Rig(tuple(map(_double_camera, rig.cameras)), rig.reference, rig.source)
    studio = make_studio(
        replace(config, pictures=sharp), double, variant,
        rng=np.random.default_rng([config.seed, 0, 0]),
    )  # fmt: skip
    taken = photograph(studio, [studio.mesh.vertices], rng=np.random.default_rng(2))
    return [picture.astype(np.float32) / 257.0 for picture in taken]


def film_frames(
    film: Film,
    config: LabConfig,
    rig: Rig,
    number: int,
    rest: Picture,
    presses: Sequence[SolvedPress],
    *,
    rng: np.random.Generator,
) -> Iterator[UInt8[np.ndarray, "_ _"]]:
    """Video frames of one camera.

    Parameters
    ----------
    film : Film
    config : LabConfig
    rig : Rig
    number : int                    index of the camera
    rest : (2 rows, 2 columns) float32  its picture of `rest_pictures`
    presses : sequence of SolvedPress
    rng : Generator                 of the noise

    Yields
    ------
    (rows, columns) uint8
    """
    camera = rig.cameras[number]
    fields = [_motion_of(camera, config, solved) for solved in presses]
    last: tuple[int, float] | None = None
    shown = _sensor_picture(rest, config)
    coefficients = spline_filter(rest, order=5, output=np.float32)
    for time in np.arange(film.clock_offset, film.duration, 1.0 / film.frame_rate):
        fractions = [
            float(film.depth_fraction(np.array([time]), begin)[0]) for begin in film.start_times
        ]
        k = int(np.argmax(fractions))
        key = (k, fractions[k]) if fractions[k] > -1.0 else (-1, 0.0)
        if key != last:
            picture = rest
            if key[0] >= 0:
                picture = _warped(coefficients, fields[k](key[1])) if key[1] > 0.0 else rest.copy()
                tip_position = presses[k].tip_position(key[1], film.far)
                picture = _with_rod(picture, camera, presses[k].tip, tip_position, rig)
            last, shown = key, _sensor_picture(picture, config)
        noisy = shown + config.pictures.noise * rng.standard_normal(shown.shape)
        yield np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def write_film(path: Path, frames: Iterator[UInt8[np.ndarray, "_ _"]], rate: float) -> None:
    """Write frames as a lossless video (FFV1).

    Parameters
    ----------
    path : Path                     file name that ends in .avi
    frames : iterator of (rows, columns) uint8, at least one
    rate : float [Hz]

    Raises
    ------
    RecordError                     the file cannot be opened for writing, or a frame was not
                                    written, e.g. to a full disk; no part of the film is left
    """
    first = next(frames)
    code = cv2.VideoWriter.fourcc(*"FFV1")
    writer = cv2.VideoWriter(str(path), code, rate, first.shape[::-1])
    if not writer.isOpened():
        raise RecordError(f"{path}: no video can be written there; check rights and space")
    count, refused = 0, False
    for frame in chain([first], frames):
        # OpenCV returns nothing before version 5; later versions say whether they wrote the frame.
        refused = writer.write(cv2.merge([frame] * 3)) is False
        if refused:
            break
        count += 1
    writer.release()
    # The header names the number of frames only if the whole film was written.
    if refused or _header_frames(path) != count:
        path.unlink(missing_ok=True)
        raise RecordError(
            f"{path}: the film could not be written completely (about {count} frames were); check"
            " the disk's space, and that all frames are of one size"
        )


def _header_frames(path: Path) -> int:
    """Number of frames that a video's header names; 0 for a file that is no whole video."""
    try:
        return video_frame_count(path)
    except RecordError:
        return 0


def _motion_of(camera: Camera, config: LabConfig, solved: SolvedPress) -> CubicSpline:
    """Spline over the depth fraction of the image motion [px] of every second pixel; its values
    have shape (rows / 2, columns / 2, 2)."""
    mesh = config.specimen.mesh
    columns, rows = picture_size(camera)
    seen = surface_map(camera, (rows, columns), mesh.vertices, mesh.triangles).point[::2, ::2]
    known = np.isfinite(seen[..., 0])
    rest = seen[known]
    interpolation = surface_values(solved.solid, rest)
    start = project(camera, rest)
    result = np.zeros((len(solved.displacements), *known.shape, 2), dtype=np.float32)
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    for k, displacement in enumerate(solved.displacements):
        single = np.zeros((*known.shape, 2), dtype=np.float32)
        single[known] = project(camera, rest + interpolation @ displacement) - start
        result[k] = single[nearest[0], nearest[1]]
    return CubicSpline(solved.depth_fraction, result)


def _double_camera(camera: Camera) -> Camera:
    """A camera with pixels of half the size."""
    columns, rows = picture_size(camera)
    matrix = camera.matrix.copy()
    matrix[:2] *= 2.0
    matrix[:2, 2] += 0.5
    return replace(camera, size=(2 * columns, 2 * rows), matrix=matrix)


def _warped(coefficients: Picture, motion: Float[np.ndarray, "_ _ 2"]) -> Picture:
    """A picture at twice the resolution, given by its spline coefficients, warped by a motion field
    at half the resolution.

    The remap functions of image libraries round positions to 1/32 of a pixel, a tenth or more of
    the motion of most of the object.
    """
    rows, columns = coefficients.shape
    field = cv2.resize(
        2.0 * motion.astype(np.float32), (columns, rows), interpolation=cv2.INTER_CUBIC
    )
    y, x = np.mgrid[0:rows, 0:columns].astype(np.float32)
    # The field is sampled at the first pixel of each block, not at the middle of the block.
    onto = np.array([[1, 0, -1], [0, 1, -1]], dtype=np.float32)
    field = cv2.warpAffine(
        field, onto, (columns, rows), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    back = field
    for _ in range(3):
        back = cv2.remap(field, x - back[..., 0], y - back[..., 1], cv2.INTER_LINEAR)
    places = [y - back[..., 1], x - back[..., 0]]
    return map_coordinates(coefficients, places, order=5, mode="nearest", prefilter=False)


def _with_rod(picture: Picture, camera: Camera, tip: Tip, centre: Vector3, rig: Rig) -> Picture:
    """A picture at twice the resolution with the rod drawn over it, in place."""
    outline = project(_double_camera(camera), rod_at(tip, centre, rig.cameras).vertices)
    hull = cv2.convexHull(np.rint(16.0 * outline).astype(np.int32))
    return cv2.fillConvexPoly(picture, hull, (_ROD,), lineType=cv2.LINE_AA, shift=4)


def _sensor_picture(picture: Picture, config: LabConfig) -> Picture:
    """Picture at the camera's resolution, blurred by lens and image sensor, without noise."""
    blurred = cv2.GaussianBlur(picture, (0, 0), 2.0 * config.pictures.response)
    rows, columns = blurred.shape
    return cv2.resize(blurred, (columns // 2, rows // 2), interpolation=cv2.INTER_AREA)

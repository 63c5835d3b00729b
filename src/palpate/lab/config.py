"""Settings of the virtual facility; lengths in metres, angles in degrees.

The limits of a field are in its annotation; `read_lab_config` reads every class field by field.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, get_args, get_type_hints

import numpy as np

from palpate.errors import InputError, quoted
from palpate.geometry import TriangleMesh
from palpate.records import (
    MODULUS_RANGE,
    SLIDES,
    STICKS,
    FlatFace,
    Sphere,
    check_file_names,
)
from palpate.shapes import Indices, Vector3

# Largest size of a picture: that of the largest image sensors; truth maps take 100 bytes a pixel.
_MOST_PIXELS = 1e8
# Constraint on a setting: text for the error message, e.g. "must be positive"; value -> whether it
# satisfies it.
Limit = tuple[str, Callable[[Any], bool]]


def _between(low: float, high: float, unit: str = "") -> Limit:
    return f"must be {low:g} to {high:g} {unit}".rstrip(), lambda x: low <= x <= high


def _no_longer(most: float, unit: str) -> Limit:
    return f"must be {most:g} {unit} long at most", lambda x: bool(np.linalg.norm(x) <= most)


Positive = Annotated[float, ("must be positive", lambda x: 0.0 < x < np.inf)]
Share = Annotated[float, ("must be in 0 to 1", lambda x: 0.0 <= x <= 1.0)]
Length = Annotated[float, _between(1e-6, 100.0, "m")]
# Standard deviations of positions, of rotations and of a sensor's readings.
LengthError = Annotated[float, _between(0.0, 1.0, "m")]
TurnError = Annotated[float, _between(0.0, 45.0, "degrees")]
ReadingError = Annotated[float, _between(0.0, 1e6, "N or m")]
Count = Annotated[int, ("must be 1 to 1000", lambda x: 1 <= x <= 1000)]
Pixels = Annotated[int, ("must be 32 to 20000 px", lambda x: 32 <= x <= 20_000)]
Direction = Annotated[Vector3, ("must be a direction, not zero", lambda x: np.linalg.norm(x) > 0.0)]


class _Limited:
    """Base class of settings: checks every field against the limits in its annotation."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for name, hint in get_type_hints(type(self), include_extras=True).items():
            value = getattr(self, name)
            for part in (hint, *get_args(hint)):
                for text, holds in getattr(part, "__metadata__", ()):
                    if value is not None and not holds(value):
                        raise InputError(f"{name} is {_shown(value)}; {text}")


def _shown(value: Any) -> str:
    """A setting as shown in an error message; an integer may have any number of digits."""
    if isinstance(value, float):
        return f"{value:g}"
    return quoted(value.tolist() if isinstance(value, np.ndarray) else value)


@dataclass(frozen=True, slots=True, eq=False)
class Specimen:
    """The object: its surface, support and element size.

    Parameters
    ----------
    mesh : TriangleMesh             closed, outward normals; the mesh that the session gets
    body : TriangleMesh             surface that is filled with finite elements; for curved
                                    specimens finer than `mesh`
    held : (k,) int                 triangles of `body` that are fixed, or on an elastic foundation
    support : mapping               table [support] of the session
    support_stiffness : float [N/m^3] or None    foundation modulus, traction over displacement;
                                    None: rigid support
    element : float [m]             edge length of the finite elements far from the tip
    """

    mesh: TriangleMesh
    body: TriangleMesh
    held: Indices
    support: Mapping[str, object]
    element: float
    support_stiffness: float | None = None


@dataclass(frozen=True, slots=True)
class Material(_Limited):
    """Material of the specimen.

    Parameters
    ----------
    young_modulus : float [Pa]      1 to 1.2e12
    poisson_ratio : float [-]       -1 < nu < 0.5
    law : "linear" or "neo-hookean" Hooke's law, or finite strain for large displacements

    Raises
    ------
    InputError                      a value out of range, as in all classes of this file
    """

    young_modulus: Annotated[float, _between(*MODULUS_RANGE, "Pa")]
    poisson_ratio: Annotated[float, ("must be in (-1, 0.5)", lambda x: -1.0 < x < 0.5)]
    law: Literal["linear", "neo-hookean"] = "linear"

    @property
    def shear_modulus(self) -> float:
        """G = E / (2 (1 + nu)) [Pa]."""
        return 0.5 * self.young_modulus / (1.0 + self.poisson_ratio)


@dataclass(frozen=True, slots=True)
class Look(_Limited):
    """Appearance of the specimen's surface.

    Parameters
    ----------
    texture : "speckle", "natural" or "poor"
    size : float [m]                1e-6 to 100; diameter of a speckle, or shortest wavelength of
                                    the other textures
    gloss : float [-]               0 to 1; fraction of the reflected light that is specular
    """

    texture: Literal["speckle", "natural", "poor"] = "speckle"
    size: Length = 2e-3
    gloss: Share = 0.0


@dataclass(frozen=True, slots=True)
class Arm(_Limited):
    """The arm and its tip.

    Parameters
    ----------
    tip : "sphere" or "punch"       a punch is flat and round
    radius : float [m]              1e-6 to 100; of the tip
    misalignment : float [degrees]  0 to 45; standard deviation of the tip's direction, about each
                                    of two axes
    placement : float [m]           0 to 1; standard deviation of the contact point, along each of
                                    two tangents; the session holds the commanded point
    sticking : bool                 no slip between tip and surface; else frictionless
    """

    tip: Literal["sphere", "punch"] = "sphere"
    radius: Length = 4.5e-3
    misalignment: TurnError = 0.0
    placement: LengthError = 0.0
    sticking: bool = False

    @property
    def tool(self) -> Sphere | FlatFace:
        """Its tip."""
        kind = Sphere if self.tip == "sphere" else FlatFace
        return kind(self.radius, friction=STICKS if self.sticking else SLIDES)


@dataclass(frozen=True, slots=True, eq=False)
class Sensor(_Limited):
    """Errors of a force sensor, or of the position sensor of the arm or of a stage, per component.

    Parameters
    ----------
    noise : float [N or m]          0 to 1e6; standard deviation
    relative_noise : float [-]      0 to 1; the same, as a fraction of the true vector's length
    bias : (3,) float [N or m]      constant offset, at most 1e6 long
    resolution : float [N or m]     0 to 1e6; readings are integer multiples of it; 0: not rounded
    """

    noise: ReadingError = 0.0
    relative_noise: Share = 0.0
    bias: Annotated[Vector3, _no_longer(1e6, "N or m")] = field(default_factory=lambda: np.zeros(3))
    resolution: ReadingError = 0.0

    def read(self, truth: Vector3, *, rng: np.random.Generator) -> Vector3:
        """Simulated reading of a force, a position or a displacement.

        Parameters
        ----------
        truth : (3,) float [N or m] true value
        rng : Generator             for the noise

        Returns
        -------
        (3,) float [N or m]
        """
        value = truth + self.bias + self._noise_of(truth) * rng.standard_normal(3)
        step = self.resolution
        return step * np.rint(value / step) if step > 0.0 else value

    def std(self, truth: Vector3) -> float:
        """Standard deviation of each component, as the sensor's data sheet would state it.

        Includes the rounding error (resolution / sqrt 12), but not the bias.

        Parameters
        ----------
        truth : (3,) float [N or m] true value

        Returns
        -------
        float [N or m]
        """
        return float(np.hypot(self._noise_of(truth), self.resolution / np.sqrt(12.0)))

    def _noise_of(self, truth: Vector3) -> float:
        """Standard deviation of the noise, without rounding."""
        return float(np.hypot(self.noise, self.relative_noise * np.linalg.norm(truth)))


@dataclass(frozen=True, slots=True, eq=False)
class Probe(_Limited):
    """One probing, to a given depth or to a given force.

    Parameters
    ----------
    name : str
    point : (3,) float [m]          commanded contact point, on the surface
    direction : (3,) float or None  direction of the push, into the body; None: along the normal
    depth : float [m] or None       1e-6 to 100; travel of the tip from first contact
    force : float [N] or None       > 0; final force; exactly one of depth and force is given
    steps : int                     load steps with pictures, the last at full load
    """

    name: str
    point: Vector3
    direction: Direction | None = None
    depth: Length | None = None
    force: Positive | None = None
    steps: Count = 1

    def __post_init__(self) -> None:
        _Limited.__post_init__(self)
        if (self.depth is None) == (self.force is None):
            raise InputError(f"'{self.name}' needs a depth or a force, one of them")


@dataclass(frozen=True, slots=True, eq=False)
class Stage(_Limited):
    """A motion stage that moves the object rigidly, step by step.

    Parameters
    ----------
    steps : int                     number of motions after the first instant
    translation : (3,) float [m]    per step, at most 1 m long
    rotation : float [degrees]      per step, -180 to 180, about `axis` through `centre`
    axis : (3,) float               direction of the rotation axis, non-zero
    centre : (3,) float [m]         a point of the axis, at most 100 m from the origin
    """

    steps: Count
    translation: Annotated[Vector3, _no_longer(1.0, "m")] = field(
        default_factory=lambda: np.zeros(3)
    )
    rotation: Annotated[float, _between(-180.0, 180.0, "degrees")] = 0.0
    axis: Direction = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    centre: Annotated[Vector3, _no_longer(100.0, "m")] = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, slots=True, eq=False)
class Head(_Limited):
    """The cameras.

    Parameters
    ----------
    layout : "trinocular" or "ring" an L: the reference camera, one to its left and one above it;
                                    or `cameras` evenly spaced on a ring about the viewing
                                    direction. All point at the middle of the object
    cameras : int                   number on a ring, 2 to 4
    distance : float [m]            0.01 to 100; from the middle of the object to the head
    baseline : float [m]            1e-6 to 100; from the reference camera to each other one, or
                                    the ring's diameter
    toward : (3,) float             direction from the object to the head, non-zero
    columns, rows : int [px]        32 to 20 000
    focal : float [px] or None      1 to 1e6; None: the object fills three quarters of the picture
    k1 : float [-]                  -1 to 1; radial distortion, negative: barrel
    file : str or None              a rig file to use instead, in the object's frame
    """

    layout: Literal["trinocular", "ring"] = "trinocular"
    cameras: Annotated[int, ("must be 2, 3 or 4", lambda x: x in (2, 3, 4))] = 3
    distance: Annotated[float, _between(0.01, 100.0, "m")] = 0.8
    baseline: Length = 0.1
    toward: Direction = field(default_factory=lambda: np.array([0.3, -0.5, 0.8]))
    columns: Pixels = 640
    rows: Pixels = 480
    focal: Annotated[float, _between(1.0, 1e6, "px")] | None = None
    k1: Annotated[float, _between(-1.0, 1.0)] = 0.0
    file: str | None = None

    def __post_init__(self) -> None:
        _Limited.__post_init__(self)
        if self.columns * self.rows > _MOST_PIXELS:
            raise InputError(
                f"columns x rows is {self.columns} x {self.rows}; must be {_MOST_PIXELS:.0e} pixels"
                " at most"
            )


@dataclass(frozen=True, slots=True)
class Calibration(_Limited):
    """Errors of the session's rig with respect to the rig that took the pictures.

    Standard deviations. Drawn independently for each camera: focal length, relative (0 to 1);
    principal point (0 to 1000 px); rotation (0 to 45 degrees) and translation (0 to 1 m) of the
    camera. Drawn once, common to all cameras: rotation and translation of the object.
    """

    focal: Share = 0.0
    centre: Annotated[float, _between(0.0, 1000.0, "px")] = 0.0
    rotation: TurnError = 0.0
    translation: LengthError = 0.0
    object_rotation: TurnError = 0.0
    object_translation: LengthError = 0.0


@dataclass(frozen=True, slots=True)
class Pictures(_Limited):
    """Exposure, image sensor and lens.

    Parameters
    ----------
    samples : int                   rays per pixel; 9 give less noise than the image sensor has
    noise : float                   read noise, standard deviation, 0 to 255 [grey levels of 255]
    full_well : float or None       electrons at white, > 0; adds shot noise. None: no shot noise
    response : float [px]           0 to 100; blur of lens and sensor, standard deviation
    gain_drift : float [-]          0 to 1; relative standard deviation of the gain from picture to
                                    picture
    bits : int                      8 or 12
    aperture : float [m]            0 to 1; diameter of the lens opening, focused on the middle of
                                    the object; 0: unlimited depth of field
    motion_blur : float [-]         0 to 1; fraction of the step's motion during the exposure
    lamp : float [m]                1e-3 to 100; side of the square lamp: larger is softer shadows
    """

    samples: Count = 9
    noise: Annotated[float, _between(0.0, 255.0, "grey levels")] = 1.5
    full_well: Positive | None = None
    response: Annotated[float, _between(0.0, 100.0, "px")] = 0.6
    gain_drift: Share = 0.0
    bits: Annotated[int, ("must be 8 or 12", lambda x: x in (8, 12))] = 8
    aperture: LengthError = 0.0
    motion_blur: Share = 0.0
    lamp: Annotated[float, _between(1e-3, 100.0, "m")] = 0.2


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LabConfig(_Limited):
    """Configuration of one virtual measurement.

    Parameters
    ----------
    name : str
    seed : int                      seed of all random numbers; 0 to 2^32 - 1
    probes : tuple of Probe         empty if there is a stage
    stage : Stage or None           rigid motions instead of probings

    Raises
    ------
    InputError                      neither probes nor stage, or both; names of probes that files
                                    cannot have or that are not distinct; a support stiffness with a
                                    nonlinear law
    """

    name: str
    seed: Annotated[int, ("must be 0 to 2^32 - 1", lambda x: 0 <= x < 2**32)] = 1
    specimen: Specimen
    material: Material
    look: Look = field(default_factory=Look)
    arm: Arm = field(default_factory=Arm)
    force_sensor: Sensor = field(default_factory=Sensor)
    position_sensor: Sensor = field(default_factory=Sensor)
    probes: tuple[Probe, ...] = ()
    stage: Stage | None = None
    head: Head = field(default_factory=Head)
    calibration: Calibration = field(default_factory=Calibration)
    pictures: Pictures = field(default_factory=Pictures)

    def __post_init__(self) -> None:
        _Limited.__post_init__(self)
        if bool(self.probes) == (self.stage is not None):
            raise InputError("give [[probe]] tables or a [stage], one of them")
        if self.specimen.support_stiffness is not None and self.material.law != "linear":
            raise InputError(
                f"law is '{self.material.law}' and the support has a stiffness; objects on springs"
                " are linear: leave one of them out"
            )
        check_file_names([probe.name for probe in self.probes], what="probing")

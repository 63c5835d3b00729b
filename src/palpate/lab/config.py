"""What the virtual facility is told; lengths in metres, angles in degrees."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.shapes import Indices, Vector3


def _zeros() -> Vector3:
    return np.zeros(3)


@dataclass(frozen=True, slots=True, eq=False)
class Specimen:
    """The object.

    Parameters
    ----------
    mesh : TriangleMesh             closed, outward: what the session gets as the object's mesh
    body : TriangleMesh             surface of what is really pressed: a round specimen is rounder
                                    than the session's mesh of it
    held : (k,) int                 triangles of `body` that do not move
    support : mapping               the table of it that the session gets
    element : float [m]             edge of the finite elements away from the tip
    """

    mesh: TriangleMesh
    body: TriangleMesh
    held: Indices
    support: Mapping[str, object]
    element: float


@dataclass(frozen=True, slots=True)
class Material:
    """What it is made of.

    Parameters
    ----------
    young_modulus : float [Pa]
    poisson_ratio : float           -1 to 0.5
    law : "linear" or "neo-hookean" the second for large motions
    """

    young_modulus: float
    poisson_ratio: float
    law: Literal["linear", "neo-hookean"] = "linear"

    def __post_init__(self) -> None:
        if not self.young_modulus > 0.0:
            raise InputError(f"young_modulus is {self.young_modulus:g}; must be positive, in Pa")
        if not -1.0 < self.poisson_ratio < 0.5:
            raise InputError(f"poisson_ratio is {self.poisson_ratio:g}; must be in (-1, 0.5)")

    @property
    def shear_modulus(self) -> float:
        """G = E / (2 (1 + nu)) [Pa]."""
        return 0.5 * self.young_modulus / (1.0 + self.poisson_ratio)


@dataclass(frozen=True, slots=True)
class Look:
    """How its surface looks.

    Parameters
    ----------
    texture : "speckle", "natural" or "poor"
    size : float [m]                of a speckle, of the finest or of the weak structure
    gloss : float                   share of the light that makes highlights, 0 to 1
    """

    texture: Literal["speckle", "natural", "poor"] = "speckle"
    size: float = 2e-3
    gloss: float = 0.0

    def __post_init__(self) -> None:
        if not self.size > 0.0:
            raise InputError(f"size is {self.size:g} m; must be positive")
        if not 0.0 <= self.gloss <= 1.0:
            raise InputError(f"gloss is {self.gloss:g}; must be in 0 to 1")


@dataclass(frozen=True, slots=True)
class Arm:
    """The arm and its tip.

    Parameters
    ----------
    tip : "sphere" or "punch"       a punch is flat and round
    radius : float [m]              of the tip
    misalignment : float [degrees]  standard deviation of the tip's direction, about each of two
                                    axes
    placement : float [m]           standard deviation of where it touches, along the surface, each
                                    of two directions; the session is told where it was sent
    sticking : bool                 the tip holds what it touches, else the surface slides
    """

    tip: Literal["sphere", "punch"] = "sphere"
    radius: float = 4.5e-3
    misalignment: float = 0.0
    placement: float = 0.0
    sticking: bool = False

    def __post_init__(self) -> None:
        _positive(radius=self.radius)
        _not_negative(misalignment=self.misalignment, placement=self.placement)


@dataclass(frozen=True, slots=True, eq=False)
class ForceSensor:
    """What the force sensor adds to each component.

    Parameters
    ----------
    noise : float [N]               standard deviation
    relative_noise : float          the same, as a share of the force's size
    bias : (3,) float [N]
    resolution : float [N]          readings are whole multiples; 0: any
    """

    noise: float = 0.0
    relative_noise: float = 0.0
    bias: Vector3 = field(default_factory=_zeros)
    resolution: float = 0.0

    def __post_init__(self) -> None:
        _not_negative(
            noise=self.noise, relative_noise=self.relative_noise, resolution=self.resolution
        )


@dataclass(frozen=True, slots=True, eq=False)
class PositionSensor:
    """What the arm's position sensor, or a stage's encoder, adds to each component.

    Parameters
    ----------
    noise : float [m]
    bias : (3,) float [m]
    resolution : float [m]
    """

    noise: float = 0.0
    bias: Vector3 = field(default_factory=_zeros)
    resolution: float = 0.0

    def __post_init__(self) -> None:
        _not_negative(noise=self.noise, resolution=self.resolution)


@dataclass(frozen=True, slots=True, eq=False)
class Probe:
    """One probing: to a depth, or to a force.

    Parameters
    ----------
    name : str
    point : (3,) float [m]          where the arm is sent, on the surface
    direction : (3,) float or None  into the body; along the normal unless told
    depth : float [m] or None       way of the tip from its first touch
    force : float [N] or None       its force in the end
    steps : int                     instants with pictures, the last one at the end
    """

    name: str
    point: Vector3
    direction: Vector3 | None = None
    depth: float | None = None
    force: float | None = None
    steps: int = 1

    def __post_init__(self) -> None:
        if (self.depth is None) == (self.force is None):
            raise InputError(f"'{self.name}' needs a depth or a force, one of them")
        for name in ("depth", "force"):
            if getattr(self, name) is not None:
                _positive(**{name: getattr(self, name)})
        if self.steps < 1:
            raise InputError(f"steps is {self.steps}; must be 1 or more")
        if self.direction is not None and not np.linalg.norm(self.direction) > 0.0:
            raise InputError("direction is zero; must point into the body")


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """A motion stage that carries the object, rigid, from step to step.

    Parameters
    ----------
    steps : int                     besides the first instant
    translation : (3,) float [m]    a step
    rotation : float [degrees]      a step, about `axis` through `centre`
    axis, centre : (3,) float
    """

    steps: int
    translation: Vector3 = field(default_factory=_zeros)
    rotation: float = 0.0
    axis: Vector3 = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    centre: Vector3 = field(default_factory=_zeros)

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise InputError(f"steps is {self.steps}; must be 1 or more")
        if not np.linalg.norm(self.axis) > 0.0:
            raise InputError("axis is zero; must be a direction")


@dataclass(frozen=True, slots=True, eq=False)
class Head:
    """The cameras.

    Parameters
    ----------
    layout : "trinocular" or "ring" an L: reference, one to its left and one above, axes parallel as
                                    far as the object allows; or `cameras` evenly on a ring around
                                    the direction of view
    cameras : int                   of a ring, 2 to 4
    distance : float [m]            from the middle of the object
    baseline : float [m]            between reference and others, or the ring's diameter
    toward : (3,) float             direction from the object to the head
    columns, rows : int [px]
    focal : float [px] or None      unless told such that the object fills three quarters of the
                                    picture
    k1 : float                      barrel (negative) or cushion of the lenses
    file : str or None              a rig of one's own instead, with the object in its frame
    """

    layout: Literal["trinocular", "ring"] = "trinocular"
    cameras: int = 3
    distance: float = 0.8
    baseline: float = 0.1
    toward: Vector3 = field(default_factory=lambda: np.array([0.3, -0.5, 0.8]))
    columns: int = 640
    rows: int = 480
    focal: float | None = None
    k1: float = 0.0
    file: str | None = None

    def __post_init__(self) -> None:
        _positive(distance=self.distance, baseline=self.baseline)
        if not 2 <= self.cameras <= 4:
            raise InputError(f"cameras is {self.cameras}; must be 2, 3 or 4")
        if min(self.columns, self.rows) < 32:
            raise InputError(
                f"pictures are {self.columns} x {self.rows} px; must be at least 32 each way"
            )
        if self.focal is not None:
            _positive(focal=self.focal)
        if not np.linalg.norm(self.toward) > 0.0:
            raise InputError("toward is zero; must point from the object to the head")


@dataclass(frozen=True, slots=True)
class Calibration:
    """By how much the rig that the session is told differs from the one that took the pictures.

    Standard deviations, another error for each camera: of the focal length as a share, the
    principal point [px], the camera's rotation [degrees] and place [m]; and of the object's pose,
    the same for all cameras.
    """

    focal: float = 0.0
    centre: float = 0.0
    rotation: float = 0.0
    translation: float = 0.0
    object_rotation: float = 0.0
    object_translation: float = 0.0

    def __post_init__(self) -> None:
        _not_negative(
            focal=self.focal, centre=self.centre, rotation=self.rotation,
            translation=self.translation, object_rotation=self.object_rotation,
            object_translation=self.object_translation,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Pictures:
    """How pictures are taken.

    Parameters
    ----------
    samples : int                   rays through a pixel; 9 leave less noise than the sensor has
    noise : float                   read noise [grey levels of 255]
    full_well : float or None       electrons at white: their number is noisy too
    response : float [px]           blur of lens and chip, standard deviation
    gain_drift : float              standard deviation of each picture's brightness, as a share
    bits : int                      8 or 12
    aperture : float [m]            of the lens, 0: everything is sharp; sharp at `Head.distance`
    motion_blur : float             share of the motion that falls into the exposure
    lamp : float [m]                side of the lamp: the longer, the softer its shadows
    """

    samples: int = 9
    noise: float = 1.5
    full_well: float | None = None
    response: float = 0.6
    gain_drift: float = 0.0
    bits: int = 8
    aperture: float = 0.0
    motion_blur: float = 0.0
    lamp: float = 0.2

    def __post_init__(self) -> None:
        _positive(lamp=self.lamp)
        _not_negative(
            noise=self.noise, response=self.response, gain_drift=self.gain_drift,
            aperture=self.aperture, motion_blur=self.motion_blur,
        )  # fmt: skip
        if self.samples < 1:
            raise InputError(f"samples is {self.samples}; must be 1 or more")
        if self.bits not in (8, 12):
            raise InputError(f"bits is {self.bits}; must be 8 or 12")


@dataclass(frozen=True, slots=True, eq=False)
class LabConfig:
    """A measurement to be made.

    Parameters
    ----------
    name : str
    seed : int                      every random number comes from it
    probes : tuple of Probe         none where there is a stage
    stage : Stage or None

    Raises
    ------
    InputError                      neither probes nor stage, or both; twin names
    """

    name: str
    seed: int
    specimen: Specimen
    material: Material
    look: Look
    arm: Arm
    force_sensor: ForceSensor
    position_sensor: PositionSensor
    probes: tuple[Probe, ...]
    stage: Stage | None
    head: Head
    calibration: Calibration
    pictures: Pictures

    def __post_init__(self) -> None:
        if bool(self.probes) == (self.stage is not None):
            raise InputError("give [[probe]] tables or a [stage], one of them")
        names = [probe.name for probe in self.probes]
        if twins := {name for name in names if names.count(name) > 1}:
            raise InputError(f"two probes are named '{min(twins)}'; give each its own name")
        if not 0 <= self.seed < 2**32:
            raise InputError(f"seed is {self.seed}; must be 0 to 2^32 - 1")


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{name} is {value:g}; must be positive")


def _not_negative(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value >= 0.0):
            raise InputError(f"{name} is {value:g}; must not be negative")

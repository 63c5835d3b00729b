"""Errors of what was measured: a force sensor with a wrong gain or rotated axes, the scale of
displacements, the pose of the mesh, space that the cameras' calibration stretches."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.errors import quoted
from palpate.estimation.nuisance import NuisanceParameter, ResponseTerms

# Sources in the uncertainty budget, whichever the sensor.
_GAIN, _TURN = "gain of the force sensor", "turn of the force sensor"
_POSE = "pose of the object"


@dataclass(frozen=True, slots=True)
class ForceGain:
    """Gain of the force sensor (`Nuisance`).

    Parameters
    ----------
    std : float [-]                 relative standard deviation, > 0
    sensor : str                    its name; empty where a session has one only
    """

    std: float
    sensor: str = ""

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """One, shared by all probings that this sensor measured."""
        return (NuisanceParameter(_of_sensor(_GAIN, self.sensor), self.std, of=_GAIN),)

    def effects(self, at: ResponseTerms) -> Float[np.ndarray, "r t c 1"]:
        """Response to the force, times `std` (`Nuisance.effects`)."""
        effects = np.zeros((*at.value.shape, 1))
        effects[:, :, :3, 0] = self.std * at.value[:, :, :3]
        return effects


@dataclass(frozen=True, slots=True)
class ForceDirection:
    """Misalignment of the force sensor's axes (`Nuisance`).

    Parameters
    ----------
    std : float [rad]               rotation about each axis of the object's frame, > 0
    measured : (3,) bool            components that the sensor measured; the others are free
                                    unknowns, which a rotation of the sensor does not change
    sensor : str                    its name; empty where a session has one only
    """

    std: float
    measured: tuple[bool, bool, bool] = (True, True, True)
    sensor: str = ""

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """Three, shared by all probings that this sensor measured."""
        names = (f"{_of_sensor(_TURN, self.sensor)} about {axis}" for axis in "xyz")
        return tuple(NuisanceParameter(name, self.std, "rad", _TURN) for name in names)

    def effects(self, at: ResponseTerms) -> Float[np.ndarray, "r t c 3"]:
        """Response to the change of the force in a small rotation (`Nuisance.effects`)."""
        # Entry [k, j, i]: component i of the change of a unit force along j, rotated about k.
        axes = np.eye(3)
        turned = self.std * np.cross(axes[:, None], axes[None]) * np.array(self.measured)
        effects = np.zeros((*at.value.shape, 3))
        effects[:, :, :3] = np.einsum("rti,kji->rtjk", at.value[:, :, :3], turned)
        return effects


@dataclass(frozen=True, slots=True)
class LengthScale:
    """Scale of the measured displacements along x, y and z (`Nuisance`).

    Parameters
    ----------
    std : float [-]                 relative standard deviation along each axis, > 0
    """

    std: float

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """Three, shared by all probings."""
        names = (f"scale of measured displacements along {axis}" for axis in "xyz")
        return tuple(NuisanceParameter(name, self.std, of="scale of lengths") for name in names)

    def effects(self, at: ResponseTerms) -> Float[np.ndarray, "r t c 3"]:
        """The response times `std`, for the parameter of its axis (`Nuisance.effects`)."""
        along = at.rows[:, None] % 3 == np.arange(3)
        return self.std * at.value[..., None] * along[:, None, None]


@dataclass(frozen=True, slots=True, eq=False)
class SpaceStretch:
    """Effect of calibration errors on measured displacements: space is slightly stretched and
    sheared (`Nuisance`).

    Parameters
    ----------
    strains : (p, 3, 3) float [-]   symmetric strain per standard deviation of each of p independent
                                    errors
    points : int                    n; rows from 3 n on were not measured by the cameras
    """

    strains: Float[np.ndarray, "p 3 3"]
    points: int

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """One for each strain, shared by all probings; its std is the strain's Frobenius norm."""
        sizes = np.linalg.norm(self.strains, axis=(1, 2)).tolist()
        return tuple(
            NuisanceParameter(
                f"stretch {k} of space by the cameras' calibration", size, of="camera calibration"
            )
            for k, size in enumerate(sizes, start=1)
        )

    def effects(self, at: ResponseTerms) -> Float[np.ndarray, "r t c p"]:
        """Strains times the response, with components that were not measured taken as zero
        (`Nuisance.effects`)."""
        whole = np.zeros((3 * self.points + 3, *at.value.shape[1:]))
        whole[at.rows] = at.value
        each = whole.reshape(-1, 3, *whole.shape[1:])
        effects = np.einsum("pij,njtc->nitcp", self.strains, each)
        effects[self.points :] = 0.0
        return effects.reshape(len(whole), *effects.shape[2:])[at.rows]


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Pose of the mesh relative to the measured points: translation and rotation (`Nuisance`).

    Parameters
    ----------
    translation, rotation : float [m], [rad]    standard deviation along and about each axis; 0 =
                                                exact
    change : sparse arrays (3 n, 3 v)           one for each parameter: takes the displacement of
                                                the v vertices to its change at the n points, per
                                                standard deviation
    vertices : function                         Poisson's ratio -> (rows, c) float: response of all
                                                vertices, three rows each (`ResponseModel`)
    """

    translation: float
    rotation: float
    change: tuple[csr_array, ...]
    vertices: Callable[[float], Float[np.ndarray, "rows c"]]

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """Six, shared by all probings; three where one of the standard deviations is zero."""
        translations = (
            NuisanceParameter(f"shift of the object along {axis}", self.translation, "m", _POSE)
            for axis in "xyz"
        )
        rotations = (
            NuisanceParameter(f"turn of the object about {axis}", self.rotation, "rad", _POSE)
            for axis in "xyz"
        )
        return tuple(each for each in (*translations, *rotations) if each.std > 0.0)

    def effects(self, at: ResponseTerms) -> Float[np.ndarray, "r 1 c p"]:
        """Change of the response as the points move within the field (`Nuisance.effects`)."""
        # Rows of a measured contact point follow those of the vertices.
        field = self.vertices(at.poisson_ratio)[: self.change[0].shape[1]]
        moved = np.stack([change @ field for change in self.change], axis=2)
        # The contact point moves with the tool, not with the mesh.
        tip = np.zeros((3, *moved.shape[1:]))
        return np.concatenate([moved, tip])[at.rows][:, None]


def _of_sensor(source: str, sensor: str) -> str:
    """Name of an error of a force sensor, such as "gain of the force sensor 'weights'"."""
    return f"{source} {quoted(sensor)}" if sensor else source

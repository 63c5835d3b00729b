"""Errors of what was measured: a force sensor with a wrong gain or rotated axes, the scale of
displacements, the pose of the mesh, space that the cameras' calibration stretches."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.errors import quoted
from palpate.estimation import Nuisance, NuisanceParameter, ResponseTerms

# Sources in the uncertainty budget, whichever the sensor.
_GAIN, _TURN = "gain of the force sensor", "turn of the force sensor"
_POSE = "pose of the object"


def force_gain(std: float, sensor: str = "") -> Nuisance:
    """Gain of the force sensor, one parameter for all probings that it measured.

    Parameters
    ----------
    std : float [-]                 relative standard deviation, > 0
    sensor : str                    its name; empty where a session has one only

    Returns
    -------
    Nuisance
    """

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r t c 1"]:
        moved = np.zeros((*at.value.shape, 1))
        moved[:, :, :3, 0] = std * at.value[:, :, :3]
        return moved

    return Nuisance((NuisanceParameter(_of_sensor(_GAIN, sensor), std, of=_GAIN),), effects)


def force_direction(
    std: float, measured: Sequence[bool] = (True, True, True), sensor: str = ""
) -> Nuisance:
    """Misalignment of the force sensor's axes, three parameters for all probings that it measured.

    Parameters
    ----------
    std : float [rad]               rotation about each axis of the object's frame, > 0
    measured : three bool           components that the sensor measured; the others are free
                                    unknowns, which a rotation of the sensor does not change
    sensor : str                    its name; empty where a session has one only

    Returns
    -------
    Nuisance
    """
    # Entry [k, j, i]: component i of the change of a unit force along j, rotated about k.
    axes = np.eye(3)
    turned = std * np.cross(axes[:, None], axes[None]) * np.array(measured)

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r t c 3"]:
        moved = np.zeros((*at.value.shape, 3))
        moved[:, :, :3] = np.einsum("rti,kji->rtjk", at.value[:, :, :3], turned)
        return moved

    names = (f"{_of_sensor(_TURN, sensor)} about {axis}" for axis in "xyz")
    return Nuisance(tuple(NuisanceParameter(name, std, "rad", _TURN) for name in names), effects)


def length_scale(std: float) -> Nuisance:
    """Scale of the measured displacements along x, y and z, for all probings.

    Parameters
    ----------
    std : float [-]                 relative standard deviation along each axis, > 0

    Returns
    -------
    Nuisance
    """

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r t c 3"]:
        along = at.rows[:, None] % 3 == np.arange(3)
        return std * at.value[..., None] * along[:, None, None]

    names = (f"scale of measured displacements along {axis}" for axis in "xyz")
    return Nuisance(
        tuple(NuisanceParameter(name, std, of="scale of lengths") for name in names), effects
    )


def space_stretch(strains: Float[np.ndarray, "p 3 3"], points: int) -> Nuisance:
    """Effect of calibration errors on measured displacements: space is slightly stretched and
    sheared, the same in all probings.

    Parameters
    ----------
    strains : (p, 3, 3) float [-]   symmetric strain per standard deviation of each of p independent
                                    errors; the std of each is its Frobenius norm
    points : int                    n; rows from 3 n on were not measured by the cameras

    Returns
    -------
    Nuisance
    """

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r t c p"]:
        # Components that were not measured are taken as zero.
        whole = np.zeros((3 * points + 3, *at.value.shape[1:]))
        whole[at.rows] = at.value
        each = whole.reshape(-1, 3, *whole.shape[1:])
        moved = np.einsum("pij,njtc->nitcp", strains, each)
        moved[points:] = 0.0
        return moved.reshape(len(whole), *moved.shape[2:])[at.rows]

    sizes = np.linalg.norm(strains, axis=(1, 2)).tolist()
    parameters = (
        NuisanceParameter(
            f"stretch {k} of space by the cameras' calibration", size, of="camera calibration"
        )
        for k, size in enumerate(sizes, start=1)
    )
    return Nuisance(tuple(parameters), effects)


def pose_error(
    translation: float,
    rotation: float,
    change: Sequence[csr_array],
    vertices: Callable[[float], Float[np.ndarray, "rows c"]],
) -> Nuisance:
    """Pose of the mesh relative to the measured points, the same in all probings.

    Parameters
    ----------
    translation, rotation : float [m], [rad]    standard deviation along and about each axis; 0 =
                                                exact
    change : sparse arrays (3 n, 3 v)           one for each parameter: takes the displacement of
                                                the v vertices to its change at the n points, per
                                                standard deviation
    vertices : function                         Poisson's ratio -> (rows, c) float: response of all
                                                vertices, three rows each (`ResponseModel`)

    Returns
    -------
    Nuisance                                    of six parameters; of three where one of the
                                                standard deviations is zero
    """

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r 1 c p"]:
        # Rows of a measured contact point follow those of the vertices.
        field = vertices(at.poisson_ratio)[: change[0].shape[1]]
        moved = np.stack([each @ field for each in change], axis=2)
        # The contact point moves with the tool, not with the mesh.
        tip = np.zeros((3, *moved.shape[1:]))
        return np.concatenate([moved, tip])[at.rows][:, None]

    translations = (
        NuisanceParameter(f"shift of the object along {axis}", translation, "m", _POSE)
        for axis in "xyz"
    )
    rotations = (
        NuisanceParameter(f"turn of the object about {axis}", rotation, "rad", _POSE)
        for axis in "xyz"
    )
    every = (*translations, *rotations)
    return Nuisance(tuple(each for each in every if each.std > 0.0), effects)


def _of_sensor(source: str, sensor: str) -> str:
    """Name of an error of a force sensor, such as "gain of the force sensor 'weights'"."""
    return f"{source} {quoted(sensor)}" if sensor else source

"""The errors shared by points and probings of a session, as nuisance parameters.

Of the measurement: a force sensor with a wrong gain or rotated axes, the scale of displacements,
the pose of the mesh, space that the cameras' calibration stretches. Of the contact: the tool
pressed off the stated point, or on a smaller or larger patch; it slid along the surface. Of the
model: the compliance of supports.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Float

from palpate.errors import quoted
from palpate.estimation import (
    Nuisance,
    NuisanceParameter,
    ProbeObservations,
    ResponseTerms,
    fixed_displacement,
)
from palpate.pipeline.model.object_model import ObjectModel
from palpate.pipeline.model.pose import PoseChanges, pose_dips, pose_error
from palpate.pipeline.model.responses import ProbeResponse, compliance_error
from palpate.probe import named_tangents
from palpate.records import SLIDES, Probing, Session, covariance_file, read_rig, read_rig_covariance
from palpate.shapes import Points
from palpate.vision import space_strains

# A component's std over the effect of the sensor's rotation, above which that adds at most 0.5 %.
_LARGE_STD = 10.0
# Sources in the uncertainty budget, whichever the sensor.
_GAIN, _TURN = "gain of the force sensor", "turn of the force sensor"


def shared_errors(
    model: ObjectModel,
    index: int,
    response: ProbeResponse,
    change: PoseChanges | None,
    vertices: Callable[[float], Float[np.ndarray, "v c"]],
) -> tuple[Nuisance, ...]:
    """Nuisance parameters of one probing.

    Parameters
    ----------
    model : ObjectModel
    index : int                     of the probing
    response : ProbeResponse        of the probing
    change : PoseChanges or None    `pose_changes` of its points
    vertices : function             response of all vertices to its loads

    Returns
    -------
    tuple of Nuisance               those with a prior standard deviation above zero
    """
    priors, nuisances = model.session.errors, list[Nuisance]()
    probing = model.session.probings[index]
    pushed, gain = bool(probing.force.any()), priors.gain_std(probing.force_sensor)
    if gain > 0.0 and pushed:
        nuisances.append(force_gain(gain, probing.force_sensor))
    if priors.force_direction > 0.0 and pushed:
        measured = _measured_components(probing, priors.force_direction)
        nuisances.append(force_direction(priors.force_direction, measured, probing.force_sensor))
    if priors.length_scale > 0.0:
        nuisances.append(length_scale(priors.length_scale))
    if change is not None and probing.displacement is not None:
        dips = pose_dips(model, response, probing.displacement.surface, change)
        nuisances.append(
            pose_error(priors.pose_translation, priors.pose_rotation, change, vertices, dips)
        )
    nuisances += _contact_errors(model, index, response)
    nuisances += _tool_slip(model, index, response)
    if priors.tool_compliance > 0.0 and probing.tip_displacement is not None:
        at_points = np.zeros((response.rows.n_points, 3))
        forces = np.concatenate([at_points, probing.force[None]])
        nuisances.append(tool_compliance(priors.tool_compliance, forces))
    if model.springs is not None:
        nuisances += filter(None, [compliance_error(model, response)])
    return tuple(nuisances)


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


def contact_error(
    parameters: tuple[NuisanceParameter, ...],
    steps: Float[np.ndarray, "m p"],
    change: Callable[[float], Float[np.ndarray, "n_rows m"]],
    count: int,
) -> Nuisance:
    """Error in position and radius of one probing's contact, from the changes that perturbed
    contacts cause.

    Its standard deviation is about a tenth of the tool's size, and errors of two or three standard
    deviations occur: at points close to the tool the second-order effect is then as large as the
    first-order one. Derivatives are those of the interpolating polynomial, which has as many terms
    as there are perturbed contacts.

    Parameters
    ----------
    parameters : tuple of p NuisanceParameter
    steps : (m, p) float            offset of each of m perturbed contacts from the stated one, in
                                    standard deviations of each parameter
    change : function               Poisson's ratio -> (n_rows, m) float [m Pa]: displacement times
                                    shear modulus for each of these, minus that for the stated one,
                                    under the measured force
    count : int                     number of points; rows after theirs belong to the tip, which
                                    moves with the contact: to first order only

    Returns
    -------
    Nuisance
    """
    p = len(parameters)
    pairs = [
        pair for pair in combinations_with_replacement(range(p), 2) if _is_determined(steps, *pair)
    ]
    products = [steps[:, i] * steps[:, j] / (1 + (i == j)) for i, j in pairs]
    weights = np.linalg.inv(np.column_stack([steps, *products])).T
    first, second = weights[:, :p], np.zeros((len(steps), p, p))
    for weight, (i, j) in zip(weights[:, p:].T, pairs, strict=True):
        second[:, i, j] = second[:, j, i] = weight

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r 1 c p"]:
        moved = np.zeros((len(at.rows), 1, at.value.shape[2], p))
        # Entry 3 of the load is 1 / G.
        moved[:, 0, 3] = change(at.poisson_ratio)[at.rows] @ first
        return moved

    def curvature(at: ResponseTerms) -> Float[np.ndarray, "r p p"]:
        bent = np.tensordot(change(at.poisson_ratio)[at.rows], second, axes=1)
        bent[at.rows >= 3 * count] = 0.0
        return np.asarray(bent)

    return Nuisance(parameters, effects, curvature)


def tool_slip(
    parameters: tuple[NuisanceParameter, NuisanceParameter],
    tangents: Float[np.ndarray, "2 3"],
    count: int,
) -> Nuisance:
    """Sliding of the tool of one probing along the surface: the tool's displacement, which the arm
    measures, is that of the surface along the normal only.

    Parameters
    ----------
    parameters : tuple of 2 NuisanceParameter       one along each tangent
    tangents : (2, 3) float [-]                     unit tangents of the surface under the tool
    count : int                                     as `contact_error`

    Returns
    -------
    Nuisance
    """

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r 2 c 2"]:
        component = at.rows - 3 * count
        columns = np.zeros((len(at.rows), 2))
        columns[component >= 0] = tangents.T[component[component >= 0]]
        return fixed_displacement(columns * [parameter.std for parameter in parameters], at)

    return Nuisance(parameters, effects)


def tool_compliance(std: float, force: Points) -> Nuisance:
    """Compliance of arm, tool and base, whose deflection is part of the tool's displacement: one
    parameter for all probings.

    Parameters
    ----------
    std : float [m/N]               > 0
    force : (p, 3) float [N]        of the tool at each point of a probing; zero where it is not
                                    the tool that was observed

    Returns
    -------
    Nuisance
    """

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r 2 c 1"]:
        return fixed_displacement(std * force.reshape(-1, 1)[at.rows], at)

    return Nuisance((NuisanceParameter("compliance of arm, tool and base", std, "m/N"),), effects)


def calibration_strains(session: Session) -> Float[np.ndarray, "m 3 3"] | None:
    """Apparent strains of measured space at the object from errors of the camera calibration.

    Parameters
    ----------
    session : Session

    Returns
    -------
    (m, 3, 3) float [-] or None     as `space_strains`; None without a rig, or without the file of
                                    its covariance beside it

    Raises
    ------
    RecordError, CalibrationError   a rig or a covariance that cannot be read, or that do not belong
                                    together
    """
    file = None if session.rig is None else covariance_file(session.rig)
    if session.rig is None or file is None:
        return None
    return space_strains(read_rig(session.rig), read_rig_covariance(file), session.mesh.vertices)


def with_stretch(
    observations: Sequence[ProbeObservations], strains: Float[np.ndarray, "m 3 3"] | None
) -> list[ProbeObservations]:
    """Observations with calibration errors as further nuisance parameters.

    Parameters
    ----------
    observations : sequence of ProbeObservations
    strains : (m, 3, 3) float or None    of `calibration_strains`

    Returns
    -------
    list of ProbeObservations
    """
    if strains is None:
        return list(observations)
    return [
        replace(probe, nuisances=(*probe.nuisances, _space_stretch(strains, len(probe.position))))
        for probe in observations
    ]


def length_error(session: Session, strains: Float[np.ndarray, "m 3 3"] | None) -> dict[str, object]:
    """Source and size of the relative error of lengths along x, y and z, for the result's settings.

    Parameters
    ----------
    session : Session
    strains : (m, 3, 3) float or None    of `calibration_strains`

    Returns
    -------
    dict                            source (text) and std (three floats)
    """
    if strains is None:
        return {"source": "[errors] length_scale", "std": [session.errors.length_scale] * 3}
    along = np.linalg.norm(np.einsum("mii->mi", strains), axis=0)
    total = np.hypot(along, session.errors.length_scale)
    return {"source": "rig_covariance.npz", "std": total.tolist()}


def _contact_errors(model: ObjectModel, index: int, response: ProbeResponse) -> list[Nuisance]:
    """Errors of one probing's contact, and of the mesh about it."""
    offsets = [
        perturbation.steps
        for perturbation in model.loads.perturbations
        if perturbation.probing == index
    ]
    if not offsets:
        return []
    parameters = tuple(dict.fromkeys(parameter for steps in offsets for parameter in steps))
    steps = np.array(
        [[offset.get(parameter, 0.0) for parameter in parameters] for offset in offsets]
    )
    count = response.rows.n_points
    return [contact_error(parameters, steps, response.change, count)]


def _tool_slip(model: ObjectModel, index: int, response: ProbeResponse) -> list[Nuisance]:
    """Slip of a tool that slides and whose displacement was measured: up to its contact radius."""
    probing = model.session.probings[index]
    tool, patch = probing.contact.tool, model.loads.patch_of[index]
    if probing.tip_displacement is None or tool is None or tool.friction != SLIDES or patch < 0:
        return []
    tangents, names = named_tangents(model.session.mesh, list(model.loads.patches.values())[patch])
    first, second = (
        NuisanceParameter(
            f"slip of the tool in {probing.name} toward {name}",
            probing.contact.reach,
            "m",
            "slips of tools",
        )
        for name in names
    )
    return [tool_slip((first, second), tangents, response.rows.n_points)]


def _measured_components(probing: Probing, rotation: float) -> tuple[bool, bool, bool]:
    """Components of a force that were measured: those whose standard deviation is not so large that
    a rotation of the sensor is negligible."""
    if probing.force_std is None:
        return (True, True, True)
    largest_std = _LARGE_STD * rotation * float(np.linalg.norm(probing.force))
    x, y, z = (bool(std <= largest_std) for std in probing.force_std)
    return x, y, z


def _space_stretch(strains: Float[np.ndarray, "p 3 3"], points: int) -> Nuisance:
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
        vectors = whole.reshape(-1, 3, *whole.shape[1:])
        moved = np.einsum("pij,njtc->nitcp", strains, vectors)
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


def _of_sensor(source: str, sensor: str) -> str:
    """Name of an error of a force sensor, such as "gain of the force sensor 'weights'"."""
    return f"{source} {quoted(sensor)}" if sensor else source


def _is_determined(steps: Float[np.ndarray, "m p"], i: int, j: int) -> bool:
    """Whether the perturbed contacts determine the second-order term of two parameters."""
    if i == j:
        return bool(np.unique(steps[np.flatnonzero(steps[:, i]), i]).size > 1)
    return bool((steps[:, i] * steps[:, j]).any())

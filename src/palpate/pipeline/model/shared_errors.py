"""The errors shared by points and probings of a session, as nuisance parameters.

Of the measurement: a force sensor with a wrong gain or rotated axes, the scale of displacements,
the pose of the mesh, space that the cameras' calibration stretches. Of the contact: the tool
pressed off the stated point, or on a smaller or larger patch; it slid along the surface. Of the
model: the compliance of supports.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from palpate.errors import quoted
from palpate.estimation import (
    Nuisance,
    NuisanceParameter,
    ProbeObservations,
    ResponseTerms,
    fixed_displacement,
)
from palpate.geometry import SurfacePoints, interpolation_matrix
from palpate.pipeline.model.object_model import ObjectModel
from palpate.pipeline.model.responses import ProbeResponse, compliance_error
from palpate.pipeline.model.supports import rigid_modes
from palpate.probe import named_tangents
from palpate.records import SLIDES, Probing, Session, covariance_file, read_rig, read_rig_covariance
from palpate.shapes import Points
from palpate.vision import space_strains

# A component's std over the effect of the sensor's rotation, above which that adds at most 0.5 %.
_LARGE_STD = 10.0
# Small rotations about x, y and z.
_TURNS = np.stack([np.cross(axis, np.eye(3)).T for axis in np.eye(3)])
# Barycentric coordinates along two sides of a triangle.
_SIDES = np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
Response = Callable[[float], Float[np.ndarray, "v c"]]
# Sources in the uncertainty budget, whichever the sensor.
_GAIN, _TURN = "gain of the force sensor", "turn of the force sensor"
_POSE = "pose of the object"


@dataclass(frozen=True, slots=True, eq=False)
class PoseChanges:
    """Change of the displacements at points, from those of the vertices, with the pose of the mesh,
    per standard deviation of each of p parameters.

    Where the mesh is shifted by d relative to the points, its displacement is evaluated at x - d; a
    rotation also rotates the displacements.

    Attributes
    ----------
    here : (n, v) sparse            takes displacements of the v vertices to those at the n points
    slopes : two (n, v) sparse      takes them to their derivatives along two sides of the triangles
    shifts : (p, n, 2) float [-]    by how much of these sides the points are shifted
    turns : (p, 3, 3) float         takes displacements at the points to their change with the turn
    """

    here: csr_array
    slopes: tuple[csr_array, csr_array]
    shifts: Float[np.ndarray, "p n 2"]
    turns: Float[np.ndarray, "p 3 3"]

    def at(self, points: Int[np.ndarray, " m"]) -> "PoseChanges":
        """Of some of the points."""
        first, second = self.slopes
        return PoseChanges(
            self.here[points], (first[points], second[points]), self.shifts[:, points], self.turns
        )

    def of(self, vertices: Float[np.ndarray, "rows c"]) -> Float[np.ndarray, "r c p"]:
        """Change of the displacements at the points, (3 n, c, p).

        Parameters
        ----------
        vertices : (rows, c) float  of the vertices, three rows each; further rows are left out
        """
        points, count = self.here.shape
        columns = vertices.shape[1]
        # Components of one vertex in a row: all are interpolated alike.
        field = vertices[: 3 * count].reshape(count, -1)
        here = (self.here @ field).reshape(points, 3, columns)
        slopes = np.stack([slope @ field for slope in self.slopes], axis=2)
        shifted = (slopes @ self.shifts.transpose(1, 2, 0)).reshape(*here.shape, -1)
        turned = np.moveaxis(self.turns[:, None] @ here, 0, 3)
        return (shifted + turned).reshape(3 * points, columns, -1)


def shared_errors(
    model: ObjectModel,
    index: int,
    response: ProbeResponse,
    change: PoseChanges | None,
    vertices: Response,
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
        dips = _pose_dips(model, response, probing.displacement.surface)
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


def pose_changes(model: ObjectModel, points: SurfacePoints) -> PoseChanges | None:
    """Changes of the displacements at points with the pose of the mesh: with three translations,
    then with three rotations, without those whose prior is exact.

    Parameters
    ----------
    model : ObjectModel
    points : SurfacePoints          of n points

    Returns
    -------
    PoseChanges or None             None: the pose is exact
    """
    stds = _pose_stds(model.session)
    chosen = np.flatnonzero(stds)
    if not chosen.size:
        return None
    nodes, place = model.system.surface.displacement, points.barycentric

    def at(barycentric: Float[np.ndarray, "n 3"]) -> csr_array:
        return interpolation_matrix(nodes, points.triangle, barycentric)

    # Of quadratic shape functions a central difference is the derivative, whatever its step.
    first, second = (csr_array(at(place + half) - at(place - half)) for half in 0.5 * _SIDES)
    turns = np.concatenate([np.zeros((3, 3, 3)), _TURNS]) * stds[:, None, None]
    return PoseChanges(at(place), (first, second), _shifts(model, points), turns[chosen])


def pose_dips(
    model: ObjectModel, points: SurfacePoints, columns: Int[np.ndarray, " c"]
) -> Float[np.ndarray, "p 2 r c"]:
    """Change with the pose of what vertices miss of the dips about contacts; see `pose_changes`.

    Parameters
    ----------
    model : ObjectModel
    points : SurfacePoints          of n points
    columns : (c,) int              of the loads

    Returns
    -------
    (p, 2, 3 n, c) float [m Pa]     displacement times shear modulus, constant and slope in nu,
                                    for each of the p parameters
    """
    surface, stds = model.system.surface, _pose_stds(model.session)
    chosen, count = np.flatnonzero(stds), 3 * points.triangle.size
    missed = model.loads.missed_indentation(surface, columns, *_beside(model, points))
    missed = missed.reshape(2, 2, chosen.size, count, -1)
    change = np.moveaxis(missed[:, 0] - missed[:, 1], 1, 0)
    here = model.loads.missed_indentation(surface, columns, points.triangle, points.barycentric)
    for row, k in enumerate(chosen):
        if k >= 3:
            turned = _TURNS[k - 3] @ here.reshape(2, count // 3, 3, -1)
            change[row] += stds[k] * turned.reshape(2, count, -1)
    return change


def _pose_stds(session: Session) -> Float[np.ndarray, "6"]:
    """Standard deviations of three translations [m], then of three rotations [rad]."""
    priors = session.errors
    return np.repeat([priors.pose_translation, priors.pose_rotation], 3)


def _shifts(model: ObjectModel, points: SurfacePoints) -> Float[np.ndarray, "p n 2"]:
    """Shift of points relative to the mesh, if that is off by a standard deviation of each of p
    poses, over two sides of their triangles; its part normal to these has no effect."""
    mesh, stds = model.session.mesh, _pose_stds(model.session)
    chosen = np.flatnonzero(stds)
    modes = rigid_modes(points.position, mesh.vertices.mean(axis=0))[:, :, chosen] * stds[chosen]
    sides = _SIDES @ mesh.vertices[mesh.triangles[points.triangle]]
    return -np.moveaxis(np.linalg.pinv(sides.swapaxes(1, 2)) @ modes, 2, 0)


def _beside(
    model: ObjectModel, points: SurfacePoints
) -> tuple[Int[np.ndarray, " q"], Float[np.ndarray, "q 3"]]:
    """Triangles and barycentric coordinates of where points lie if the mesh is off by half a
    standard deviation of each of p poses one way, then the other; 2 p n points in all."""
    half = 0.5 * _shifts(model, points) @ _SIDES
    sides = np.concatenate([points.barycentric + half, points.barycentric - half]).reshape(-1, 3)
    return np.tile(points.triangle, 2 * len(half)), sides


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


def pose_error(
    translation: float,
    rotation: float,
    change: PoseChanges,
    vertices: Callable[[float], Float[np.ndarray, "rows c"]],
    dips: Callable[[float], Float[np.ndarray, "p r t"]],
) -> Nuisance:
    """Pose of the mesh relative to the measured points, the same in all probings.

    Parameters
    ----------
    translation, rotation : float [m], [rad]    standard deviation along and about each axis; 0 =
                                                exact
    change : PoseChanges                        of n points, for each parameter
    vertices : function                         Poisson's ratio -> (rows, c) float: response of all
                                                vertices, three rows each (`ResponseModel`)
    dips : function                             Poisson's ratio -> (p, 3 n, t) float: further change
                                                of the first t columns, per standard deviation

    Returns
    -------
    Nuisance                                    of six parameters; of three where one of the
                                                standard deviations is zero
    """

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r 1 c p"]:
        # Rows of a measured contact point follow those of the vertices.
        moved = change.of(vertices(at.poisson_ratio))
        further = dips(at.poisson_ratio)
        moved[:, : further.shape[2]] += np.moveaxis(further, 0, 2)
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
    return Nuisance(tuple(parameter for parameter in every if parameter.std > 0.0), effects)


def _pose_dips(
    model: ObjectModel, response: ProbeResponse, points: SurfacePoints
) -> Callable[[float], Float[np.ndarray, "p r 4"]]:
    """`pose_dips` at a probing's points under its loads, as a function of Poisson's ratio."""
    rows = response.rows
    shifted = pose_dips(model, points, rows.columns[: len(rows.columns) - rows.changes])
    return lambda nu: np.stack([rows.of_loads(dips, nu) for dips in shifted])


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

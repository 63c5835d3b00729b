"""The errors shared by points and probings of a session, as nuisance parameters."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array, kron

from palpate.estimation import Nuisance, NuisanceParameter
from palpate.geometry import SurfacePoints, interpolation_matrix
from palpate.pipeline.model.contacts.contact_errors import contact_error, tool_slip
from palpate.pipeline.model.contacts.perturbations import named_tangents
from palpate.pipeline.model.measurement_errors import (
    force_direction,
    force_gain,
    length_scale,
    pose_error,
)
from palpate.pipeline.model.moving_supports import rigid_modes
from palpate.pipeline.model.object_model import ObjectModel
from palpate.pipeline.model.responses import ProbeResponse
from palpate.pipeline.model.spring_responses import compliance_error
from palpate.records import SLIDES, Probing

# A component's std over the effect of the sensor's rotation, above which that adds at most 0.5 %.
_LARGE_STD = 10.0
Response = Callable[[float], Float[np.ndarray, "v c"]]


def shared_errors(
    model: ObjectModel,
    index: int,
    response: ProbeResponse,
    change: Sequence[csr_array],
    vertices: Response,
) -> tuple[Nuisance, ...]:
    """Nuisance parameters of one probing.

    Parameters
    ----------
    model : ObjectModel
    index : int                     of the probing
    response : ProbeResponse        of the probing
    change : sequence of csr_array  `pose_changes` of its points
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
    if change:
        nuisances.append(
            pose_error(priors.pose_translation, priors.pose_rotation, change, vertices)
        )
    nuisances += _contact_errors(model, index, response)
    nuisances += _tool_slip(model, index, response)
    if model.springs is not None:
        nuisances += filter(None, [compliance_error(model, response)])
    return tuple(nuisances)


def _contact_errors(model: ObjectModel, index: int, response: ProbeResponse) -> list[Nuisance]:
    """Errors of one probing's contact, and of the mesh about it."""
    own = [each.steps for each in model.loads.perturbations if each.probing == index]
    if not own:
        return []
    parameters = tuple(dict.fromkeys(parameter for steps in own for parameter in steps))
    steps = np.array([[each.get(parameter, 0.0) for parameter in parameters] for each in own])
    count = response.rows.surface.shape[0] // 3
    return [contact_error(parameters, steps, response.change, count)]


def _tool_slip(model: ObjectModel, index: int, response: ProbeResponse) -> list[Nuisance]:
    """Slip of a tool whose displacement was measured, where it slides: by as much as it touches."""
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
    return [tool_slip((first, second), tangents, response.rows.surface.shape[0] // 3)]


def _measured_components(probing: Probing, rotation: float) -> tuple[bool, bool, bool]:
    """Components of a force that were measured: those whose standard deviation is not so large that
    a rotation of the sensor is negligible."""
    if probing.force_std is None:
        return (True, True, True)
    largest_std = _LARGE_STD * rotation * float(np.linalg.norm(probing.force))
    x, y, z = (bool(std <= largest_std) for std in probing.force_std)
    return x, y, z


def pose_changes(model: ObjectModel, place: SurfacePoints) -> list[csr_array]:
    """Change of the displacements at points, from those of the vertices, with the pose of the mesh.

    Where the mesh is shifted by d relative to the points, its displacement is evaluated at x - d; a
    rotation also rotates the displacements.

    Parameters
    ----------
    model : ObjectModel
    place : SurfacePoints           of n points

    Returns
    -------
    list of (3 n, 3 v) sparse       per standard deviation of three translations, then of three
                                    rotations; without those whose prior is exact
    """
    mesh, priors = model.session.mesh, model.session.errors
    stds = np.array([priors.pose_translation] * 3 + [priors.pose_rotation] * 3)
    chosen = np.flatnonzero(stds)
    if not chosen.size:
        return []
    nodes, count = model.system.surface.displacement, place.triangle.size
    modes = rigid_modes(place.position, mesh.vertices.mean(axis=0))[:, :, chosen] * stds[chosen]
    corner = mesh.vertices[mesh.triangles[place.triangle]]
    # From a shift to the change of barycentric coordinates; its normal component has no effect.
    inverse = np.linalg.pinv(
        np.stack([corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]], 2)
    )
    two = -0.5 * np.einsum("nij,njk->kni", inverse, modes)
    half = np.concatenate([-two.sum(axis=2, keepdims=True), two], axis=2)
    # Central difference of the element's quadratic shape functions about the point.
    sides = np.concatenate([place.barycentric + half, place.barycentric - half]).reshape(-1, 3)
    both = interpolation_matrix(nodes, np.tile(place.triangle, 2 * chosen.size), sides)
    changes = both[: chosen.size * count] - both[chosen.size * count :]
    at_points = interpolation_matrix(nodes, place.triangle, place.barycentric)
    sparse = []
    for row, k in enumerate(chosen):
        change = kron(changes[row * count : (row + 1) * count], np.eye(3))
        if k >= 3:
            rotation = stds[k] * np.cross(np.eye(3)[k - 3], np.eye(3)).T
            change = change + kron(at_points, rotation)
        sparse.append(csr_array(change))
    return sparse

"""Observations of each probing as functions of the model's solutions: displacements of its points
and its tip, motions of supports."""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array, hstack, kron

from palpate.bem import BodyForce, BoundarySystem
from palpate.estimation import PointRows, ProbeMotions, ProbeRows
from palpate.geometry import SurfacePoints, closest_points, interpolation_matrix
from palpate.pipeline.model.compliant_supports import springs_at, support_force
from palpate.pipeline.model.object_model import ContactPoints, ObjectModel, contact_key
from palpate.records import RIGID, SurfaceAverage


def probe_rows(
    model: ObjectModel,
    index: int,
    place: SurfacePoints,
    *,
    average: SurfaceAverage | None = None,
    perturbed: bool = True,
) -> ProbeRows:
    """Observations of a probing, and the right-hand sides that they depend on.

    Parameters
    ----------
    model : ObjectModel
    index : int                       of the probing in its session
    place : SurfacePoints             observed points
    average : SurfaceAverage or None  average that is observed; None: displacement at the points
    perturbed : bool                  False: without the columns of perturbed contacts

    Returns
    -------
    ProbeRows
    """
    perturbations = _own_perturbations(model, index)[: None if perturbed else 0]
    columns, known_loads = _columns(model, index, perturbations)
    observed = _observed(model, place, average)
    particular = np.zeros(observed.shape[0])
    if model.body is not None:
        particular = observed @ _particular(model.system, model.body).ravel()
    vertices = model.system.unknowns.free_vertices
    free = observed[:, (3 * vertices[:, None] + np.arange(3)).ravel()]
    parts = [free, csr_array((particular.size, model.system.size - free.shape[1]))]
    if model.springs is not None:
        parts.append(observed @ model.springs.displacement_basis)
    surface = csr_array(hstack(parts))
    tip = None
    if model.session.probings[index].tip_displacement is not None and model.tips is not None:
        tip = _tip_rows(model, model.tips, index, columns)
    motions = None
    if model.supports:
        motions = _motions(model, index, observed, with_tip=tip is not None)
    return ProbeRows(
        columns, surface, particular, tip, known_loads, model.body is not None, motions,
        changes=len(perturbations),
    )  # fmt: skip


def _observed(
    model: ObjectModel, place: SurfacePoints, average: SurfaceAverage | None
) -> csr_array:
    """Matrix from the displacements of the vertices to the observed ones, (3 n, 3 v)."""
    nodes = model.system.surface.displacement
    points = interpolation_matrix(nodes, place.triangle, place.barycentric)
    if average is None:
        return csr_array(kron(points, np.eye(3)))
    around = closest_points(model.session.mesh, average.points)
    return average.averaging_matrix(
        points, interpolation_matrix(nodes, around.triangle, around.barycentric)
    )


def _own_perturbations(model: ObjectModel, index: int) -> Int[np.ndarray, " p"]:
    """Indices of a probing's perturbed contacts in `ObjectModel.perturbations`."""
    return np.flatnonzero(np.array([each.probing == index for each in model.perturbations]))


def _particular(system: BoundarySystem, body: BodyForce) -> Float[np.ndarray, "v 3"]:
    """Particular displacement of every vertex, zero in directions that are held."""
    moved, held = body.particular.copy(), system.unknowns.held_vertices
    moved[held] -= np.einsum("hij,hj->hi", system.unknowns.vertex_directions, moved[held])
    return moved


def _columns(
    model: ObjectModel, index: int, perturbations: Int[np.ndarray, " p"]
) -> tuple[Int[np.ndarray, " c"], Float[np.ndarray, " l"]]:
    """Right-hand sides of a probing in the order of `ProbeRows`, and the multipliers of its known
    loads."""
    probing = model.session.probings[index]
    patches, pressed = list(model.patches), list(model.pressed)
    columns, known_loads = [], []
    if probing.contact.profile != RIGID:
        columns.append(3 * model.patch_of[index] + np.arange(3))
    for load in probing.loads:
        if load.force is None:
            columns.append(3 * len(patches) + np.array([pressed.index(contact_key(load.contact))]))
            known_loads.append(np.array([load.pressure]))
        else:
            columns.append(3 * patches.index(contact_key(load.contact)) + np.arange(3))
            known_loads.append(load.force)
    last = 3 * len(patches) + len(pressed)
    if model.body is not None:
        columns.append(last + np.arange(2))
        last += 2
    columns.append(last + _own_motions(model, index))
    columns.append(last + model.shapes.shape[2] + perturbations)
    return np.concatenate(columns), np.concatenate([np.zeros(0), *known_loads])


def _own_motions(model: ObjectModel, index: int) -> Int[np.ndarray, " q"]:
    """Indices of a probing's motions in `ObjectModel.shapes`: rigid ones, and the given strain."""
    rigid = 6 * len(model.supports)
    return np.append(np.arange(rigid), [rigid + index] * model.gives_motions).astype(np.int64)


def _motions(
    model: ObjectModel, index: int, observed: csr_array, *, with_tip: bool
) -> ProbeMotions:
    shapes = model.shapes[:, :, _own_motions(model, index)]
    own = observed @ shapes.reshape(-1, shapes.shape[2])
    if with_tip:
        at_tip = np.zeros((3, own.shape[1]))
        if model.slides:
            last = len(model.supports)
            point = model.session.probings[index].contact.point
            at_tip[:, 6 * last - 6 : 6 * last] = model.supports[-1].modes(point[None])[0]
        own = np.concatenate([own, at_tip])
    pulled = model.pulled_support(index)
    if pulled is None:
        return ProbeMotions(own)
    force = support_force(model.system, model.supports[pulled].triangles, model.springs)
    return ProbeMotions(
        own, force, model.pulled_translations(index), model.supports[pulled].holding
    )


def _tip_rows(
    model: ObjectModel, tips: ContactPoints, index: int, columns: Int[np.ndarray, " c"]
) -> PointRows:
    patch = int(model.patch_of[index])
    right = [tips.equations.by_point(part)[patch][:, columns] for part in tips.right.terms]
    particular = np.zeros(3)
    if model.body is not None:
        contact = list(model.patches.values())[patch]
        nodes = model.system.surface.displacement
        where = np.array([contact.triangle]), contact.barycentric[None]
        at_tip = interpolation_matrix(nodes, *where)
        particular = (at_tip @ _particular(model.system, model.body))[0]
    matrix = tips.equations.matrix[:, patch]
    if model.springs is not None:
        matrix = np.concatenate([matrix, springs_at(tips.equations, model.springs, patch)], axis=2)
    return PointRows(matrix, tips.equations.own[:, patch], np.stack(right), particular)

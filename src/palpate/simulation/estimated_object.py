"""An estimated object for simulators: constants with their covariance, one push, tetrahedra."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from palpate.arrays import fixed_array
from palpate.errors import InputError
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    closest_points,
    enclosed_volume,
    quartered,
    triangle_areas,
    unit_normals,
)
from palpate.pipeline import outward_pushes, poke_session
from palpate.probe import ContactPatch, find_contact_patch
from palpate.progress import Progress, silent
from palpate.records import RIGID, Estimate, ModulusMap, Probing, Session
from palpate.shapes import Points, Vector3
from palpate.solids import (
    Solid,
    boundary_surface,
    check_solid_size,
    held_nodes,
    linear_displacement,
    make_solid,
    surface_values,
)

# Density of a body whose session gives none: that of water [kg/m^3].
USUAL_DENSITY = 1000.0
# Elements along the cube root of a body's volume, and along the radius of a contact.
_ALONG_BODY, _ALONG_CONTACT = 9.0, 2.5
# Radius of the fine elements, in radii of the contact.
_FINE_REACH = 1.2
# Elements may be so many times as long as usual for a number of nodes; halvings of that range.
_LONGEST, _HALVINGS = (1.0, 8.0), 8
# Elements whose moduli differ by no more than this factor are of one material.
_MATERIAL_STEP = 0.02
# Quarterings of the triangles under a contact for the integration of its pressure.
_LEVELS = 4
# Midside nodes of a ten-node tetrahedron: ends of each inner diagonal, then the ring around it; and
# the tetrahedra at its corners.
_DIAGONALS = np.array([[4, 9, 5, 6, 7, 8], [5, 7, 4, 6, 9, 8], [6, 8, 4, 5, 9, 7]])
_CORNERS = np.array([[0, 4, 6, 7], [1, 5, 4, 8], [2, 6, 5, 9], [3, 8, 7, 9]])


@dataclass(frozen=True, slots=True)
class Format:
    """How an object is written for a simulator.

    Attributes
    ----------
    title : str                     the simulator's name
    poisson : (float, float)        lowest and highest Poisson's ratio that it accepts
    run : str                       how to use the files
    of_solid : callable or None     (folder, SolidModel): writes tetrahedra
    of_surface : callable or None   (folder, EstimatedObject): writes the surface, and may return a
                                    sentence about what is left out; exactly one of the two is given
    is_linear : bool                whether it takes the linear tetrahedra
    by_element : bool               whether it is written what a map of moduli says
    stiffens : bool                 whether it is written how a material stiffens
    """

    title: str
    poisson: tuple[float, float]
    run: str
    of_solid: "Callable[[Path, SolidModel], None] | None" = None
    of_surface: "Callable[[Path, EstimatedObject], str | None] | None" = None
    is_linear: bool = False
    by_element: bool = False
    stiffens: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Push:
    """One probing, to be repeated in a simulator.

    Attributes
    ----------
    name : str                      of the probing
    held_out : bool                 whether the estimate was made without it
    point : (3,) float [m]          centre of the contact
    radius : float [m] or None      of the contact
    force : (3,) float [N]          on the object
    displacement : (3,) float [m]   of that point, computed by boundary elements
    patch : ContactPatch            contact patch
    """

    name: str
    held_out: bool
    point: Vector3
    radius: float | None
    force: Vector3
    displacement: Vector3
    patch: ContactPatch


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """Elastic constants with their covariance.

    Parameters
    ----------
    shear_modulus : float [Pa]          > 0
    poisson_ratio : float [-]           -1 < nu <= 0.5
    covariance : (2, 2) float           of shear modulus [Pa] and Poisson's ratio; zero: exact

    Raises
    ------
    InputError                          constants out of range, an invalid covariance
    """

    shear_modulus: float
    poisson_ratio: float
    covariance: Float[np.ndarray, "2 2"]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.shear_modulus) and self.shear_modulus > 0.0):
            raise InputError(f"shear_modulus is {self.shear_modulus}; must be positive, in pascals")
        if not -1.0 < self.poisson_ratio <= 0.5:
            raise InputError(f"poisson_ratio is {self.poisson_ratio}; must be in (-1, 0.5]")
        fixed = fixed_array(self.covariance, name="covariance", shape=(2, 2))
        (a, b), (c, d) = fixed
        if b != c or min(a, d) < 0.0 or a * d - b * c < -1e-9 * a * d:
            raise InputError(
                "covariance must be that of shear modulus and Poisson's ratio: symmetric, without"
                f" negative variances; got {fixed.tolist()}"
            )
        object.__setattr__(self, "covariance", fixed)

    @property
    def young_modulus(self) -> float:
        """E = 2 G (1 + nu) [Pa]."""
        return 2.0 * self.shear_modulus * (1.0 + self.poisson_ratio)


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedObject:
    """An object whose constants were estimated, in SI units, in the frame of its session.

    Attributes
    ----------
    session : Session
    estimate : Estimate
    material : Material             constants as they are written
    modulus : ModulusMap or None    None: the same everywhere
    density : float [kg/m^3]
    push : Push or None             None where nodal forces cannot reproduce the probing
    notes : tuple of str            assumptions and omissions, in sentences
    """

    session: Session
    estimate: Estimate
    material: Material
    modulus: ModulusMap | None
    density: float
    push: Push | None
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SolidModel:
    """The object filled with tetrahedra.

    Attributes
    ----------
    body : EstimatedObject
    solid : Solid                   quadratic tetrahedra
    linear : (e, 4) int             linear tetrahedra on the same nodes, eight for each quadratic
                                    one
    held : (n,) bool                nodes that do not move
    load : (n, 3) float [N]         nodal forces of the push, consistent with quadratic elements;
                                    zero without a push
    linear_load : (n, 3) float [N]  the same, consistent with linear elements
    node : (k,) int                 nodes that interpolate the displacement of the push's point
    share : (k,) float              their weights, which sum to 1
    """

    body: EstimatedObject
    solid: Solid
    linear: Int[np.ndarray, "e 4"]
    held: Bool[np.ndarray, " n"]
    load: Float[np.ndarray, "n 3"]
    linear_load: Float[np.ndarray, "n 3"]
    node: Int[np.ndarray, " k"]
    share: Float[np.ndarray, " k"]

    @property
    def nodes(self) -> Points:
        """All nodes [m]."""
        return self.solid.nodes

    @property
    def log_modulus(self) -> Float[np.ndarray, " m"]:
        """Logarithm of every quadratic element's modulus over that of the material: of what its
        middle lies in."""
        solid, modulus = self.solid, self.body.modulus
        if modulus is None:
            return np.zeros(len(solid.elements))
        centre = solid.nodes[solid.elements[:, :4]].mean(axis=1)
        element = modulus.element_at(centre)
        middle = modulus.nodes[modulus.tetrahedra].mean(axis=1)
        outside = element < 0
        if outside.any():
            element[outside] = cKDTree(middle).query(centre[outside])[1]
        return modulus.log_modulus[element]

    @property
    def materials(self) -> list[tuple[float, Int[np.ndarray, " k"]]]:
        """Young's moduli [Pa] with the quadratic elements that have them, to a per cent."""
        step = np.round(self.log_modulus / _MATERIAL_STEP).astype(np.int64)
        young = self.body.material.young_modulus
        return [
            (young * float(np.exp(_MATERIAL_STEP * level)), np.flatnonzero(step == level))
            for level in np.unique(step)
        ]

    @property
    def boundary_surface(self) -> TriangleMesh:
        """Outer triangles of the linear tetrahedra, counter-clockwise seen from outside, with all
        nodes as vertices."""
        return boundary_surface(self.nodes, self.solid.facets)


def make_estimated_object(
    session: Session,
    estimate: Estimate,
    material: Material,
    *,
    modulus: ModulusMap | None = None,
    probe: str | None = None,
    cache: Path | None = None,
) -> EstimatedObject:
    """Combine an object with one of its probings and the displacement that the model predicts.

    Parameters
    ----------
    session : Session
    estimate : Estimate
    material : Material             constants to be written
    modulus : ModulusMap or None    None: the same everywhere
    probe : str or None             probing to repeat; None: the first that was held out from the
                                    estimate, else the first
    cache : Path or None            folder in which what is computed of the body is kept

    Returns
    -------
    EstimatedObject

    Raises
    ------
    InputError                      no such probing
    """
    probing = chosen_probing(session, estimate, probe)
    notes = []
    if session.density is None:
        notes.append(
            f"the session gives no density: {USUAL_DENSITY:g} kg/m^3 was written; it changes"
            " motion, not where the object comes to rest"
        )
    if any(
        support.stiffness is not None or support.directions is not None
        for support in session.supports
    ):
        notes.append(
            "a support gives (stiffness) or slides (directions): its nodes were written as held in"
            " all directions, so the simulator's object is stiffer than Palpate's"
        )
    push = None
    if probing.contact.profile == RIGID:
        notes.append(
            f"probing '{probing.name}' pulls a grip, which no nodal forces repeat: it was not"
            " written along; name another with --probe"
        )
    else:
        push = _make_push(session, estimate, material, modulus, probing, cache)
        if probing.loads:
            notes.append(
                f"probing '{probing.name}' has {len(probing.loads)} loads beside its tool: only"
                " the tool's force was written"
            )
    density = USUAL_DENSITY if session.density is None else session.density
    return EstimatedObject(session, estimate, material, modulus, density, push, tuple(notes))


def chosen_probing(session: Session, estimate: Estimate, name: str | None) -> Probing:
    """The probing to be repeated.

    Parameters
    ----------
    session : Session
    estimate : Estimate
    name : str or None              None: the first that was held out from the estimate, else the
                                    first

    Returns
    -------
    Probing

    Raises
    ------
    InputError                      no such probing
    """
    by_name = {probing.name: probing for probing in session.probings}
    if name is not None and name not in by_name:
        raise InputError(
            f"{session.path}: there is no probing '{name}' (there are: {', '.join(by_name)})"
        )
    used = {fitted.name for fitted in estimate.probes}
    left_out = [probing for probing in session.probings if probing.name not in used]
    return by_name[name] if name is not None else (left_out or list(session.probings))[0]


def check_edge(mesh: TriangleMesh, edge: float | None) -> None:
    """Refuse an edge length of tetrahedra that no filling of an object can have.

    Parameters
    ----------
    mesh : TriangleMesh             surface of the object
    edge : float or None [m]

    Raises
    ------
    InputError                      not positive, longer than the object, or so short that the
                                    memory does not hold the tetrahedra
    """
    if edge is None:
        return
    if not edge > 0.0:
        raise InputError(f"edge is {edge:g} m; must be positive")
    size = bounding_diagonal(mesh)
    if not edge < size:
        raise InputError(
            f"edge is {edge:g} m; the object is {size:.3g} m across: choose a part of it"
        )
    check_solid_size(mesh, edge)


def make_solid_model(
    body: EstimatedObject,
    *,
    edge: float | None = None,
    nodes: int | None = None,
    progress: Progress = silent,
) -> SolidModel:
    """Fill an object with tetrahedra, finer under its push.

    Parameters
    ----------
    body : EstimatedObject
    edge : float or None [m]        of the quadratic tetrahedra away from the contact; None: nine
                                    along the cube root of the volume
    nodes : int or None             at most so many, by elements that are longer everywhere; there
                                    may be more where the object's shape takes them
    progress : callable

    Returns
    -------
    SolidModel                      the same input gives the same bytes

    Raises
    ------
    InputError                      an edge that is not positive, or longer than the object
    MeshError                       walls thinner than the tetrahedra
    """
    session, push = body.session, body.push
    check_edge(session.mesh, edge)
    usual = float(np.cbrt(enclosed_volume(session.mesh))) / _ALONG_BODY

    def filled(longer: float, stage_progress: Progress = silent) -> Solid:
        """Fill the object with elements longer by a factor."""
        fine = []
        if push is not None and push.radius is not None:
            fine = [(push.point, _FINE_REACH * push.radius, longer * push.radius / _ALONG_CONTACT)]
        away = longer * (usual if edge is None else edge)
        return make_solid(session.mesh, edge=away, fine=fine, progress=stage_progress)

    longer = 1.0 if nodes is None else _longer(filled, nodes)
    solid = filled(longer, progress)
    empty = np.zeros_like(solid.nodes)
    model = SolidModel(
        body, solid, linear_tetrahedra(solid), held_nodes(solid, session.held_triangles), empty,
        empty, np.zeros(0, dtype=np.int64), np.zeros(0),
    )  # fmt: skip
    return model if push is None else _loaded(model, push)


def _longer(filled: Callable[[float], Solid], nodes: int) -> float:
    """How many times as long elements must be for a number of nodes, by bisection."""
    low, high = _LONGEST
    for _ in range(_HALVINGS):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if len(filled(middle).nodes) > nodes else (low, middle)
    return high


def matched_to_push(model: SolidModel) -> tuple[SolidModel, float]:
    """A model whose linear tetrahedra give way under its push as the object does.

    Few of them are too stiff for the dip under a tool; the modulus is written smaller in return.

    Parameters
    ----------
    model : SolidModel              with a push

    Returns
    -------
    SolidModel
    float                           its modulus over that of the object
    """
    body, push = model.body, model.body.push
    if push is None:
        return model, 1.0
    shear = body.material.shear_modulus * np.exp(np.repeat(model.log_modulus, 8))
    moved = linear_displacement(
        model.nodes, model.linear, model.held, model.linear_load, shear_modulus=shear,
        poisson_ratio=body.material.poisson_ratio,
    )  # fmt: skip
    share = float(model.share @ moved[model.node] @ push.displacement) / float(
        push.displacement @ push.displacement
    )
    material = replace(body.material, shear_modulus=share * body.material.shear_modulus)
    return replace(model, body=replace(body, material=material)), share


def linear_tetrahedra(solid: Solid) -> Int[np.ndarray, "e 4"]:
    """Every ten-node tetrahedron cut into eight of four nodes, along its shortest inner diagonal.

    Parameters
    ----------
    solid : Solid

    Returns
    -------
    (e, 4) int                      of positive volume
    """
    nodes, elements = solid.nodes, solid.elements
    ends = nodes[elements[:, _DIAGONALS[:, :2]]]
    shortest = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).argmin(axis=1)
    chosen = _DIAGONALS[shortest]
    ring = np.stack([chosen[:, 2:], np.roll(chosen[:, 2:], -1, axis=1)], axis=2)
    axis = np.repeat(chosen[:, None, :2], 4, axis=1)
    inner = np.concatenate([axis, ring], axis=2)
    local = np.concatenate([np.broadcast_to(_CORNERS, inner.shape), inner], axis=1)
    tetrahedra = np.take_along_axis(elements, local.reshape(len(elements), -1), axis=1).reshape(
        -1, 4
    )
    inverted = np.linalg.det(nodes[tetrahedra[:, 1:]] - nodes[tetrahedra[:, :1]]) < 0.0
    tetrahedra[inverted] = tetrahedra[inverted][:, [0, 2, 1, 3]]
    return tetrahedra


def _make_push(
    session: Session,
    estimate: Estimate,
    material: Material,
    modulus: ModulusMap | None,
    probing: Probing,
    cache: Path | None,
) -> Push:
    """A probing with its displacement, computed by boundary elements."""
    poked = poke_session(
        session, probing.force, probing.contact, shear_modulus=material.shear_modulus,
        poisson_ratio=material.poisson_ratio, modulus=modulus, cache=cache,
    )  # fmt: skip
    contact = poked.contact
    patch = find_contact_patch(session.mesh, contact, session.held_triangles, name=probing.name)
    held_out = probing.name not in {fitted.name for fitted in estimate.probes}
    return Push(
        probing.name, held_out, contact.point, contact.radius, probing.force, poked.displacement,
        patch,
    )  # fmt: skip


def _loaded(model: SolidModel, push: Push) -> SolidModel:
    """The model with the push's force distributed to its nodes."""
    points, forces = _point_forces(model.body.session.mesh, push)
    surface = model.boundary_surface
    closest = closest_points(surface, points)
    share = closest.barycentric[:, :, None] * forces[:, None]
    flat = np.zeros((len(model.nodes), 3))
    np.add.at(flat, surface.triangles[closest.triangle], share)
    at = surface_values(model.solid, push.point[None])
    return replace(
        model,
        load=surface_values(model.solid, points).T @ forces,
        linear_load=flat,
        node=at.indices.astype(np.int64),
        share=at.data,
    )


def _point_forces(mesh: TriangleMesh, push: Push) -> tuple[Points, Float[np.ndarray, "n 3"]]:
    """Points on the patch with their parts of the push, those of the outward traction included."""
    patch = push.patch
    triangle = np.asarray(patch.triangles, dtype=np.int64)
    corners = np.tile(np.eye(3), (triangle.size, 1, 1))
    for _ in range(_LEVELS):
        triangle, corners = quartered(triangle, corners)
    middle = corners.mean(axis=1)
    position = np.einsum("nv,nva->na", middle, mesh.vertices[mesh.triangles[triangle]])
    area = triangle_areas(mesh)[triangle]
    if patch.contact.triangles is not None:
        return position, area[:, None] / area.sum() * push.force
    normal = unit_normals(mesh)[patch.triangle]
    outward = [(load.density, force) for load, force in outward_pushes(patch, normal, push.force)]
    forces = np.zeros_like(position)
    for density, force in [(patch.density, push.force), *outward]:
        pressure = area * density(triangle, middle, position)
        forces += pressure[:, None] / pressure.sum() * force
    loaded = forces.any(axis=1)
    return position[loaded], forces[loaded]


def exact_material(shear_modulus: float, poisson_ratio: float) -> Material:
    """Elastic constants without uncertainty.

    Parameters
    ----------
    shear_modulus : float [Pa]
    poisson_ratio : float [-]

    Returns
    -------
    Material
    """
    return Material(shear_modulus, poisson_ratio, np.zeros((2, 2)))


def estimated_material(estimate: Estimate) -> Material:
    """The constants of an estimate.

    The covariance of G and nu follows from the three standard deviations, since
    dE = 2 (1 + nu) dG + 2 G dnu. The standard deviation of a constant that the data do not
    determine is NaN; that of a uniform distribution over its interval is used instead, without
    correlation.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    Material

    Raises
    ------
    InputError                          the estimate has no value, or no finite interval, for a
                                        constant
    """
    shear, ratio, young = estimate.shear_modulus, estimate.poisson_ratio, estimate.young_modulus
    if not np.isfinite([shear.value, ratio.value]).all():
        raise InputError(
            "the estimate has no value of the shear modulus or of Poisson's ratio; give a material"
        )
    stds = []
    for name, constant in (("shear modulus", shear), ("Poisson's ratio", ratio)):
        std = (
            constant.std
            if np.isfinite(constant.std)
            else (constant.ci95[1] - constant.ci95[0]) / np.sqrt(12.0)
        )
        if not np.isfinite(std):
            raise InputError(
                f"the data do not bound the {name}: a prediction would have no uncertainty; measure"
                " more, or give a material"
            )
        stds.append(float(std))
    by_shear, by_ratio = 2 * (1 + ratio.value) * stds[0], 2 * shear.value * stds[1]
    correlation = 0.0
    if by_shear > 0.0 and by_ratio > 0.0 and np.isfinite(young.std):
        left = young.std**2 - by_shear**2 - by_ratio**2
        correlation = float(np.clip(left / (2 * by_shear * by_ratio), -1.0, 1.0))
    cross = correlation * stds[0] * stds[1]
    covariance = np.array([[stds[0] ** 2, cross], [cross, stds[1] ** 2]])
    return Material(shear.value, ratio.value, covariance)

"""Boundary element model of a session's object, with its loads, weight and moving supports; and the
observations of each probing as functions of its solutions: displacements of its points and its tip,
motions of supports."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array, eye_array, hstack, kron

from palpate.arrays import components_of
from palpate.bem import (
    BodyForce,
    BoundarySystem,
    RightHand,
    Solver,
    Springs,
    check_memory,
    dilation_factor,
    held_system,
    make_solver,
)
from palpate.checkpoints import Cache, Checkpoints, content_digest
from palpate.geometry import SurfacePoints, closest_points, interpolation_matrix
from palpate.pipeline.model.load_table import LoadTable, make_load_table
from palpate.pipeline.model.supports import (
    MovingSupport,
    compliant_supports,
    moving_supports,
    require_balance,
    session_springs,
    session_surface,
    sliding_motion,
    support_force,
    support_shapes,
)
from palpate.progress import Progress, silent
from palpate.records import GIVEN, RIGID, Session, SurfaceAverage
from palpate.shapes import Vector3

# How far the place of a support must be from known, over how far its force took it, for its force
# along an axis to say nothing of it; and how far it may be then.
_FAR, _ANYWHERE = 10.0, 1e3
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True, slots=True, eq=False)
class ObjectModel:
    """Boundary element model of a session's object with the loads of its probings.

    Attributes
    ----------
    session : Session
    system : BoundarySystem
    loads : LoadTable
    supports : tuple of MovingSupport     moving ones; last the object itself, where it slides
    slides : bool                         whether the object slides along rollers
    right : RightHand                     the columns of `loads`
    springs : Springs or None             under compliant supports
    body : BodyForce or None
    solver : Solver                       of the system; several models of it may share one
    """

    session: Session
    system: BoundarySystem
    loads: LoadTable
    supports: tuple[MovingSupport, ...]
    slides: bool
    right: RightHand
    body: BodyForce | None
    solver: Solver
    springs: Springs | None = None

    @property
    def gives_motions(self) -> bool:
        """Whether probings give the motion of a support."""
        return any(support.motion == GIVEN for support in self.supports)

    def pulled_translations(self, probing: int) -> tuple[int, ...]:
        """Indices of the translations of the support that a probing pulls; empty: it pulls none."""
        pulled = self.pulled_support(probing)
        return () if pulled is None else tuple(6 * pulled + i for i in range(3))

    def pulled_support(self, probing: int) -> int | None:
        """Index in `supports` of the one that a probing pulls; None: it pulls none."""
        contact = self.session.probings[probing].contact
        if contact.profile != RIGID or contact.triangles is None:
            return None
        same = [np.array_equal(support.triangles, contact.triangles) for support in self.supports]
        return same.index(True)


def make_object_model(
    session: Session,
    *,
    rings: int = 1,
    cache: Cache | None = None,
    perturbed: bool = True,
    like: ObjectModel | None = None,
    progress: Progress = silent,
) -> ObjectModel:
    """Compute all integrals for a session's object, its loads, its weight and its supports.

    Parameters
    ----------
    session : Session
    rings : int                       as for `bem.make_surface`
    cache : Cache or None             folder in which what is computed of the body is kept for
                                      reuse
    perturbed : bool                  False: without perturbed contacts, and without the error of
                                      the mesh about contacts
    like : ObjectModel or None        of the same mesh on the same supports with other contacts: its
                                      integrals and factors are reused
    progress : callable               called with the progress of the integrals, which may take
                                      minutes

    Returns
    -------
    ObjectModel

    Raises
    ------
    InputError                        the model does not fit into memory, a bad contact, or a force
                                      along a motion that no support holds
    """
    rollers = any(support.directions is not None for support in session.supports)
    compliant = bool(compliant_supports(session))
    check_memory(
        len(session.mesh.vertices), len(session.probings), rollers=rollers, dense=compliant
    )
    sliding = sliding_motion(session)
    require_balance(session, sliding)
    supports = (*moving_supports(session), *filter(None, [sliding]))
    boundary = (
        session_surface(session, rings=rings, cache=cache) if like is None else like.system.surface
    )
    loads = make_load_table(
        session, boundary, support_shapes(session, supports), perturbed=perturbed
    )
    if like is not None:
        system = like.system
    else:
        system = held_system(boundary, dense=compliant, cache=cache, progress=progress)
    right, body = loads.integrate(system)
    return ObjectModel(
        session, system, loads, supports, sliding is not None, right, body,
        make_solver(system) if like is None else like.solver, session_springs(session, system),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class ProbeMotions:
    """Motions of a probing's supports.

    Attributes
    ----------
    own : (n_rows, q) float           prescribed displacement per unit of each motion, at the rows
                                      of the probing; the solution adds that of the free surface
    support_force : (3, k) sparse or None    takes the unknowns to the resultant force on the
                                      support that is pulled, for a shear modulus of one pascal
    pulled_translations : (3,) int    indices of the motions that are that support's translations
                                      along x, y and z: its force replaces them
    holding : (3, 3) float            projector onto the directions in which the support holds the
                                      object and is pulled
    load : (2, 3) float [N]           force on that support, and its standard deviation
    yielding : (3,) float [m/N]       along the axes in which its force says nothing of where it is,
                                      what stands for its translation per newton; else 0
    """

    own: Float[np.ndarray, "n_rows q"]
    support_force: csr_array | None = None
    pulled_translations: tuple[int, ...] = ()
    holding: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    load: Float[np.ndarray, "2 3"] = field(default_factory=lambda: np.zeros((2, 3)))
    yielding: Vector3 = field(default_factory=lambda: np.zeros(3))

    def where_force_counts(self, force: Float[np.ndarray, "3 q"]) -> "ProbeMotions":
        """The motions with `yielding` along the axes in which the object gives so easily, and its
        force is known so little, that it could be far from where the force along took it: a thin
        sheet in tension bends under 1e-4 of what stretches it, less than is right in any mesh.
        There its translation is unknown, and not its force.

        Parameters
        ----------
        force : (3, q) float          force on the support per unit of each motion
        """
        if self.support_force is None or not np.array_equal(self.holding, np.eye(3)):
            return self
        compliance = np.linalg.inv(force[:, list(self.pulled_translations)])
        given, std = self.load
        along = float(given @ compliance @ given) / max(float(np.linalg.norm(given)), _TINY)
        far = std * np.diag(compliance) > _FAR * max(along, _TINY)
        # Nearly the same for all meshes, though their bending differs.
        size = np.divide(_ANYWHERE * along, std, out=np.zeros(3), where=far)
        return replace(self, yielding=size)

    def split(
        self, moved: Float[np.ndarray, "n_rows q"], force: Float[np.ndarray, "3 c"]
    ) -> tuple[Float[np.ndarray, "n_rows 3"], Float[np.ndarray, "n_rows r"]]:
        """Displacement per newton on the support that is pulled, and per unit of the remaining
        motions at constant force on it; along `yielding` axes at constant translation.

        Parameters
        ----------
        moved : (n_rows, q) float     displacement per unit of each motion
        force : (3, q) float          force on the support per unit of each

        Returns
        -------
        two arrays                    the second without the columns `pulled_translations`
        """
        pulled = np.array(self.pulled_translations)
        others = np.setdiff1d(np.arange(moved.shape[1]), pulled)
        # A roller transmits force along the directions that it holds only.
        counts = self.yielding == 0.0
        value, vector = np.linalg.eigh(self.holding * np.outer(counts, counts))
        along = vector[:, value > 0.5]
        compliance = along @ np.linalg.solve(along.T @ force[:, pulled] @ along, along.T)
        per_newton = moved[:, pulled] @ compliance
        at_force = moved - per_newton @ force
        per_newton += at_force[:, pulled] * self.yielding
        return per_newton, at_force[:, others]


@dataclass(frozen=True, slots=True, eq=False)
class ObservationMatrix:
    """Observations of a probing as linear functions of the solutions.

    Attributes
    ----------
    columns : (c,) int                right-hand sides: the force along x, y, z, unless it acts on a
                                      support; known loads; the two of a body force, if any; motions
                                      of supports; perturbed contacts
    surface : (n_rows, k) sparse      takes the unknowns to what is interpolated of the observed
                                      displacements; the last three are those of the contact point,
                                      where it was measured
    indentation : (2, n_rows, c) float    what that misses of the dips about contacts times the
                                      shear modulus, constant and slope in Poisson's ratio
    particular : (n_rows,) float [m Pa]    particular solution there for a body force, over
                                      `dilation_factor`
    n_points : int                    number of points; the contact point comes after them
    known_loads : (l,) float          multiplier of each known load
    has_body_force : bool             whether a body force acts
    motions : ProbeMotions or None    None: no support moves
    changes : int                     number of columns for perturbed contacts, the last ones
    """

    columns: Int[np.ndarray, " c"]
    surface: csr_array
    indentation: Float[np.ndarray, "2 n_rows c"]
    particular: Float[np.ndarray, " n_rows"]
    n_points: int
    known_loads: Float[np.ndarray, " l"] = field(default_factory=lambda: np.zeros(0))
    has_body_force: bool = False
    motions: ProbeMotions | None = None
    changes: int = 0

    @property
    def support_force(self) -> csr_array | None:
        """See `ProbeMotions`."""
        return None if self.motions is None else self.motions.support_force

    def where_force_counts(self, observed: Float[np.ndarray, "rows c"]) -> "ObservationMatrix":
        """These, with the motions as `ProbeMotions.where_force_counts`, from what is observed at
        any Poisson's ratio."""
        if self.support_force is None or self.motions is None:
            return self
        last = observed.shape[1] - self.changes
        force = observed[-3:, last - self.motions.own.shape[1] : last]
        return replace(self, motions=self.motions.where_force_counts(force))

    def observed(self, solution: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "rows c"]:
        """What is interpolated of the observed displacements, then the force on the support that is
        pulled; zero where there is none."""
        force = np.zeros((3, solution.shape[1]))
        if self.support_force is not None:
            force = self.support_force @ solution
        return np.concatenate([self.surface @ solution, force])

    def response(
        self,
        moved: Float[np.ndarray, "n_rows c"],
        force: Float[np.ndarray, "3 c"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "n_rows t"]:
        """Assemble the response (`estimation.ResponseModel`) from the solutions for the columns.

        Parameters
        ----------
        moved : (n_rows, c) float             displacement of each solution, for G = 1 Pa
        force : (3, c) float                  on the support that is pulled
        poisson_ratio : float
        """
        combination = self._combination(poisson_ratio)[: moved.shape[1]]
        per_load = moved @ combination
        if self.has_body_force:
            per_load[:, 3] += dilation_factor(poisson_ratio) * self.particular
        if self.motions is None:
            return per_load
        count = self.motions.own.shape[1]
        per_motion = self.motions.own + moved[:, moved.shape[1] - count :]
        if self.support_force is not None:
            per_newton, per_motion = self.motions.split(per_motion, force[:, -count:])
            # The force on the support is prescribed, so the support yields to the other loads.
            per_load[:, 3] -= per_newton @ (force @ combination[:, 3])
            per_load[:, :3] = per_newton
        return np.concatenate([per_load, per_motion], axis=1)

    def of_loads(
        self, indentation: Float[np.ndarray, "2 r c"], poisson_ratio: float
    ) -> Float[np.ndarray, "r 4"]:
        """What dips about contacts add to a response, without the columns of motions.

        Parameters
        ----------
        indentation : (2, r, c) float         as the attribute, at r rows; perturbed contacts, which
                                              come last, may be left out
        poisson_ratio : float
        """
        moved = indentation[0] + poisson_ratio * indentation[1]
        return moved @ self._combination(poisson_ratio)[: moved.shape[1]]

    def _combination(self, poisson_ratio: float) -> Float[np.ndarray, "c 4"]:
        """Shares of the columns in the displacement per newton along x, y and z, and in that under
        known loads."""
        combination = np.zeros((len(self.columns), 4))
        first = 0 if self.support_force is not None else 3
        combination[:first, :3] = np.eye(first, 3)
        last = first + len(self.known_loads)
        combination[first:last, 3] = self.known_loads
        if self.has_body_force:
            combination[last : last + 2, 3] = 1.0, dilation_factor(poisson_ratio)
        return combination


def probe_rows(
    model: ObjectModel,
    index: int,
    surface_points: SurfacePoints,
    *,
    average: SurfaceAverage | None = None,
    perturbed: bool = True,
) -> ObservationMatrix:
    """Observations of a probing, and the right-hand sides that they depend on.

    Parameters
    ----------
    model : ObjectModel
    index : int                       of the probing in its session
    surface_points : SurfacePoints    observed points
    average : SurfaceAverage or None  average that is observed; None: displacement at the points
    perturbed : bool                  False: without the columns of perturbed contacts

    Returns
    -------
    ObservationMatrix
    """
    columns, known_loads, changes = probe_columns(model, index, perturbed=perturbed)
    seen = _seen(model, index, surface_points, average)
    nodes = model.system.surface.displacement
    points = interpolation_matrix(nodes, seen.triangle, seen.barycentric)
    observed = csr_array(seen.matrix @ kron(points, np.eye(3)))
    particular = np.zeros(observed.shape[0])
    if model.body is not None:
        particular = observed @ _particular(model.system, model.body).ravel()
    vertices = model.system.unknowns.free_vertices
    free = observed[:, components_of(vertices)]
    parts = [free, csr_array((particular.size, model.system.size - free.shape[1]))]
    if model.springs is not None:
        parts.append(observed @ model.springs.displacement_basis)
    missed = model.loads.missed_indentation(
        model.system.surface, columns, seen.triangle, seen.barycentric
    )
    # Vertices miss nothing: zeros that take no memory.
    indentation = np.broadcast_to(0.0, (2, len(particular), len(columns)))
    if missed.any():
        indentation = np.stack([seen.matrix @ part for part in missed])
    return ObservationMatrix(
        columns,
        csr_array(hstack(parts)),
        indentation,
        particular,
        len(surface_points.triangle),
        known_loads,
        model.body is not None,
        _motions(model, index, observed) if model.supports else None,
        changes=changes,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Points of the surface, and what is observed of their displacements.

    Attributes
    ----------
    triangle : (p,) int
    barycentric : (p, 3) float
    matrix : (n_rows, 3 p) sparse     takes their displacements to the observed ones
    """

    triangle: Int[np.ndarray, " p"]
    barycentric: Float[np.ndarray, "p 3"]
    matrix: csr_array


def _seen(
    model: ObjectModel, index: int, surface_points: SurfacePoints, average: SurfaceAverage | None
) -> _Seen:
    """What a probing observes: the displacements of points or their averages, and that of its
    contact point where it was measured."""
    parts = [(surface_points.triangle, surface_points.barycentric)]
    matrix = csr_array(eye_array(3 * len(surface_points.triangle)))
    if average is not None:
        around = _samples(model, average)
        parts.append((around.triangle, around.barycentric))
        matrix = average.averaging_matrix()
    patch = int(model.loads.patch_of[index])
    if model.session.probings[index].tip_displacement is not None and patch >= 0:
        contact = list(model.loads.patches.values())[patch]
        parts.append((np.array([contact.triangle]), contact.barycentric[None]))
        matrix = _with_own_rows(matrix, 3)
    triangle, barycentric = (np.concatenate(part) for part in zip(*parts, strict=True))
    return _Seen(triangle, barycentric, matrix)


def _with_own_rows(matrix: csr_array, count: int) -> csr_array:
    """A matrix with further rows, each with a one in a further column: `block_diag` takes as long
    as everything else about what a probing observes."""
    (rows, columns), ends = matrix.shape, matrix.indptr
    further = np.arange(count)
    return csr_array(
        (
            np.append(matrix.data, np.ones(count)),
            np.append(matrix.indices, columns + further),
            np.append(ends, ends[-1] + 1 + further),
        ),
        shape=(rows + count, columns + count),
    )


def _samples(model: ObjectModel, average: SurfaceAverage) -> SurfacePoints:
    """Where the sampling points of an average are on the mesh; in memory it is kept for fits of
    further pushes."""
    mesh, points = model.session.mesh, average.points
    checkpoints = Checkpoints(model.system.checkpoints.folder, content_digest((mesh, points)))
    return checkpoints.kept_in_memory("samples", lambda: closest_points(mesh, points))


def _own_perturbations(model: ObjectModel, index: int) -> Int[np.ndarray, " p"]:
    """Indices of a probing's perturbed contacts in `LoadTable.perturbations`."""
    return np.flatnonzero(
        [perturbation.probing == index for perturbation in model.loads.perturbations]
    )


def _particular(system: BoundarySystem, body: BodyForce) -> Float[np.ndarray, "v 3"]:
    """Particular displacement of every vertex, zero in directions that are held."""
    moved, held = body.particular.copy(), system.unknowns.held_vertices
    moved[held] -= np.einsum("hij,hj->hi", system.unknowns.vertex_directions, moved[held])
    return moved


def probe_columns(
    model: ObjectModel, index: int, *, perturbed: bool = True
) -> tuple[Int[np.ndarray, " c"], Float[np.ndarray, " l"], int]:
    """Right-hand sides of a probing.

    Parameters
    ----------
    model : ObjectModel
    index : int                       of the probing in its session
    perturbed : bool                  False: without those of perturbed contacts

    Returns
    -------
    columns : (c,) int                in the order of `ObservationMatrix`
    known_loads : (l,) float          multipliers of its known loads
    changes : int                     how many of the columns are of perturbed contacts
    """
    probing, table = model.session.probings[index], model.loads
    perturbations = _own_perturbations(model, index)[: None if perturbed else 0]
    columns, known_loads = [], []
    if probing.contact.profile != RIGID:
        columns.append(table.force_columns(probing.contact))
    for load in probing.loads:
        if load.force is None:
            columns.append(table.pressure_columns(load.contact))
            known_loads.append(np.array([load.pressure]))
        else:
            columns.append(table.force_columns(load.contact))
            known_loads.append(load.force)
    columns += [
        table.weight_columns,
        table.motion_columns[_own_motions(model, index)],
        table.perturbation_columns[perturbations],
    ]
    known = np.concatenate([np.zeros(0), *known_loads])
    return np.concatenate(columns), known, len(perturbations)


def _own_motions(model: ObjectModel, index: int) -> Int[np.ndarray, " q"]:
    """Indices of a probing's motions in `LoadTable.shapes`: rigid ones, and the given strain."""
    rigid = 6 * len(model.supports)
    return np.append(np.arange(rigid), [rigid + index] * model.gives_motions).astype(np.int64)


def _motions(model: ObjectModel, index: int, observed: csr_array) -> ProbeMotions:
    shapes = model.loads.shapes[:, :, _own_motions(model, index)]
    motions = observed @ shapes.reshape(-1, shapes.shape[2])
    pulled = model.pulled_support(index)
    if pulled is None:
        return ProbeMotions(motions)
    probing = model.session.probings[index]
    force = support_force(model.system, model.supports[pulled].triangles, model.springs)
    return ProbeMotions(
        motions,
        force,
        model.pulled_translations(index),
        model.supports[pulled].holding,
        np.stack([probing.force, model.session.force_std(probing)]),
    )

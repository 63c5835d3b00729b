"""Green's functions of a part of a surface: displacements everywhere per force on each vertex.

They are the elastic map of one material, tabulated for loads distributed as the linear hat
functions of the vertices. Reciprocity makes the compliance between the vertices symmetric;
collocation satisfies this up to the discretisation error. Here the compliance is symmetrised, so
that no closed path of a tool gains or loses energy; `asymmetry` is the relative change.

Their file for haptic loops in any language, an NPZ in the format `palpate-greens/3`, has arrays,
little endian, C order, SI units, object frame; v vertices, m triangles, n nodes:

format, name                       texts
vertices (v, 3), triangles (m, 3)  surface at rest [m]; counter-clockwise from outside
held_triangles (h,)                triangles of the support
nodes (n,)                         vertices that may be touched, ascending
compliance (n, 3, n, 3)            [m/N] [i, a, j, b]: component a at node i per force along b on j
surface (n, 3, v, 3)               [m/N] [j, b, i, a]: the same for every vertex i
slope (n, 3, n, 3)                 [m/N] derivative of compliance in Poisson's ratio, [i, a, j, b]
changes (k, n, 3, n, 3)            [m/N] independent changes of compliance, a standard deviation
                                   each, where the modulus differs from place to place; k may be 0
constants (2,), covariance (2, 2)  shear modulus [Pa], Poisson's ratio
asymmetry ()                       relative asymmetry of compliance before symmetrisation
left_out (l,)                      vertices that are no nodes: compliance would be indefinite
sha256                             of the bytes of all other arrays, in the order of their names

A force on a node is distributed over the linear hat function of its vertex. Displacements are
linear in the forces and proportional to 1 / shear modulus.

Source
------
James and Pai, ArtDefo: accurate real time deformable objects, SIGGRAPH (1999), section 4.
"""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg.lapack import dpotrf

from palpate.arrays import components_of, fix_fields
from palpate.bem import BoundarySystem, CentredSystem, SurfaceLoad, load_right_hand, solve
from palpate.disk import write_bytes, write_errors
from palpate.errors import InputError, PalpateError, RecordError
from palpate.field import make_map_response, nodal_load
from palpate.files import stored_arrays
from palpate.geometry import TriangleMesh
from palpate.pipeline import held_object
from palpate.progress import Progress, silent
from palpate.records import Estimate, ModulusMap, Session
from palpate.simulation.estimated_object import Material, estimated_material
from palpate.solids import with_moduli

# Vertices whose columns, three each, are solved together.
_VERTICES_AT_ONCE = 60
# Difference of Poisson's ratios for the slope of what a map of moduli changes.
_STEP = 0.005
# A table above this is refused [bytes].
_MAX_BYTES = 2e9
GREENS_FORMAT = "palpate-greens/3"
_ARRAYS = (
    "held_triangles",
    "nodes",
    "compliance",
    "surface",
    "slope",
    "changes",
    "left_out",
    "asymmetry",
)
_KEYS = {
    "format", "name", "vertices", "triangles", "constants", "covariance", "sha256", *_ARRAYS,
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class GreenFunctions:
    """Displacement of a held object per newton on each of some vertices.

    Parameters
    ----------
    name : str
    mesh : TriangleMesh                 at rest [m]
    held_triangles : (h,) int
    nodes : (n,) int                    vertices that may be touched, ascending
    compliance : (n, 3, n, 3) float [m/N]   component a at node i under a force along b on node j;
                                        symmetric, positive definite
    surface : (n, 3, v, 3) float [m/N]  component a of vertex i under a force along b on node j, as
                                        [j, b, i, a]
    slope : (n, 3, n, 3) float [m/N]    derivative of `compliance` with respect to Poisson's ratio
    changes : (k, n, 3, n, 3) float [m/N]   independent changes of `compliance` by what is not known
                                        of where the modulus differs, a standard deviation each
    material : Material                 constants and their covariance
    asymmetry : float                   norm of the antisymmetric part of the compliance before
                                        symmetrisation, over that of the symmetric part
    left_out : (l,) int                 vertices that are no nodes because the compliance would not
                                        be positive definite with them

    Raises
    ------
    InputError                          shapes that do not match, nodes that are no free vertices, a
                                        compliance that is not symmetric and positive definite
    """

    name: str
    mesh: TriangleMesh
    held_triangles: Int[np.ndarray, " h"]
    nodes: Int[np.ndarray, " n"]
    compliance: Float[np.ndarray, "n 3 n 3"]
    surface: Float[np.ndarray, "n 3 v 3"]
    slope: Float[np.ndarray, "n 3 n 3"]
    changes: Float[np.ndarray, "k n 3 n 3"]
    material: Material
    asymmetry: float
    left_out: Int[np.ndarray, " l"] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def __post_init__(self) -> None:
        vertices, count = len(self.mesh.vertices), len(self.nodes)
        between, onto = (count, 3, count, 3), (count, 3, vertices, 3)
        fix_fields(self, integer=True, nodes=(None,), held_triangles=(None,))
        fix_fields(self, compliance=between, surface=onto, slope=between)
        fix_fields(self, changes=(None, *between))
        fix_fields(self, integer=True, left_out=(None,))
        check_nodes(self.mesh, self.held_triangles, self.nodes)
        square = self.compliance.reshape(3 * count, -1)
        if not np.array_equal(square, square.T):
            raise InputError("compliance is not symmetric; energy would be gained on closed paths")
        try:
            np.linalg.cholesky(square)
        except np.linalg.LinAlgError:
            raise InputError(
                "compliance is not positive definite: some force would gain energy; nodes lie too"
                " close to each other for the mesh, leave out those at narrow triangles"
            ) from None

    def displacement_std(self, force: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Standard deviation of the nodes' displacement under forces on them, from that of the
        constants and of where the modulus differs.

        Parameters
        ----------
        force : (n, 3) float [N]

        Returns
        -------
        (n, 3) float [m]
        """
        moved = np.tensordot(self.compliance, force, axes=2)
        by_ratio = np.tensordot(self.slope, force, axes=2)
        by_constants = np.stack([-moved / self.material.shear_modulus, by_ratio])
        variance = np.einsum("pia,pq,qia->ia", by_constants, self.material.covariance, by_constants)
        return np.sqrt(variance + np.square(np.tensordot(self.changes, force, axes=2)).sum(axis=0))

    @property
    def left_out_text(self) -> str:
        """A sentence about the vertices that were left out; empty where none were."""
        if not len(self.left_out):
            return ""
        count = len(self.nodes) + len(self.left_out)
        return (
            f"{len(self.left_out)} of {count} vertices cannot be touched: the triangles there are"
            " so narrow that forces would gain energy; a mesh of even triangles has none of them"
        )


def make_green_functions(
    session: Session,
    estimate: Estimate | Material,
    *,
    modulus: ModulusMap | None = None,
    nodes: Int[np.ndarray, " n"] | None = None,
    most: int | None = None,
    cache: Path | None = None,
    progress: Progress = silent,
) -> GreenFunctions:
    """Compute the Green's functions of a part of an object's surface.

    Parameters
    ----------
    session : Session
    estimate : Estimate or Material     constants; of an estimate with their covariance
    modulus : ModulusMap or None        None: the same everywhere
    nodes : (n,) int                    vertices of the mesh that may be touched; None: all that
                                        belong to no held triangle, except those at narrow triangles
                                        that would make the compliance indefinite
    most : int                          largest number of nodes where `nodes` is None: the free
                                        vertices nearest to the contacts; None: all
    cache : Path or None                folder in which what is computed of the body is kept
    progress : callable                 called with the current step (text) and the fraction done
                                        (0 to 1)

    Returns
    -------
    GreenFunctions

    Raises
    ------
    InputError                          constants that are not known, nodes that are not free, a
                                        table above 2 GB, rollers or compliant supports
    SingularSystemError                 the matrix is singular to working precision
    """
    material = estimate if isinstance(estimate, Material) else estimated_material(estimate)
    if any(support.directions is not None for support in session.supports):
        raise InputError(
            f"{session.path}: a support holds some directions only (rollers); Green's functions are"
            " made of objects whose supports hold all directions"
        )
    if any(support.stiffness is not None for support in session.supports):
        raise InputError(
            f"{session.path}: a support gives (stiffness); Green's functions are made of objects on"
            " rigid supports: leave its stiffness out if it hardly gives"
        )
    chosen = _default_nodes(session, most) if nodes is None else np.unique(nodes)
    check_nodes(session.mesh, session.held_triangles, chosen)
    needed = 8.0 * 9 * len(chosen) * (len(session.mesh.vertices) + 4 * len(chosen))
    if needed > _MAX_BYTES:
        raise InputError(
            f"Green's functions of {len(chosen)} vertices on a surface of"
            f" {len(session.mesh.vertices)} take {needed / 1e9:.1f} GB; at most"
            f" {_MAX_BYTES / 1e9:.0f} GB are made: choose fewer vertices, those that will be"
            " touched"
        )
    progress("integrals over the surface", 0.0)
    graded, system = held_object(session, cache=cache, dense=True)
    everywhere, slope = _responses(system, material, chosen, len(session.mesh.vertices), progress)
    changes = np.zeros((0, len(chosen), 3, len(chosen), 3))
    if modulus is not None:
        progress("where the modulus differs", 1.0)
        count = len(session.mesh.vertices)
        change, bend, changes = _map_responses(graded, modulus, material, chosen, count)
        everywhere, slope = everywhere + change, slope + bend
    left_out = chosen[:0]
    if nodes is None:
        definite = _positive_definite_nodes(_square(everywhere[:, :, chosen]))
        if len(definite) < len(chosen):
            left_out, chosen = np.delete(chosen, definite), chosen[definite]
            everywhere, slope = everywhere[definite], slope[definite][:, :, definite]
            changes = changes[:, definite][:, :, :, definite]
    square = _square(everywhere[:, :, chosen])
    compliance = 0.5 * (square + square.T)
    asymmetry = float(np.linalg.norm(square - square.T) / np.linalg.norm(square + square.T))
    shape = (len(chosen), 3, len(chosen), 3)
    everywhere[:, :, chosen] = compliance.reshape(shape)
    slope = _square(slope)
    return GreenFunctions(
        session.name, session.mesh, session.held_triangles, chosen, compliance.reshape(shape),
        everywhere, (0.5 * (slope + slope.T)).reshape(shape), changes, material, asymmetry,
        left_out,
    )  # fmt: skip


def _square(pairs: Float[np.ndarray, "n 3 n 3"]) -> Float[np.ndarray, "m m"]:
    """Responses [j, b, i, a] as a matrix: displacements by row, forces by column."""
    return pairs.transpose(2, 3, 0, 1).reshape(3 * len(pairs), -1)


def _default_nodes(session: Session, most: int | None) -> Int[np.ndarray, " n"]:
    """The free vertices nearest to the contacts, or to the highest vertex without contacts."""
    if most is None:
        return free_vertices(session)
    vertices = session.mesh.vertices
    points = [probing.contact.point for probing in session.probings]
    return nearest_nodes(session, np.array(points or [vertices[vertices[:, 2].argmax()]]), most)


def _positive_definite_nodes(square: Float[np.ndarray, "m m"]) -> Int[np.ndarray, " k"]:
    """Nodes whose symmetrised compliance is positive definite: nodes are removed one by one, each
    the first at which the Cholesky factorisation fails."""
    symmetric = square + square.T
    remaining = np.arange(len(square) // 3)
    while len(remaining):
        rows = components_of(remaining)
        # Order of the first leading minor that is not positive; 0 if all are.
        order = dpotrf(symmetric[np.ix_(rows, rows)])[1]
        if not order:
            break
        remaining = np.delete(remaining, (order - 1) // 3)
    return remaining


def free_vertices(session: Session) -> Int[np.ndarray, " n"]:
    """Vertices that belong to no held triangle.

    Parameters
    ----------
    session : Session

    Returns
    -------
    (n,) int
    """
    held = session.mesh.triangles[session.held_triangles]
    return np.setdiff1d(np.arange(len(session.mesh.vertices)), held)


def nearest_nodes(
    session: Session, points: Float[np.ndarray, "k 3"], count: int
) -> Int[np.ndarray, " n"]:
    """The free vertices nearest to some points, for Green's functions of that part of the surface.

    Parameters
    ----------
    session : Session
    points : (k, 3) float [m]           where the object will be touched
    count : int                         largest number of vertices

    Returns
    -------
    (n,) int                            ascending
    """
    free = free_vertices(session)
    offset = session.mesh.vertices[free][:, None] - points
    distance = np.linalg.norm(offset, axis=2).min(axis=1)
    return np.sort(free[np.argsort(distance, kind="stable")[:count]])


def check_nodes(
    mesh: TriangleMesh, held_triangles: Int[np.ndarray, " h"], nodes: Int[np.ndarray, " n"]
) -> None:
    """Refuse nodes that are not distinct, ascending vertices of the mesh, or are held.

    Parameters
    ----------
    mesh : TriangleMesh
    held_triangles : (h,) int
    nodes : (n,) int                    at least one

    Raises
    ------
    InputError                          they are refused
    """
    count = len(mesh.vertices)
    if not len(nodes) or nodes[0] < 0 or nodes[-1] >= count or np.any(np.diff(nodes) <= 0):
        raise InputError(
            f"nodes must be distinct vertices of the mesh, 0 to {count - 1}, ascending, at least"
            " one"
        )
    held = np.intersect1d(nodes, mesh.triangles[held_triangles])
    if held.size:
        raise InputError(
            f"{held.size} of the nodes belong to the support (first: {held[:3].tolist()}): nothing"
            " moves there; leave them out"
        )


def hat_load(mesh: TriangleMesh, vertex: int) -> SurfaceLoad:
    """One newton, distributed as the linear hat function of a vertex.

    Parameters
    ----------
    mesh : TriangleMesh
    vertex : int

    Returns
    -------
    SurfaceLoad
    """
    corners = mesh.triangles

    def density(
        triangle: Int[np.ndarray, " n"],
        barycentric: Float[np.ndarray, "n 3"],
        position: Float[np.ndarray, "n 3"],
    ) -> Float[np.ndarray, " n"]:
        return (barycentric * (corners[triangle] == vertex)).sum(axis=1)

    return SurfaceLoad(np.flatnonzero((corners == vertex).any(axis=1)), density)


def _responses(
    system: BoundarySystem,
    material: Material,
    nodes: Int[np.ndarray, " n"],
    count: int,
    progress: Progress,
) -> tuple[Float[np.ndarray, "n 3 v 3"], Float[np.ndarray, "n 3 n 3"]]:
    """Displacement of the first vertices per newton, [j, b, i, a], and its slope at the nodes."""
    ratio = material.poisson_ratio
    progress("factorisation", 0.3)
    centred = CentredSystem(system, ratio)
    everywhere = np.zeros((len(nodes), 3, count, 3))
    slope = np.zeros((len(nodes), 3, len(nodes), 3))
    free = system.unknowns.free_vertices
    for part in _parts(len(nodes)):
        progress("Green's functions", 0.4 + 0.6 * part.start / len(nodes))
        loads = [hat_load(system.surface.mesh, int(v)) for v in nodes[part]]
        right = load_right_hand(system, loads)
        solution = solve(centred.factorised, right.at(ratio))
        right_slope = right.terms[1] + 2 * ratio * right.terms[2] - centred.slope.apply(solution)
        solution_slope = solve(centred.factorised, right_slope)
        for values, out, rows in (
            (solution, everywhere[part], np.arange(count)), (solution_slope, slope[part], nodes),
        ):  # fmt: skip
            displacement = np.zeros((len(system.surface.mesh.vertices), 3, 3 * len(loads)))
            displacement[free] = values[: 3 * len(free)].reshape(len(free), 3, -1)
            by_load = (
                displacement[rows].reshape(len(rows), 3, len(loads), 3) / material.shear_modulus
            )
            out[:] = by_load.transpose(2, 3, 0, 1)
    return everywhere, slope


def _map_responses(
    session: Session,
    modulus: ModulusMap,
    material: Material,
    nodes: Int[np.ndarray, " n"],
    count: int,
) -> tuple[
    Float[np.ndarray, "n 3 v 3"], Float[np.ndarray, "n 3 n 3"], Float[np.ndarray, "k n 3 n 3"]
]:
    """What a map of moduli changes in the displacements per newton, [j, b, i, a], and in their
    slopes; and how they change with the map."""
    mesh = session.mesh
    changed = make_map_response(session, modulus, material.poisson_ratio)
    axis = np.array([1.0, 0.0, 0.0])
    hats = [hat_load(mesh, int(vertex)) for vertex in nodes]
    shares = np.stack(
        [nodal_load(mesh, hat.triangles, hat.density, axis, changed.solid)[::3] for hat in hats],
        axis=1,
    )
    load = np.kron(shares, np.eye(3))
    moved, at = changed.uneven.displacements(load), changed.at(mesh.vertices[:count])

    def by_load(values: Float[np.ndarray, "v3 p"]) -> Float[np.ndarray, "n 3 v 3"]:
        shape = (len(values) // 3, 3, len(nodes), 3)
        return values.reshape(shape).transpose(2, 3, 0, 1) / material.shear_modulus

    change = at @ (moved - changed.even.displacements(load))
    uneven, even = (
        with_moduli(
            stiffness.body, stiffness.log_modulus, stiffness.poisson_ratio - _STEP
        ).displacements(load)
        for stiffness in (changed.uneven, changed.even)
    )
    bend = (change - at @ (uneven - even)).reshape(count, 3, -1)[nodes] / _STEP
    rows = components_of(nodes)
    seen = changed.uneven.displacements(at[rows].toarray().T)
    changes = np.zeros((len(rows), len(rows), changed.directions.shape[1]))
    for part in _parts(len(rows)):
        changes[part] = changed.uneven.sensitivities(seen, moved[:, part], changed.directions)
    changes = 0.5 * (changes + changes.transpose(1, 0, 2)).transpose(2, 0, 1)
    changes = changes.reshape(-1, len(nodes), 3, len(nodes), 3)
    bent = by_load(bend.reshape(3 * len(nodes), -1))
    return by_load(change), bent, changes / material.shear_modulus


def _parts(count: int) -> Iterator[slice]:
    for first in range(0, count, _VERTICES_AT_ONCE):
        yield slice(first, min(first + _VERTICES_AT_ONCE, count))


def write_green_functions(path: Path, green: GreenFunctions) -> None:
    """Write Green's functions, atomically: the file holds all of them or its old content.

    Parameters
    ----------
    path : Path                     with suffix .npz; its folder must exist
    green : GreenFunctions

    Raises
    ------
    RecordError                     the file cannot be written
    """
    material = green.material
    content = {
        "format": np.array(GREENS_FORMAT),
        "name": np.array(green.name),
        "vertices": green.mesh.vertices,
        "triangles": green.mesh.triangles,
        "constants": np.array([material.shear_modulus, material.poisson_ratio]),
        "covariance": material.covariance,
        **{name: np.asarray(getattr(green, name)) for name in _ARRAYS},
    }
    packed = BytesIO()
    np.savez(packed, **content, sha256=np.array(_digest(content)))  # type: ignore[arg-type]
    with write_errors(path):
        write_bytes(path, packed.getvalue())


def read_green_functions(path: Path | str) -> GreenFunctions:
    """Read Green's functions and check them.

    Parameters
    ----------
    path : path

    Returns
    -------
    GreenFunctions

    Raises
    ------
    RecordError                     file missing, not of this format, of another version, damaged,
                                    or with inconsistent arrays; the message names the array
    """
    path = Path(path)
    cure = "make it again with `palpate export RESULT --to npz`"
    with stored_arrays(path, cure, what="is no NPZ file, or only a part of one") as content:
        return _green_functions(path, content)


def _green_functions(path: Path, content: dict[str, np.ndarray]) -> GreenFunctions:
    stated = str(content.get("format", ""))
    if stated != GREENS_FORMAT:
        raise RecordError(f"{path}: format is '{stated}'; this version reads '{GREENS_FORMAT}'")
    if missing := sorted(_KEYS - set(content)):
        raise RecordError(f"{path}: the array '{missing[0]}' is missing")
    if str(content.pop("sha256")) != _digest(content):
        raise RecordError(
            f"{path}: its arrays are not as they were written (sha256 differs); make it again"
        )
    try:
        shear, ratio = content["constants"]
        return GreenFunctions(
            name=str(content["name"]),
            mesh=TriangleMesh(content["vertices"], content["triangles"]),
            material=Material(float(shear), float(ratio), content["covariance"]),
            **{name: content[name] for name in _ARRAYS[:-1]},
            asymmetry=float(content["asymmetry"]),
        )
    except (PalpateError, TypeError, ValueError) as error:
        raise RecordError(f"{path}: {error}") from error


def _digest(content: Mapping[str, Any]) -> str:
    """Checksum of the arrays, in the order of their names."""
    digest = hashlib.sha256()
    for name in sorted(content):
        array = np.ascontiguousarray(content[name])
        digest.update(f"{name} {array.dtype.str} {array.shape};".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()

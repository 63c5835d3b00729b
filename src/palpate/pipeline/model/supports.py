"""Supports: the directions they hold, how they move, and how compliant they are.

Rigid motions as columns of the model, the motion fitted to measured points, the sliding of an
object on rollers; the forces on supports, and those that are beds of springs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array

from palpate.arrays import STD_OVER_MEDIAN, known_median
from palpate.bem import (
    BodyForce,
    BoundarySurface,
    BoundarySystem,
    Springs,
    integral_weights,
    make_springs,
    make_surface,
    unrestrained_motions,
)
from palpate.checkpoints import Cache, Checkpoints, content_digest
from palpate.errors import InputError
from palpate.geometry import TriangleMesh, area_vectors, bounding_diagonal
from palpate.records import (
    FIXED,
    FREE,
    GIVEN,
    DisplacementField,
    Load,
    Probing,
    Session,
)
from palpate.shapes import Points, Vector3

# Robust fit of a motion: iterations, and degrees of freedom of Student's t.
_ROUNDS, _DEGREES = 10, 8.0
# Fraction of the largest singular value below which the points do not determine a motion.
_UNSEEN = 1e-3
# Fraction of a force that may act along directions that no support holds: real rollers have
# friction, and no tool is exactly at a right angle.
_UNANSWERED = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class MovingSupport:
    """A support that moves, or the object itself where it slides along its rollers.

    Attributes
    ----------
    number : int                    from 1, as in session.toml
    triangles : (k,) int
    vertices : (h,) int
    centre : (3,) float [m]         about which it rotates
    motion : str                    `GIVEN` or `FREE`
    holding : (3, 3) float          projector onto the directions that it holds; along the others
                                    it moves nothing
    free_projector : (6, 6) float   projector of a motion onto its free part; identity by default
    """

    number: int
    triangles: Int[np.ndarray, " k"]
    vertices: Int[np.ndarray, " h"]
    centre: Vector3
    motion: str
    holding: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    free_projector: Float[np.ndarray, "6 6"] = field(default_factory=lambda: np.eye(6))

    def modes(self, points: Points) -> Float[np.ndarray, "n 3 6"]:
        """Displacement of held points per unit of each motion.

        Parameters
        ----------
        points : (n, 3) float [m]

        Returns
        -------
        (n, 3, 6) float [-], [m]
        """
        return self.holding @ rigid_modes(points, self.centre) @ self.free_projector


@dataclass(frozen=True, slots=True, eq=False)
class GivenMotion:
    """Motion of a support as given by a probing.

    Attributes
    ----------
    value : (6,) float              translation of the centre [m], rotation about it [rad]
    std : (6,) float                one standard deviation of each
    strain : (3, 3) float [-]       displacement gradient, about the centre, of the rest of the
                                    motion, such as the lateral contraction of a cut end
    """

    value: Float[np.ndarray, "6"]
    std: Float[np.ndarray, "6"]
    strain: Float[np.ndarray, "3 3"]


def moving_supports(session: Session) -> tuple[MovingSupport, ...]:
    """The supports of a session that are not fixed.

    Parameters
    ----------
    session : Session

    Returns
    -------
    tuple of MovingSupport          in the order of the session
    """
    supports = []
    for number, support in enumerate(session.supports, start=1):
        vertices = np.unique(session.mesh.triangles[support.triangles])
        centre = _box_centre(session.mesh.vertices[vertices])
        if support.motion != FIXED:
            supports.append(
                MovingSupport(
                    number, support.triangles, vertices, centre, support.motion, support.holding
                )
            )
    return tuple(supports)


def rigid_modes(points: Points, centre: Vector3) -> Float[np.ndarray, "n 3 6"]:
    """Displacement of points per unit of three translations [m] and three rotations [rad].

    Parameters
    ----------
    points : (n, 3) float [m]
    centre : (3,) float [m]         of the rotations

    Returns
    -------
    (n, 3, 6) float [-], [m]
    """
    rotations = np.cross(np.eye(3)[None], (points - centre)[:, None, :]).transpose(0, 2, 1)
    translations = np.broadcast_to(np.eye(3), (len(points), 3, 3))
    return np.concatenate([translations, rotations], axis=2)


def free_std(mesh: TriangleMesh) -> Float[np.ndarray, "6"]:
    """Prior standard deviation of a free motion, wide enough to be uninformative: the diagonal of
    the object's bounding box, and one radian.

    Parameters
    ----------
    mesh : TriangleMesh

    Returns
    -------
    (6,) float [m], [rad]
    """
    return np.append(np.full(3, bounding_diagonal(mesh)), np.ones(3))


def given_motion(session: Session, probing: Probing, support: MovingSupport) -> GivenMotion:
    """Motion of a support as a probing gives it, or fitted to the points measured on the support.

    Parameters
    ----------
    session : Session
    probing : Probing
    support : MovingSupport         `GIVEN`

    Returns
    -------
    GivenMotion

    Raises
    ------
    InputError                      no motion is given, too few points on the support, or all of
                                    them on a line
    """
    if probing.support_motion is not None:
        rigid = probing.support_motion
        value = np.concatenate([rigid.translation, rigid.rotation])
        return GivenMotion(value, np.zeros(6), np.zeros((3, 3)))
    field = probing.support_displacement
    if field is None:
        raise InputError(f"probing '{probing.name}': the motion of its support is not given")
    return _fitted_motion(field, probing.name, support)


def require_given_motions(session: Session) -> None:
    """Refuse a session whose probings lack the motion of a support that is to be given.

    Parameters
    ----------
    session : Session

    Raises
    ------
    InputError                      as `given_motion`
    """
    for support in moving_supports(session):
        for probing in session.probings:
            if support.motion == GIVEN:
                given_motion(session, probing, support)


def support_shapes(
    session: Session, supports: tuple[MovingSupport, ...]
) -> Float[np.ndarray, "v 3 q"]:
    """Prescribed displacement of every vertex per unit of each motion: of held vertices, and zero
    elsewhere; where the object slides, of all vertices.

    Parameters
    ----------
    session : Session
    supports : tuple of MovingSupport

    Returns
    -------
    (v, 3, q) float                 six motions for each support; then, if any support's motion is
                                    given, one for each probing: the strain of its supports
    """
    vertices = session.mesh.vertices
    shapes = np.zeros((len(vertices), 3, 6 * len(supports)))
    for k, support in enumerate(supports):
        modes = support.modes(vertices[support.vertices])
        shapes[support.vertices, :, 6 * k : 6 * k + 6] = modes
    if not any(support.motion == GIVEN for support in supports):
        return shapes
    strains = np.zeros((len(vertices), 3, len(session.probings)))
    for k, probing in enumerate(session.probings):
        for support in supports:
            if support.motion == GIVEN:
                offset = vertices[support.vertices] - support.centre
                strain = given_motion(session, probing, support).strain
                strains[support.vertices, :, k] = offset @ strain.T @ support.holding
    return np.concatenate([shapes, strains], axis=2)


def held_directions(session: Session) -> Float[np.ndarray, "k 3 3"]:
    """Projector onto the directions in which each of a session's held triangles is held.

    Parameters
    ----------
    session : Session

    Returns
    -------
    (k, 3, 3) float                 in the order of `session.held_triangles`
    """
    directions = np.tile(np.eye(3), (len(session.held_triangles), 1, 1))
    for support in session.supports:
        directions[np.searchsorted(session.held_triangles, support.triangles)] = support.holding
    return directions


def session_surface(
    session: Session, *, rings: int = 1, cache: Cache | None = None
) -> BoundarySurface:
    """Surface of a session's object with its supports.

    Parameters
    ----------
    session : Session
    rings : int                     as for `bem.make_surface`
    cache : Cache or None           a memory keeps it for further pushes

    Returns
    -------
    BoundarySurface
    """
    mesh, held, directions = session.mesh, session.held_triangles, held_directions(session)
    make = partial(
        make_surface, mesh, held, directions=directions, smooth=session.smooth, rings=rings
    )
    key = content_digest((mesh, held, directions, session.smooth, rings))
    return Checkpoints(cache, key).kept_in_memory("surface", make)


def sliding_motion(session: Session) -> MovingSupport | None:
    """The rigid motions of the whole object that its supports do not constrain, as a support.

    Parameters
    ----------
    session : Session

    Returns
    -------
    MovingSupport or None           with the number of the first roller; None: there are none
    """
    rollers = [k for k, support in enumerate(session.supports) if support.directions is not None]
    if not rollers:
        return None
    mesh, held = session.mesh, session.held_triangles
    loose = unrestrained_motions(session_surface(session))
    if not loose.shape[2]:
        return None
    vertices = mesh.vertices
    centre = _box_centre(vertices[np.unique(mesh.triangles[held])])
    length = float(np.sqrt(((vertices - centre) ** 2).sum(axis=1).mean()))
    unit = np.array([1.0, 1.0, 1.0, length, length, length])
    # Projection of each motion onto the unconstrained ones, in units in which a rotation displaces
    # the object as much as a translation.
    modes = (rigid_modes(vertices, centre) / unit).reshape(-1, 6)
    basis = np.linalg.qr(np.linalg.lstsq(modes, loose.reshape(len(modes), -1), rcond=None)[0])[0]
    return MovingSupport(
        number=rollers[0] + 1,
        triangles=session.supports[rollers[0]].triangles,
        vertices=np.arange(len(vertices)),
        centre=centre,
        motion=FREE,
        free_projector=(basis @ basis.T) * unit / unit[:, None],
    )


def require_balance(session: Session, sliding: MovingSupport | None) -> None:
    """Refuse loads of the probings, or gravity, along motions that no support holds.

    Parameters
    ----------
    session : Session
    sliding : MovingSupport or None     of `sliding_motion`

    Raises
    ------
    InputError                      the message names the probing
    """
    for probing in session.probings:
        forces = [(probing.contact.point, probing.force)]
        forces += [(load.contact.point, _total_force(session.mesh, load)) for load in probing.loads]
        check_balance(sliding, forces, f"probing '{probing.name}'")
    if session.added_gravity is not None and session.density is not None:
        corner = session.mesh.vertices[session.mesh.triangles]
        share = np.einsum("ea,ea->e", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
        middle = share @ corner.sum(axis=1) / 4.0 / share.sum()
        weight = session.density * share.sum() * session.added_gravity
        check_balance(sliding, [(middle, weight)], "[gravity]")


def check_balance(
    sliding: MovingSupport | None, forces: Sequence[tuple[Vector3, Vector3]], prefix: str
) -> None:
    """Refuse forces with a resultant along a motion that no support holds.

    Parameters
    ----------
    sliding : MovingSupport or None     of `sliding_motion`
    forces : sequence of (point, force)     [m], [N]
    prefix : str                    start of the message

    Raises
    ------
    InputError                      more than 5 % of the forces act along such a motion
    """
    if sliding is None:
        return
    point, force = (np.stack(part) for part in zip(*forces, strict=True))
    size = float(np.linalg.norm(force, axis=1).sum())
    pushed = np.abs(np.einsum("ni,niq->q", force, sliding.modes(point)))
    # Moments are divided by the longest lever arm.
    pushed[3:] /= np.linalg.norm(point - sliding.centre, axis=1).max() + np.finfo(float).tiny
    worst = int(np.argmax(pushed))
    if pushed[worst] > _UNANSWERED * size:
        axis = "xyz"[worst % 3]
        motion = (
            f"shifts the object along {axis}" if worst < 3 else f"turns the object about {axis}"
        )
        raise InputError(
            f"{prefix}: {pushed[worst]:.3g} N of its force {motion}, which no support holds"
            f" (support {sliding.number} is a roller): it would slide away; hold that direction too"
            " (directions in [support]), or correct the force"
        )


def compliant_supports(session: Session) -> tuple[int, ...]:
    """Compliant supports: those with a stiffness, or all where `[errors]` has a support compliance.

    Parameters
    ----------
    session : Session

    Returns
    -------
    tuple of int                    indices of the supports, from 0
    """
    every = session.errors.support_compliance > 0.0
    return tuple(
        k for k, support in enumerate(session.supports) if every or support.stiffness is not None
    )


def compliances(session: Session) -> Float[np.ndarray, " s"]:
    """Compliance (displacement over traction) of each of the `compliant_supports`.

    Parameters
    ----------
    session : Session

    Returns
    -------
    (s,) float [m/Pa]               0: rigid
    """
    return np.array([session.supports[k].compliance for k in compliant_supports(session)])


def session_springs(session: Session, system: BoundarySystem) -> Springs | None:
    """Springs under the compliant supports.

    Parameters
    ----------
    session : Session
    system : BoundarySystem         of its object

    Returns
    -------
    Springs or None                 None: all supports are rigid
    """
    compliant = compliant_supports(session)
    if not compliant:
        return None
    rigid = [support.triangles for k, support in enumerate(session.supports) if k not in compliant]
    return make_springs(
        system,
        [session.supports[k].triangles for k in compliant],
        np.concatenate([np.zeros(0, dtype=np.int64), *rigid]),
    )


def weight_on_springs(
    system: BoundarySystem, springs: Springs, body: BodyForce
) -> Float[np.ndarray, " e"]:
    """Traction of a body force's particular solution on every spring.

    Parameters
    ----------
    system : BoundarySystem
    springs : Springs
    body : BodyForce

    Returns
    -------
    (e,) float [N/m]                traction times `traction_length`
    """
    unknowns = np.zeros(system.size)
    first = 3 * system.unknowns.free_vertices.size
    unknowns[first : first + body.support_traction.size] = body.support_traction.ravel()
    return springs.mean_traction @ unknowns * system.traction_length


def support_force(
    system: BoundarySystem, triangles: Int[np.ndarray, " k"], springs: Springs | None
) -> csr_array:
    """Matrix from the unknowns to the force on some held triangles, for a shear modulus of 1 Pa.

    Parameters
    ----------
    system : BoundarySystem
    triangles : (k,) int
    springs : Springs or None       their displacements are further unknowns

    Returns
    -------
    (3, n) sparse [N/m]
    """
    size = system.size + (0 if springs is None else len(springs.support_fraction))
    weights = integral_weights(system.surface, triangles)[system.unknowns.held_sides]
    first = 3 * system.unknowns.free_vertices.size
    side, axis = np.repeat(np.arange(weights.size), 3), np.tile(np.arange(3), weights.size)
    value = np.repeat(weights / system.traction_length, 3)
    return csr_array(coo_array((value, (axis, first + 3 * side + axis)), shape=(3, size)))


def _box_centre(points: Points) -> Vector3:
    """Centre of the bounding box of some points, which does not depend on the mesh."""
    return np.asarray(0.5 * (points.min(axis=0) + points.max(axis=0)))


def _fitted_motion(field: DisplacementField, name: str, support: MovingSupport) -> GivenMotion:
    """Robust rigid motion of the points on a support, and a uniform strain fitted to the rest."""
    on_support = np.isin(field.surface.triangle, support.triangles)
    chosen = on_support & np.isfinite(field.displacement).all(axis=1)
    points, moved = field.points[chosen], field.displacement[chosen]
    where = f"probing '{name}': {field.source}: support {support.number}"
    if len(points) < 3:
        raise InputError(
            f"{where} has {len(points)} measured points; at least three that are not in a line are"
            " needed to tell how it moves: give more, or a rigid motion as support_motion"
        )
    modes = rigid_modes(points, support.centre)
    size = float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
    unit = np.append(np.ones(3), np.full(3, 1.0 / size))
    singular = np.linalg.svd((modes * unit).reshape(-1, 6), compute_uv=False)
    if singular[-1] < _UNSEEN * singular[0]:
        raise InputError(
            f"{where}: its {len(points)} measured points lie in a line, so its turn about that"
            " line is not known; give points beside it, or a rigid motion as support_motion"
        )
    value, spread = _robust_fit(modes, moved)
    middle = points.mean(axis=0)
    strain = _strain(points - middle, moved - modes @ value)
    value[:3] += strain @ (support.centre - middle)
    return GivenMotion(value, spread, strain)


def _robust_fit(
    modes: Float[np.ndarray, "n 3 6"], moved: Points
) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"]]:
    """Motion by iteratively reweighted least squares, and its standard deviations."""
    weight = np.ones(len(moved))
    for _ in range(_ROUNDS):
        normal = np.einsum("n,nip,niq->pq", weight, modes, modes)
        value = np.linalg.solve(normal, np.einsum("n,nip,ni->p", weight, modes, moved))
        length = np.linalg.norm(moved - modes @ value, axis=1)
        level = max(STD_OVER_MEDIAN * known_median(length) / np.sqrt(3.0), np.finfo(float).tiny)
        weight = (_DEGREES + 3.0) / (_DEGREES + (length / level) ** 2)
    return value, level * np.sqrt(np.diag(np.linalg.inv(normal)))


def _strain(offset: Points, rest: Points) -> Float[np.ndarray, "3 3"]:
    """Gradient of the displacement left by a rigid motion; zero normal to coplanar points."""
    return np.linalg.lstsq(offset, rest, rcond=_UNSEEN)[0].T


def _total_force(mesh: TriangleMesh, load: Load) -> Vector3:
    """Force of a load on the object."""
    if load.force is not None:
        return load.force
    # A pressure always acts over given triangles.
    area = area_vectors(mesh)[load.contact.triangles].sum(axis=0)
    return -float(load.pressure or 0.0) * area

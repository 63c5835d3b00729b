"""Contacts of tools, their radii and places: those that a fit with them makes consistent.

A tool moves along a straight line. The object under it does not: a block that is pressed beside its
middle leans, a tool on its flank pushes it over. So the place that the tool touches moves along the
surface, by a millimetre where the object moves by four, and that of a ball most, since it touches
where the surface faces it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from palpate.bem import BoundarySurface, PressureDisc, disc_displacement, disc_potentials
from palpate.checkpoints import Cache, Memory, content_digest
from palpate.errors import InputError, NotConvergedError
from palpate.estimation import FitSettings, ProbeObservations, joint_minimum
from palpate.geometry import (
    CREASE_ANGLE,
    TriangleMesh,
    closest_points,
    interpolation_matrix,
    unit_normals,
)
from palpate.pipeline.model.supports import session_surface
from palpate.pipeline.observations import ungraded_observations
from palpate.probe import LocalSurface, local_surface, tool_contact
from palpate.progress import Progress, part_of
from palpate.records import SLIDES, Contact, Probing, Session, Sphere, Tool
from palpate.shapes import Points, Vector3, Vertices

# Contact radii vary only with the cube root of the modulus, so they converge with the constants.
# The relative tolerance is a tenth of the prior standard deviation of such a radius.
_MOST_CONTACT_ROUNDS, _CONTACT_TOLERANCE = 8, 0.005
# On the graded mesh a contact that changes by less stays as it is, with what the model says of it:
# the modulus of the given mesh alone wanders by a third of a per cent as places of further pushes
# settle.
_STILL, _SETTLED = 0.5 * _CONTACT_TOLERANCE, "settled contacts"
# Slopes of the fitted modulus over the one that radii were computed for, beyond which a secant step
# is no longer trusted.
_SECANT_SLOPES = (-1.0, 0.8)
# At one half the formulae of the contact have a removable singularity.
_LARGEST_RATIO = 0.4999
# A change of place counts this many times less than one of the radius, both over the radius: by
# default it is known four times less well on a contact of 2.5 mm, twice on one of 5 mm.
_POINT_SHARE = 4.0
# Distances, in reaches of the contact, of the points about it at which the object's motion is
# taken, how many there are on each circle, and how many are enough for a plane.
_CIRCLES, _ON_CIRCLE, _ENOUGH = (1.5, 2.0, 2.5), 12, 6
# Share of a change of place that is taken at once: the object moves less sideways under a contact
# that has followed it, so a whole step goes too far, by a quarter on a block.
STEP = 0.75
# Farther than this many reaches the linear model does not follow a contact.
_FARTHEST = 1.0


def with_consistent_contacts(
    session: Session,
    *,
    settings: FitSettings,
    cache: Cache | None,
    displaced: bool,
    progress: Progress,
) -> tuple[Session, list[ProbeObservations], Session]:
    """A session with contacts of its tools that are consistent with the constants fitted to it.

    Parameters
    ----------
    session : Session
    settings : FitSettings
    cache : Cache or None           folder in which what is computed of the body is kept for reuse
    displaced : bool                True: contacts move sideways with the object
    progress : callable             called with the current step (text) and the fraction done

    Returns
    -------
    Session                         with contacts to `_CONTACT_TOLERANCE`
    list of ProbeObservations       of that, with the model of the mesh before grading
    Session                         with the contacts that follow from these, a step nearer

    Raises
    ------
    NotConvergedError               force and displacements do not belong together
    """
    model, fitted, taken = None, list[float](), list[float]()
    earlier, digests, every = None, list[str](), range(len(session.probings))
    observe = partial(ungraded_observations, settings=settings, cache=cache, with_surface=displaced)
    surface = session_surface(session, cache=cache) if displaced else None
    if isinstance(cache, Memory):
        earlier = cache.pushes.get(_SETTLED)
        digests = list(map(content_digest, session.probings))
    if earlier is not None:
        session = earlier.start(session, digests, surface, observe)
    for iteration in range(_MOST_CONTACT_ROUNDS):
        # The number of iterations is not known: each takes half of the remaining progress.
        part = part_of(progress, 1.0 - 0.5**iteration, 1.0 - 0.5 ** (iteration + 1))
        model, observations = observe(session, like=model, progress=part)
        best = joint_minimum(observations, settings)
        fitted.append(float(best.theta[1]))
        # Where contacts are known, it is a new one that moves the modulus, and no secant of it.
        taken.append(_consistent_modulus(taken, fitted) if earlier is None else fitted[-1])
        constants = np.array([best.poisson_ratio, taken[-1]])
        updated = _followed(session, every, observations, surface, constants)
        change = largest_change(session, updated)
        # Responses of all vertices are large, and not needed any more.
        observations = [replace(probe, vertices=None) for probe in observations]
        if change < _CONTACT_TOLERANCE:
            nearer = session
            if earlier is not None:
                nearer = _with_known(session, digests, earlier.nearer)
            nearer = _changed_where_much(nearer, updated, _STILL)
            if isinstance(cache, Memory):
                cache.pushes[_SETTLED] = _Settled.of(digests, session, nearer, constants)
            return session, observations, nearer
        previous, session = session, _changed_where_much(session, updated, _CONTACT_TOLERANCE)
    # What Poisson's ratio that hardly counts leaves of a change is within the error of the radii.
    if change < previous.errors.touched_radius:
        return previous, observations, session
    raise NotConvergedError(
        f"what the tools touch still changes after {_MOST_CONTACT_ROUNDS} fits: the"
        " force and the displacements do not belong together; check tool_radius and the unit of"
        " the force"
    )


def _followed(
    session: Session,
    chosen: Sequence[int],
    observations: Sequence[ProbeObservations],
    surface: BoundarySurface | None,
    constants: Float[np.ndarray, "2"],
) -> Session:
    """A session with some of its contacts as they follow from constants.

    Parameters
    ----------
    observations : sequence of k ProbeObservations      of all k probings
    surface : BoundarySurface or None   of the object; None: contacts stay where they are
    constants : (2,) float              nu and log G
    """
    part = replace(session, probings=tuple(session.probings[k] for k in chosen))
    ratio, modulus = float(constants[0]), float(np.exp(constants[1]))
    for_tools = {"shear_modulus": modulus, "poisson_ratio": min(ratio, _LARGEST_RATIO)}
    if surface is not None:
        seen = (observations[k] for k in chosen)
        surfaces = (probe.surface(probe.load(modulus), ratio) for probe in seen)
        moved = [displacement for displacement in surfaces if displacement is not None]
        part = displaced_contacts(part, surface, moved, **for_tools)
    probings = list(session.probings)
    for k, probing in zip(chosen, with_contact_radii(part, **for_tools).probings, strict=True):
        probings[k] = probing
    return replace(session, probings=tuple(probings))


def has_tools(session: Session) -> bool:
    """Whether a contact's radius follows from its tool."""
    return any(probing.contact.tool is not None for probing in session.probings)


def with_contact_radii(session: Session, *, shear_modulus: float, poisson_ratio: float) -> Session:
    """A session with contact radius and pressure profile computed for each tool.

    Parameters
    ----------
    session : Session
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu < 0.5

    Returns
    -------
    Session                         contacts without a tool stay as they are

    Raises
    ------
    InputError                      a tool that pulls, or that is buried
    NotConvergedError               contact of a tool is not found (`tool_contact`)
    """

    def with_radius(probing: Probing) -> Probing:
        contact = probing.contact
        try:
            settled = settled_contact(
                session,
                contact,
                probing.force,
                shear_modulus=shear_modulus,
                poisson_ratio=poisson_ratio,
            )
        except InputError as error:
            raise InputError(f"probing '{probing.name}': {error}") from error
        return replace(probing, contact=settled)

    return replace(session, probings=tuple(with_radius(probing) for probing in session.probings))


def settled_contact(
    session: Session,
    contact: Contact,
    force: Vector3,
    *,
    shear_modulus: float,
    poisson_ratio: float,
) -> Contact:
    """A contact with the radius and the pressure that follow from its tool.

    Parameters
    ----------
    session : Session               of the object
    contact : Contact               one without a tool stays as it is
    force : (3,) float [N]          of the tool on the object
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu <= 0.5

    Returns
    -------
    Contact

    Raises
    ------
    InputError, NotConvergedError   as `tool_contact`
    """
    tool = contact.tool
    if tool is None:
        return contact
    local = local_surface(session.mesh, contact.point, tool.radius)
    normal_force = -float(local.normal @ force)
    settled = tool_contact(
        tool, local, normal_force, shear_modulus=shear_modulus, poisson_ratio=poisson_ratio
    )
    return replace(contact, radius=settled.radius, traction=settled.traction)


def largest_change(before: Session, after: Session) -> float:
    """Largest `_change` of a contact between two versions of a session [-]."""
    pairs = zip(before.probings, after.probings, strict=True)
    return max(_change(earlier.contact, later.contact) for earlier, later in pairs)


def _change(old: Contact, new: Contact) -> float:
    """Change of a contact: of the spread of its pressure, over it, of its point, over
    `_POINT_SHARE` of the radius, or of its outward traction [-], the largest of these; 1 where the
    traction was not known before."""
    if old.radius is None or new.radius is None:
        return 0.0
    shift = float(np.linalg.norm(new.point - old.point)) / (_POINT_SHARE * new.radius)
    if new.traction is None:
        return shift
    if old.traction is None:
        return 1.0
    ratio = old.radius * old.traction.spread / (new.radius * new.traction.spread)
    return max(shift, abs(ratio - 1.0), abs(old.traction.lever - new.traction.lever))


def displaced_contacts(
    session: Session,
    surface: BoundarySurface,
    moved: Sequence[Vertices],
    *,
    shear_modulus: float,
    poisson_ratio: float,
) -> Session:
    """A session with the contacts of its tools nearer to where these press in the end.

    Parameters
    ----------
    session : Session                       k probings, their tools with contact radii
    surface : BoundarySurface               of the session's mesh
    moved : sequence of k (v, 3) float [m]  displacement of its vertices under each tool
    shear_modulus : float [Pa]              > 0
    poisson_ratio : float [-]               -1 < nu < 0.5

    Returns
    -------
    Session                                 `STEP` of the way; contacts without a tool stay as they
                                            are
    """
    probings = []
    for probing, displacement in zip(session.probings, moved, strict=True):
        contact, tool = probing.contact, probing.contact.tool
        if tool is not None:
            start = contact.start
            local = local_surface(session.mesh, start, tool.radius)
            points, whole = _around(session.mesh, contact, local, surface, displacement)
            shift = np.zeros(3)
            if len(points) >= _ENOUGH:
                under_tool = _under_tool(probing, local, points, shear_modulus, poisson_ratio)
                shift = _shift(
                    probing, tool, local, _plane(contact, local, points, whole - under_tool)
                )
            target = contact.point + STEP * (start + shift - contact.point)
            point = closest_points(session.mesh, target[None]).position[0]
            probing = replace(probing, contact=replace(contact, point=point, first_point=start))
        probings.append(probing)
    return replace(session, probings=tuple(probings))


def _changed_where_much(before: Session, after: Session, least: float) -> Session:
    """The later version of a session, with contacts as they were where they changed by less."""
    return replace(
        after,
        probings=tuple(
            old if _change(old.contact, new.contact) < least else new
            for old, new in zip(before.probings, after.probings, strict=True)
        ),
    )


@dataclass(frozen=True, slots=True)
class _Settled:
    """What fits of a session's first probings ended with.

    Attributes
    ----------
    contacts : digest -> Contact    by the probings as they were given
    nearer : digest -> Contact      those that follow from these, a step nearer
    constants : (2,) float          nu and log G, of which these are the contacts
    """

    contacts: dict[str, Contact]
    nearer: dict[str, Contact]
    constants: Float[np.ndarray, "2"]

    @classmethod
    def of(
        cls,
        digests: Sequence[str],
        settled: Session,
        nearer: Session,
        constants: Float[np.ndarray, "2"],
    ) -> "_Settled":
        """Of probings with these digests, as they were given, and the contacts that were found."""
        before, after = (
            {digest: probing.contact for digest, probing in zip(digests, probings, strict=True)}
            for probings in (settled.probings, nearer.probings)
        )
        return cls(before, after, constants)

    def start(
        self,
        session: Session,
        digests: Sequence[str],
        surface: BoundarySurface | None,
        observe: Callable[[Session], tuple[object, Sequence[ProbeObservations]]],
    ) -> Session:
        """A session with its contacts from these, or, of further probings, with those that follow
        from the same constants.

        Parameters
        ----------
        surface : BoundarySurface or None       as in `_followed`
        observe : function                      session -> observations with its contacts
        """
        further = [k for k, digest in enumerate(digests) if digest not in self.contacts]
        session = _with_known(session, digests, self.contacts)
        if not further:
            return session
        session = _followed(session, further, [], None, self.constants)
        for _ in range(_MOST_CONTACT_ROUNDS):
            _, observations = observe(session)
            updated = _followed(session, further, observations, surface, self.constants)
            if largest_change(session, updated) < _CONTACT_TOLERANCE:
                break
            session = updated
        return session


def _with_known(session: Session, digests: Sequence[str], known: Mapping[str, Contact]) -> Session:
    """A session with the contacts that are known by the digests of its probings as given."""
    return replace(
        session,
        probings=tuple(
            replace(probing, contact=known.get(digest, probing.contact))
            for digest, probing in zip(digests, session.probings, strict=True)
        ),
    )


def _consistent_modulus(taken: Sequence[float], fitted: Sequence[float]) -> float:
    """Logarithm of the modulus for which radii are to be computed next: the last one fitted, from
    the third on a step of the secant method.

    Parameters
    ----------
    taken : sequence of n float         those that radii have been computed for
    fitted : sequence of n + 1 float    fitted with the initial radii, then with each of these
    """
    if len(taken) < 2 or taken[-1] == taken[-2]:
        return fitted[-1]
    slope = (fitted[-1] - fitted[-2]) / (taken[-1] - taken[-2])
    return taken[-1] + (fitted[-1] - taken[-1]) / (1.0 - float(np.clip(slope, *_SECANT_SLOPES)))


def _shift(
    probing: Probing, tool: Tool, local: LocalSurface, plane: Float[np.ndarray, "3 3"]
) -> Vector3:
    """Shift of a contact along the surface [m], from the displacement of the whole object there and
    its derivatives along two tangents.

    With u the displacement along the surface, s that of the tool, g the slope that the surface
    takes and k its curvature, a ball of radius R touches at y where (y + u - s) / R + k y = g. For
    tools of other shapes R is taken as 0, and to one that sticks the surface does not move.
    """
    tangents, shift = local.tangents, np.zeros(2)
    if tool.friction == SLIDES:
        travel = np.zeros(3) if probing.tip_displacement is None else probing.tip_displacement
        shift = tangents @ (travel - plane[0])
    if isinstance(tool, Sphere):
        shift += tool.radius * (plane[1:] @ local.normal)
        shift /= 1.0 + tool.radius * max(local.curvature, 0.0)
    length, farthest = float(np.linalg.norm(shift)), _FARTHEST * probing.contact.reach
    return shift @ tangents * min(1.0, farthest / max(length, np.finfo(float).tiny))


def _plane(
    contact: Contact, local: LocalSurface, places: Points, displacement: Points
) -> Float[np.ndarray, "3 3"]:
    """Displacement [m] at a contact and its derivatives along two tangents, of the whole object:
    from a displacement without that under the tool's pressure, which has neither at the centre."""
    offset = (places - contact.point) @ local.tangents.T
    # A curved surface lies lower away from the contact.
    terms = np.column_stack([np.ones(len(offset)), offset, (offset**2).sum(axis=1)])
    return np.linalg.lstsq(terms, displacement, rcond=None)[0][:3]


def _under_tool(
    probing: Probing,
    local: LocalSurface,
    places: Points,
    shear_modulus: float,
    poisson_ratio: float,
) -> Points:
    """Displacement of a half space under the force along its normal, (p, 3) [m]."""
    contact = probing.contact
    pressing = float(local.normal @ probing.force) * local.normal
    disc = PressureDisc(contact.point, contact.reach, contact.pressure)
    constant, slope = disc_displacement(
        disc, disc_potentials(contact.pressure), local.normal, places
    )
    return (constant + poisson_ratio * slope) @ pressing / shear_modulus


def _around(
    mesh: TriangleMesh,
    contact: Contact,
    local: LocalSurface,
    surface: BoundarySurface,
    displacement: Vertices,
) -> tuple[Points, Points]:
    """Points about a contact on the same face of the object, and their displacement [m]."""
    angle = 2.0 * np.pi * np.arange(_ON_CIRCLE) / _ON_CIRCLE
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    offset = np.concatenate([reach * circle @ local.tangents for reach in _CIRCLES])
    near = closest_points(mesh, contact.point + contact.reach * offset)
    level = unit_normals(mesh)[near.triangle] @ local.normal > np.cos(CREASE_ANGLE)
    rows = np.flatnonzero(level)
    at_points = interpolation_matrix(
        surface.displacement, near.triangle[rows], near.barycentric[rows]
    )
    return near.position[rows], at_points @ displacement

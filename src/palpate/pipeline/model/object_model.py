"""Boundary element model of a session's object, with its loads, weight and moving supports."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.bem import (
    BodyForce,
    BoundarySystem,
    CentredSystem,
    PointEquations,
    RightHand,
    Springs,
    check_memory,
    held_system,
    point_equations,
)
from palpate.pipeline.model.compliant_supports import compliant_supports, session_springs
from palpate.pipeline.model.load_table import LoadTable, make_load_table
from palpate.pipeline.model.moving_supports import (
    MovingSupport,
    moving_supports,
    require_balance,
    session_surface,
    sliding_motion,
    support_shapes,
)
from palpate.progress import Progress, silent
from palpate.records import GIVEN, RIGID, Session


@dataclass(frozen=True, slots=True, eq=False)
class ContactPoints:
    """Integral equations for the displacement of the contact points.

    Attributes
    ----------
    equations : PointEquations            for every patch
    right : RightHand                     the same columns as for the system
    """

    equations: PointEquations
    right: RightHand


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
    tips : ContactPoints or None          None where no tip was measured
    centred : CentredSystem or None       the system, factorised for several models of it to share
    """

    session: Session
    system: BoundarySystem
    loads: LoadTable
    supports: tuple[MovingSupport, ...]
    slides: bool
    right: RightHand
    body: BodyForce | None
    tips: ContactPoints | None
    springs: Springs | None = None
    centred: CentredSystem | None = None

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
    cache: Path | None = None,
    perturbed: bool = True,
    like: ObjectModel | None = None,
    progress: Progress = silent,
) -> ObjectModel:
    """Compute all integrals for a session's object, its loads, its weight and its supports.

    Parameters
    ----------
    session : Session
    rings : int                       as `bem.SurfaceSettings`
    cache : Path or None              folder in which what is computed of the body is kept for
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
    boundary = session_surface(session, rings=rings)
    loads = make_load_table(
        session, boundary, support_shapes(session, supports), perturbed=perturbed
    )
    if like is not None:
        system = like.system
    else:
        system = held_system(boundary, dense=compliant, cache=cache, progress=progress)
    right, body = loads.integrate(system)
    tips = None
    if any(probing.tip_displacement is not None for probing in session.probings):
        patches = loads.patches.values()
        equations = point_equations(
            system,
            np.array([patch.triangle for patch in patches]),
            np.array([patch.barycentric for patch in patches]),
        )
        tips = ContactPoints(equations, loads.integrate(equations.system)[0])
    return ObjectModel(
        session, system, loads, supports, sliding is not None, right, body, tips,
        session_springs(session, system), None if like is None else like.centred,
    )  # fmt: skip

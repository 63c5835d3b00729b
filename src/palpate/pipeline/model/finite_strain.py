"""Finite-strain corrections for a session whose object was pressed far.

The constants are estimated with a linear model from corrected measurements: the difference between
two finite element solutions, one at finite strain and one linear, both under the same loads and
with the latest constants, is subtracted first (defect correction). The discretisation error of the
elements cancels in the difference. Where a probing names a ball that slides, the linear solution is
that for the contact circle of the linear model, and the finite-strain solution that for the ball
itself, pressed in by the same force.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array

from palpate.errors import InputError
from palpate.geometry import mesh_quality
from palpate.pipeline.model.contacts.outward import outward_load
from palpate.pipeline.model.grading import halved_session
from palpate.progress import Progress, silent
from palpate.records import FIXED, SLIDES, SPHERE, Probing, Session
from palpate.shapes import Points
from palpate.solids import (
    FinitePress,
    LawOf,
    NeoHookean,
    Solid,
    Sphere,
    Tip,
    held_nodes,
    make_body,
    make_solid,
    press_finite,
    pressure_load,
    solve_finite,
    solve_load,
    surface_values,
)

# Element size away from the tools over the mean edge of the mesh; element size under a tool and the
# radius of that region, over the contact radius.
_COARSE, _FINE, _FINE_REACH = 1.5, 0.4, 1.3
# The same under a ball, whose own shape determines where it touches.
_UNDER_BALL, _BALL_REACH = 0.6, 1.0
# Largest Poisson's ratio for which neo-Hookean elements find an equilibrium.
_LARGEST_RATIO = 0.495


@dataclass(frozen=True, slots=True, eq=False)
class FiniteBody:
    """A session's object in finite elements, with its loads and observed points.

    Attributes
    ----------
    solid : Solid
    held : (n,) bool                     nodes that are fixed
    loads : tuple of (n, 3) float [N]    nodal forces of each probing, as in the linear model
    tips : tuple of Tip or None          of each probing, where its contact is solved for at finite
                                         strain; None: the load stays as it is
    observed : tuple of sparse (p, n)    of each probing: takes nodes to its points and, where the
                                         tip's displacement was measured, to the contact point
    """

    solid: Solid
    held: Bool[np.ndarray, " n"]
    loads: tuple[Float[np.ndarray, "n 3"], ...]
    tips: tuple[Tip | None, ...]
    observed: tuple[csr_array, ...]


def make_finite_body(session: Session, *, coarser: float = 1.0) -> FiniteBody:
    """Fill a session's object with tetrahedra, finer under its tools.

    Parameters
    ----------
    session : Session
    coarser : float [-]             factor on the usual edge length of all elements

    Returns
    -------
    FiniteBody

    Raises
    ------
    InputError                      a support that moves or slides, a load other than a round patch;
                                    scikit-fem is not installed
    MeshError                       the surface cannot be filled
    """
    _require_fixed(session)
    tips = tuple(_tip(probing) for probing in session.probings)
    fine = []
    for probing, tip in zip(session.probings, tips, strict=True):
        reach, size = (_FINE_REACH, _FINE) if tip is None else (_BALL_REACH, _UNDER_BALL)
        radius = float(probing.contact.radius or 0.0)
        fine.append((probing.contact.point, reach * radius, coarser * size * radius))
    edge = coarser * _COARSE * mesh_quality(session.mesh).edge_mean
    if any(tips):
        # A ball meets the surface as it is curved.
        session = halved_session(session)
    solid = make_solid(session.mesh, edge=edge, fine=fine)
    loads, observed = [], []
    for probing in session.probings:
        share = pressure_load(
            solid,
            probing.contact.point,
            float(probing.contact.radius or 0.0),
            probing.contact.pressure,
        )
        outward = outward_load(solid, probing.contact, probing.force)
        loads.append(share[:, None] * probing.force + outward)
        observed.append(surface_values(solid, _places(probing)))
    held = held_nodes(solid, session.held_triangles)
    return FiniteBody(solid, held, tuple(loads), tips, tuple(observed))


def strain_corrections(
    body: FiniteBody,
    *,
    shear_modulus: float,
    poisson_ratio: float,
    law: LawOf = NeoHookean,
    starts: Sequence[FinitePress | None] = (),
    progress: Progress = silent,
) -> tuple[tuple[Points, ...], tuple[FinitePress | None, ...]]:
    """Displacement at finite strain minus that of the linear elements, for every probing.

    Parameters
    ----------
    body : FiniteBody
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu < 0.5; above 0.495 the correction is that for 0.495
    law : function                  Lame constants mu and lambda [Pa] -> `Law` of finite strain
    starts : sequence               solutions for nearly the same constants to start from; empty:
                                    from rest
    progress : callable

    Returns
    -------
    tuple of (p, 3) float [m]       at its points, then at its contact point where that was measured
    tuple of FinitePress or None    solutions of the probings that have a tip

    Raises
    ------
    SingularSystemError             the held nodes are collinear
    NotConvergedError               no equilibrium at finite strain
    """
    elastic = make_body(
        body.solid,
        body.held,
        shear_modulus=shear_modulus,
        poisson_ratio=min(poisson_ratio, _LARGEST_RATIO),
    )
    starts = starts or [None] * len(body.loads)
    corrections, presses = [], []
    for k, (load, tip, observed) in enumerate(
        zip(body.loads, body.tips, body.observed, strict=True)
    ):
        progress("finite strain", k / len(body.loads))
        pressed = None
        if tip is not None:
            force = float(np.linalg.norm(load.sum(axis=0)))
            pressed = press_finite(elastic, tip, force, law=law, start=starts[k])
            finite = pressed.displacement
        else:
            finite = solve_finite(elastic, load, law=law)
        corrections.append(observed @ (finite - solve_load(elastic, load)))
        presses.append(pressed)
    return tuple(corrections), tuple(presses)


def _tip(probing: Probing) -> Tip | None:
    """A sliding ball that moves along the force through the point that it touched first; None: a
    fixed patch."""
    tool = probing.contact.tool
    if tool is None or tool.shape != SPHERE or tool.friction != SLIDES:
        return None
    return Sphere(tool.radius, probing.contact.start, probing.force)


def _places(probing: Probing) -> Points:
    """Points of a probing, and its contact point where the tip's displacement was measured."""
    field = probing.displacement
    points = np.zeros((0, 3)) if field is None else field.surface.position
    if probing.tip_displacement is None:
        return points
    return np.vstack([points, probing.contact.point])


def _require_fixed(session: Session) -> None:
    for number, support in enumerate(session.supports, start=1):
        if support.motion != FIXED or support.directions is not None:
            raise InputError(
                f"finite strain: support {number} moves or slides; only supports that are fixed are"
                " served: leave --strain finite out"
            )
    for probing in session.probings:
        contact = probing.contact
        if probing.loads or contact.radius is None or contact.pressure_map is not None:
            raise InputError(
                f"finite strain: probing '{probing.name}' has a load that is no round patch under a"
                " tool; leave --strain finite out"
            )

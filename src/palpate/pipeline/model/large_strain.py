"""Estimate for an object that was pressed far: the linear one, corrected until it converges.

The constants are estimated with a linear model from corrected measurements: the difference between
two finite element solutions, one at finite strain and one linear, both under the same loads and
with the latest constants, is subtracted first (defect correction). The discretisation error of the
elements cancels in the difference. Where a probing names a ball that slides, the linear solution is
that for the contact circle of the linear model, and the finite-strain solution that for the ball
itself, pressed in by the same force.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array

from palpate.errors import InputError, NotConvergedError
from palpate.estimation import (
    FitResult,
    FitSettings,
    Nuisance,
    NuisanceParameter,
    ProbeFit,
    ProbeObservations,
    fit,
    fixed_displacement,
)
from palpate.geometry import mesh_quality
from palpate.pipeline.model.contact_loads import outward_load
from palpate.pipeline.model.grading import halved_session
from palpate.progress import Progress, part_of, silent
from palpate.records import FIXED, SLIDES, SPHERE, Probing, Session
from palpate.shapes import Points
from palpate.solids import (
    FinitePress,
    LawOf,
    NeoHookean,
    Solid,
    Sphere,
    SplitNeoHookean,
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

# A correction of 10 % changes by 10 % of itself if the modulus changes by 10 %: each round gains
# about one digit.
_MOST_ROUNDS = 8
_SHEAR_TOLERANCE, _RATIO_TOLERANCE = 1e-3, 5e-4
# At finite strain, soft materials of the same constants differ from each other by a good part of
# their difference from a linear one.
_OTHER_LAWS = 0.3
# Edge ratio of the coarser elements: the error, of second order, is about the change from these.
_COARSER = 1.4
# Fraction of the work that the coarser elements take.
_ROUGH = 0.35
# Element size away from the tools over the mean edge of the mesh; element size under a tool and the
# radius of that region, over the contact radius.
_COARSE, _FINE, _FINE_REACH = 1.5, 0.4, 1.3
# The same under a ball, whose own shape determines where it touches.
_UNDER_BALL, _BALL_REACH = 0.6, 1.0
# Largest Poisson's ratio for which neo-Hookean elements find an equilibrium.
_LARGEST_RATIO = 0.495
# Of one probing: its correction in coarser elements, and the change of that by the other law [m].
_Coarser = tuple[Points, Points]


def fit_at_finite_strain(
    session: Session,
    observations: Sequence[ProbeObservations],
    linear: FitResult,
    settings: FitSettings,
    progress: Progress,
) -> FitResult:
    """Correct a linear estimate for finite strain.

    Parameters
    ----------
    session : Session               of the observations
    observations : sequence of ProbeObservations
    linear : FitResult              of these
    settings : FitSettings
    progress : callable

    Returns
    -------
    FitResult                       with a note on the size of the correction

    Raises
    ------
    InputError                      supports or loads that are not supported at finite strain
    SingularSystemError             as in `strain_corrections`
    NotConvergedError               no equilibrium, or the constants do not converge
    """
    body = make_finite_body(session, coarser=_COARSER)
    rough, corrections, presses = _converged(
        body, observations, linear, settings, (), part_of(progress, 0.0, _ROUGH)
    )
    other, _ = strain_corrections(
        body,
        shear_modulus=rough.estimate.shear_modulus.value,
        poisson_ratio=rough.estimate.poisson_ratio.value,
        law=SplitNeoHookean,
        starts=presses,
    )
    coarser = [
        (correction, law - correction) for correction, law in zip(corrections, other, strict=True)
    ]
    body = make_finite_body(session)
    result, corrections, _ = _converged(
        body, observations, rough, settings, coarser, part_of(progress, _ROUGH, 1.0)
    )
    notes = (*result.estimate.notes, _size_note(observations, corrections))
    probes = [
        _with_correction(probe, correction)
        for probe, correction in zip(result.probes, corrections, strict=True)
    ]
    return replace(result, estimate=replace(result.estimate, notes=notes), probes=tuple(probes))


@dataclass(frozen=True, slots=True, eq=False)
class _FiniteBody:
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


def make_finite_body(session: Session, *, coarser: float = 1.0) -> _FiniteBody:
    """Fill a session's object with tetrahedra, finer under its tools.

    Parameters
    ----------
    session : Session
    coarser : float [-]             factor on the usual edge length of all elements

    Returns
    -------
    _FiniteBody

    Raises
    ------
    InputError                      a support that moves or slides, a load other than a round patch
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
    return _FiniteBody(solid, held, tuple(loads), tips, tuple(observed))


def strain_corrections(
    body: _FiniteBody,
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
    body : _FiniteBody
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


def _converged(
    body: _FiniteBody,
    observations: Sequence[ProbeObservations],
    start: FitResult,
    settings: FitSettings,
    coarser: Sequence[_Coarser],
    progress: Progress,
) -> tuple[FitResult, tuple[Points, ...], tuple[FinitePress | None, ...]]:
    """The estimate from observations of an equivalent linear object, corrected with the given
    elements until the constants converge; its corrections and the solutions that they are from."""
    result = start
    presses: tuple[FinitePress | None, ...] = ()
    errors: Sequence[_Coarser | None] = coarser or [None] * len(observations)
    for iteration in range(_MOST_ROUNDS):
        before = result.estimate
        corrections, presses = strain_corrections(
            body,
            shear_modulus=before.shear_modulus.value,
            poisson_ratio=before.poisson_ratio.value,
            starts=presses,
            progress=part_of(progress, iteration / _MOST_ROUNDS, (iteration + 1) / _MOST_ROUNDS),
        )
        corrected = [
            _corrected(observed, correction, rough)
            for observed, correction, rough in zip(observations, corrections, errors, strict=True)
        ]
        result = fit(corrected, settings=settings)
        now = result.estimate
        shear_change = abs(now.shear_modulus.value / before.shear_modulus.value - 1.0)
        ratio_change = abs(now.poisson_ratio.value - before.poisson_ratio.value)
        if shear_change < _SHEAR_TOLERANCE and ratio_change < _RATIO_TOLERANCE:
            return result, corrections, presses
    raise NotConvergedError(
        f"the constants still change after {_MOST_ROUNDS} corrections for finite strain: the"
        " object is pressed too far for this; press less, or leave --strain finite out"
    )


def _corrected(
    observed: ProbeObservations, correction: Points, rough: _Coarser | None
) -> ProbeObservations:
    n = len(observed.position)
    tip = observed.tip_displacement
    return replace(
        observed,
        displacement=observed.displacement - correction[:n],
        tip_displacement=None if tip is None else tip - correction[n],
        nuisances=(*observed.nuisances, _error(observed.name, correction, rough)),
    )


def _error(name: str, correction: Points, rough: _Coarser | None) -> Nuisance:
    """Error of a correction: other laws, and the elements."""
    errors = [("finite strain", "from linear to neo-Hookean", _OTHER_LAWS, correction)]
    if rough is not None:
        coarse, by_other_law = rough
        errors += [
            ("finite strain", "from one neo-Hookean law to another", 1.0, by_other_law),
            (
                f"finite strain of {name}",
                "from coarser to finer elements",
                1.0,
                correction - coarse,
            ),
        ]
    parameters = (
        NuisanceParameter(f"{of}, in steps {step},", std, of="finite strain", is_model_error=True)
        for of, step, std, _ in errors
    )
    steps = [std * moved.ravel() for *_, std, moved in errors]
    moved = np.stack(steps, axis=1)
    return Nuisance(tuple(parameters), lambda at: fixed_displacement(moved[at.rows], at))


def _with_correction(probe: ProbeFit, correction: Points) -> ProbeFit:
    """Predictions with the correction added back."""
    n = len(probe.predicted)
    left_out = probe.left_out_predicted
    return replace(
        probe,
        predicted=probe.predicted + correction[:n],
        left_out_predicted=None if left_out is None else left_out + correction[:n],
    )


def _size_note(observations: Sequence[ProbeObservations], corrections: Sequence[Points]) -> str:
    """How large the corrections are, in words."""
    shares = [
        _share(observed, correction)
        for observed, correction in zip(observations, corrections, strict=True)
    ]
    worst = int(np.argmax(shares))
    overall = float(np.sqrt(np.mean(np.square(shares))))
    return (
        f"Finite strain: the linear model alone is {100 * overall:.2g} % off here (rms over the"
        f" points; {100 * shares[worst]:.2g} % in {observations[worst].name}); corrected with"
        " neo-Hookean finite elements."
    )


def _share(observed: ProbeObservations, correction: Float[np.ndarray, "p 3"]) -> float:
    """Size of a correction over that of the displacement, where it was measured."""
    measured = np.isfinite(observed.displacement)
    size = float(np.linalg.norm(observed.displacement[measured]))
    applied = correction[: len(measured)][measured]
    return float(np.linalg.norm(applied)) / max(size, float(np.finfo(float).tiny))


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

"""A thin sheet in tension between grips that move: constants against those of finite elements.

The truth are quadratic hexahedra of scikit-fem: one grip shifts and turns as a machine that gives,
the other is pulled by a known force and does not turn against it. A load cell measures the force
along the sheet only; image correlation sees one face between the grips. Run by
`python -m benchmarks.tension [REPEATS]`: with all errors exact but force and noise, and
with errors drawn from their priors.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import skfem
from scipy.spatial.transform import Rotation
from skfem.models.elasticity import lame_parameters, linear_elasticity

from benchmarks.meshes import sheet
from palpate.estimation import ProbeObservations, fit
from palpate.geometry import closest_points
from palpate.pipeline import graded_observations
from palpate.records import (
    EXACT,
    FREE,
    RIGID,
    Contact,
    DisplacementField,
    Probing,
    Session,
    Support,
)
from palpate.records.error_priors import ErrorPriors
from palpate.shapes import Points

SIZE = np.array([0.1, 0.02, 0.001])
GRIP = 0.01
YOUNG, NU = 2e6, 0.45
SHEAR = YOUNG / (2 * (1 + NU))
FORCE = np.array([0.4, 0.0, 0.0])
NOISE = 4e-6
FORCE_ERROR = 0.002
# How the foot moves: a shift [m] and a turn [rad] about the origin.
SHIFT, TURN = np.array([1.5e-4, -4e-5, 2e-4]), np.array([1e-3, 4e-3, -2e-3])
CELLS = (40, 8, 1)
POINTS = (57, 15)


def true_displacement() -> Callable[[Points], Points]:
    """Displacement of points of the sheet [m] from finite elements, and the foot's motion."""
    ends = [np.linspace(0, GRIP, 5), np.linspace(SIZE[0] - GRIP, SIZE[0], 5)]
    along = np.unique(np.concatenate([ends[0], np.linspace(GRIP, SIZE[0] - GRIP, 61), ends[1]]))
    mesh = skfem.MeshHex.init_tensor(along, np.linspace(0, SIZE[1], 15), np.linspace(0, SIZE[2], 3))
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex2()), intorder=4)
    stiffness = skfem.asm(linear_elasticity(*lame_parameters(YOUNG, NU)), basis)
    # Held on the faces of the grips, as the session says; the sheet's edges are free.
    faces = mesh.facets_satisfying(_gripped, boundaries_only=True)
    held = basis.get_dofs(faces).all()
    head = basis.get_dofs(mesh.facets_satisfying(lambda x: _gripped(x) & (x[0] > 0.05)))
    unit = np.zeros(basis.N)
    unit[head.nodal["u^1"]] = unit[head.facet["u^1"]] = unit[head.edge["u^1"]] = 1.0
    moved = skfem.solve(*skfem.condense(stiffness, np.zeros(basis.N), x=unit, D=held))
    moved *= FORCE[0] / (moved @ stiffness @ moved)

    def displacement(points: Points) -> Points:
        inside = np.clip(points.T, 1e-9, SIZE[:, None] * (1 - 1e-7))
        stretched = (basis.probes(inside) @ moved).reshape(3, -1).T
        return stretched + SHIFT + np.cross(TURN, points)

    return displacement


def _gripped(x: np.ndarray) -> np.ndarray:
    across = (x[2] < 1e-9) | (x[2] > SIZE[2] - 1e-9)
    return across & ((x[0] < GRIP + 1e-9) | (x[0] > SIZE[0] - GRIP - 1e-9))


def session_of(points: Points, errors: ErrorPriors) -> Session:
    """The sheet between its grips; nothing measured yet."""
    mesh = sheet(SIZE, CELLS)
    gripped = _gripped(mesh.vertices.T)[mesh.triangles].all(axis=1)
    first = mesh.vertices[mesh.triangles][:, :, 0].mean(axis=1) < 0.05
    foot, head = np.flatnonzero(gripped & first), np.flatnonzero(gripped & ~first)
    still = np.zeros_like(points)
    field = DisplacementField(
        points, still, np.full_like(still, NOISE), None, closest_points(mesh, points), "tension"
    )
    contact = Contact(np.array([SIZE[0] - GRIP, 0.01, 0.001]), None, RIGID, head)
    # Nobody knows the forces across: they may be as large as the one along.
    std = np.array([FORCE_ERROR * FORCE[0], FORCE[0], FORCE[0]])
    probing = Probing("n01", contact, FORCE, std, None, None, field, None)
    supports = (Support(foot, FREE), Support(head, FREE))
    held = np.concatenate([foot, head])
    return Session(
        "sheet", Path(), mesh, held, (probing,), None, None, None, (), supports=supports,
        errors=errors,
    )  # fmt: skip


def observed(session: Session) -> ProbeObservations:
    """The sheet as `palpate fit` models it: graded, beside the given mesh."""
    (seen,) = graded_observations(session)
    return seen


def drawn(
    seen: ProbeObservations, truth: Callable[[Points], Points], errors: ErrorPriors, seed: int
) -> ProbeObservations:
    """What is told is wrong by draws from the priors, the points lie where they are told to."""
    rng = np.random.default_rng(seed)
    gain = (1 + errors.force_gain * rng.normal()) * (1 + FORCE_ERROR * rng.normal())
    turn = Rotation.from_rotvec(errors.pose_rotation * rng.normal(size=3))
    shift = errors.pose_translation * rng.normal(size=3)
    scale = 1.0 + errors.length_scale * rng.normal(size=3)
    centre = 0.5 * SIZE
    moved = truth(turn.inv().apply(seen.position - centre - shift) + centre)
    noise = NOISE * rng.normal(size=moved.shape)
    return replace(seen, displacement=scale * turn.apply(moved) + noise, force=gain * FORCE)


def repeated(count: int, errors: ErrorPriors, print_line: Callable[[str], None] = print) -> None:
    """Fit as many noisy copies, and tell error and coverage."""
    x = np.linspace(0.015, 0.085, POINTS[0])
    y = np.linspace(0.0015, 0.0185, POINTS[1])
    points = np.stack([a.ravel() for a in np.meshgrid(x, y, SIZE[2:], indexing="ij")], axis=1)
    truth, session = true_displacement(), session_of(points, errors)
    seen = observed(session)
    constants = {"shear_modulus": SHEAR, "poisson_ratio": NU, "young_modulus": YOUNG}
    estimates = [fit([drawn(seen, truth, errors, seed)]).estimate for seed in range(count)]
    print_line(f"{len(session.mesh.vertices)} vertices, {len(points)} points, {count} repeats")
    for name, true in constants.items():
        values = np.array([getattr(estimate, name).value for estimate in estimates])
        inside = [
            getattr(estimate, name).ci95[0] <= true <= getattr(estimate, name).ci95[1]
            for estimate in estimates
        ]
        width = np.median([np.ptp(getattr(estimate, name).ci95) for estimate in estimates])
        print_line(
            f"{name}: true {true:.5g}, mean {values.mean():.5g}, scatter {values.std():.2g},"
            f" median width of the interval {width:.2g}, holds the truth in"
            f" {100 * np.mean(inside):.0f} %"
        )
    print_line("status: " + ", ".join(sorted({str(estimate.status) for estimate in estimates})))


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    for name, errors in (("exact but for force and noise", EXACT), ("all", ErrorPriors())):
        print(f"errors: {name}", flush=True)
        repeated(count, errors)

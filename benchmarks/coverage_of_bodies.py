"""Do the intervals hold on bodies of unlike shape, with errors drawn from their priors?

The truth comes from quadratic tetrahedra of a much finer surface; what a session tells is wrong by
as much as its laboratory says it may be: force gain and direction, force offsets, contact points,
radii, pose, scale of displacements, noise. Run it with

    python -m benchmarks.coverage_of_bodies FOLDER [SESSIONS [BODY ...]]

for the twelve of `bodies.py`, or by their names for any of these and of `drawn_bodies.py`. FOLDER
keeps the true displacements, which take minutes a body. With clean, exact data it prints the
error of the model; then how often intervals hold.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from benchmarks.bodies import BODIES, Shape
from benchmarks.body_truth import (
    RADIUS,
    SHEAR_MODULUS,
    Contact as Place,
    contacts,
    element_size,
    held_triangles,
    make_truth,
)
from benchmarks.drawn_bodies import DRAWN_BODIES
from palpate.geometry import TriangleMesh, closest_points
from palpate.pipeline import Material, fit_session
from palpate.records import EXACT, Contact, DisplacementField, Estimate, Probing, Session, Status
from palpate.records.error_priors import ErrorPriors
from palpate.shapes import Points, Vector3

NOISE = 0.01
EVERY = BODIES | DRAWN_BODIES
# The farthest that anything moves [m]: small against every body.
FARTHEST = 1e-3
NAMES = ("poisson_ratio", "shear_modulus", "young_modulus")
# Edges of the tetrahedra over `element_size` in the body, and over those of the surface's triangles
# where stresses have no bound (`make_truth`), of two solutions, and of a third where the two differ
# much.
MESHES, FINEST = ((1.4, 0.3), (1.0, 0.15)), (0.7, 0.1)
# Edge of the triangles whose vertices are seen and pressed over those of the mesh that estimates.
SEEN = 0.9
# What a step leaves of the one before: second order of convergence; between first and fourth.
USUAL, LEFT = 1 / 3, (0.7**4, 0.7)
# The truth's own error that is small enough [-]: the model's is to be found within as much.
ENOUGH = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A body with the true displacement of places on it under each of its contacts.

    Attributes
    ----------
    name : str
    mesh : TriangleMesh
    shape : Shape
    points : (p, 3) float [m]       places that are seen, on the true surface
    pushes : tuple of Contact       where, and along which unit force, it is pressed
    moved : (c, p, 3) float [m]     under one newton of each push
    own : float [-]                 what the extrapolation to elements of no size has changed, over
                                    the displacement
    left : float [-]                what the last step of the mesh has left of the one before
    """

    name: str
    mesh: TriangleMesh
    shape: Shape
    points: Points
    pushes: tuple[Place, ...]
    moved: Float[np.ndarray, "c p 3"]
    own: float
    left: float

    @property
    def truth(self) -> dict[str, float]:
        """The constants."""
        return constants(self.shape)

    @property
    def seen(self) -> Int[np.ndarray, " s"]:
        """Places that are seen: those that the support does not hold."""
        held = held_triangles(self.mesh, self.shape)
        around = self.mesh.vertices[np.unique(self.mesh.triangles[held])]
        on_support = held[closest_points(self.mesh, self.points).triangle]
        on_support |= cKDTree(around).query(self.points)[0] < 1e-9
        return np.flatnonzero(~on_support)


def constants(shape: Shape) -> dict[str, float]:
    """The constants of a body."""
    ratio = shape.poisson_ratio
    values = (ratio, SHEAR_MODULUS, 2 * SHEAR_MODULUS * (1 + ratio))
    return dict(zip(NAMES, values, strict=True))


def measured_body(
    name: str,
    folder: Path,
    stiffness: float | None = None,
    *,
    oblique: bool = False,
    seen: float = SEEN,
) -> Measured:
    """Truth of a body on a rigid support, or on springs [N/m^3], pressed inward at three places, or
    eight times, five of them obliquely; computed once. Contacts and places that are seen are
    vertices of another mesh, unless `seen` is 1: they lie anywhere in the triangles of the one that
    estimates."""
    shape = EVERY[name]
    mesh, other = shape.make(shape.edge), shape.make(seen * shape.edge)
    places = contacts(other, shape)
    pushes = (*places, *oblique_pushes(places)) if oblique else tuple(places)

    def solved(edge: float, rim: float) -> Float[np.ndarray, "c p 3"]:
        return _solved(name, other.vertices, folder, edge, rim, stiffness, pushes)

    coarse, fine = (solved(*sizes) for sizes in MESHES)
    step, left = fine - coarse, USUAL
    # The steps shrink as a geometric series does.
    if np.linalg.norm(step) * left / (1.0 - left) > ENOUGH * np.linalg.norm(fine):
        first, middle = step, fine
        fine = solved(*FINEST)
        step = fine - middle
        # Aitken's extrapolation.
        left = float(np.clip((first * step).sum() / (first**2).sum(), *LEFT))
    rest = step * left / (1.0 - left)
    difference = np.linalg.norm(rest) / np.linalg.norm(fine)
    return Measured(name, mesh, shape, other.vertices, pushes, fine + rest, float(difference), left)


def oblique_pushes(places: Sequence[Place]) -> list[Place]:
    """Five pushes at the same places, 31 degrees off the normal to one side or another."""
    pushes = []
    for location, side in zip((*places, *places[:2]), (1.0, 1.0, 1.0, -1.0, -1.0), strict=True):
        along = np.cross(location.inward, [0.3, 0.9, 0.2])
        if side < 0.0:
            along = np.cross(location.inward, along)
        force = location.inward + 0.6 * along / np.linalg.norm(along)
        pushes.append(Place(location.point, force / np.linalg.norm(force)))
    return pushes


def _solved(
    name: str,
    points: Points,
    folder: Path,
    edge: float,
    rim: float,
    stiffness: float | None,
    pushes: Sequence[Place],
) -> Float[np.ndarray, "c p 3"]:
    on_springs = "" if stiffness is None else f"_{stiffness:g}"
    count = f"_{len(pushes)}" if len(pushes) > 3 else ""
    file = folder / f"{name}_{edge}_{rim}{on_springs}{count}_at_{len(points)}.npy"
    if not file.exists():
        shape = EVERY[name]
        truth = make_truth(
            shape,
            edge=edge * element_size(shape.make(shape.edge), shape),
            rim=rim * shape.edge,
            support_stiffness=stiffness,
        )
        moved = [
            truth.at(truth.displacement(push.point, push.inward, RADIUS), points) for push in pushes
        ]
        folder.mkdir(parents=True, exist_ok=True)
        np.save(file, np.stack(moved))
    return np.load(file)


def drawn_errors(
    priors: ErrorPriors, rng: np.random.Generator
) -> tuple[float, Rotation, Rotation, Vector3, Vector3]:
    """Errors that all pushes share: gain and axes of the gauge, turn and shift [m] of the object,
    and factors on lengths."""
    gain = 1.0 + priors.force_gain * rng.normal()
    axes = Rotation.from_rotvec(priors.force_direction * rng.normal(size=3))
    turn = Rotation.from_rotvec(priors.pose_rotation * rng.normal(size=3))
    shift = priors.pose_translation * rng.normal(size=3)
    scale = 1.0 + priors.length_scale * rng.normal(size=3)
    return gain, axes, turn, shift, scale


def session(body: Measured, errors: ErrorPriors, noise: float, seed: int) -> Session:
    """What a laboratory tells, wrong by draws from its priors."""
    # Other draws on every body.
    rng, mesh = np.random.default_rng([seed, list(EVERY).index(body.name)]), body.mesh
    held = np.flatnonzero(held_triangles(mesh, body.shape))
    seen = body.seen
    gain, axes, turn, shift, scale = drawn_errors(errors, rng)
    centre = mesh.vertices.mean(axis=0)
    points = turn.apply(body.points[seen] - centre) + centre + shift
    surface = closest_points(mesh, points)
    probings = []
    for k, (location, moved) in enumerate(zip(body.pushes, body.moved, strict=True)):
        push = FARTHEST / float(np.linalg.norm(moved, axis=1).max())
        moved = push * moved
        force = push * (gain * axes.apply(location.inward) + errors.force * rng.normal(size=3))
        beside = errors.contact_point * rng.normal(size=3)
        beside -= beside @ location.inward * location.inward
        point = closest_points(mesh, (location.point + beside)[None]).position[0]
        radius = RADIUS * (1.0 + errors.contact_radius * float(np.clip(rng.normal(), -2.5, 2.5)))
        sigma = noise * float(np.sqrt((moved**2).mean()))
        field = scale * turn.apply(moved[seen]) + sigma * rng.normal(size=(len(seen), 3))
        # No camera sees what the tool covers.
        field[np.linalg.norm(body.points[seen] - location.point, axis=1) < RADIUS] = np.nan
        std = np.full_like(field, sigma) if noise else None
        displacement = DisplacementField(surface.position, field, std, None, surface, "truth")
        probings.append(
            Probing(
                f"n{k}", Contact(point, radius, "smooth"), force, None, None, None, displacement,
                None,
            )
        )  # fmt: skip
    return Session(
        body.name, Path(), mesh, held, tuple(probings), None, None, None, (), errors=errors
    )


def errors_of(estimate: Estimate, truth: dict[str, float]) -> str:
    """Errors of E and nu with their standard deviations."""
    young, ratio = estimate.young_modulus, estimate.poisson_ratio
    true = truth["young_modulus"]
    return (
        f"E {100 * (young.value / true - 1):+6.2f} % (+- {100 * young.std / true:4.2f})   "
        f"nu {ratio.value - truth['poisson_ratio']:+.4f} (+- {ratio.std:.4f})   {estimate.status}"
    )


def held(estimate: Estimate, truth: dict[str, float]) -> np.ndarray:
    """Which constants its intervals hold, (3,) bool."""
    ends = [getattr(estimate, name).ci95 for name in NAMES]
    return np.array(
        [low <= truth[name] <= high for name, (low, high) in zip(NAMES, ends, strict=True)]
    )


def counts(every: Sequence[np.ndarray]) -> str:
    """How often each constant's interval held."""
    return ", ".join(f"{name} {n}" for name, n in zip(NAMES, np.sum(every, axis=0), strict=True))


def main() -> None:
    """Print errors of clean data, and how often intervals hold."""
    folder, count = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 20
    every: list[np.ndarray] = []
    uneven = 0
    for name in sys.argv[3:] or BODIES:
        body = measured_body(name, folder)
        clean = fit_session(session(body, EXACT, 0.0, 0), cache=folder / "integrals").estimate
        print(
            f"{name:10s} nu {body.shape.poisson_ratio:.2f}, {len(body.mesh.vertices)} vertices, "
            f"truth extrapolated by {100 * body.own:.2f} %, its steps by {body.left:.2f} each"
        )
        print(f"{'':10s} clean                 {errors_of(clean, body.truth)}", flush=True)
        holding = []
        for seed in range(count):
            noisy = session(body, ErrorPriors(), NOISE, seed)
            fitted = fit_session(noisy, cache=folder / "integrals", material=Material.AUTO)
            estimate = fitted.estimate
            uneven += estimate.status is Status.HETEROGENEOUS
            holding.append(held(estimate, body.truth))
            print(
                f"{'':10s} session {seed:2d}            {errors_of(estimate, body.truth)}",
                flush=True,
            )
        every += holding
        print(f"{'':10s} of {count}: {counts(holding)}", flush=True)
    print(
        f"of {len(every)} sessions intervals hold: {counts(every)}; called heterogeneous: {uneven}"
    )


if __name__ == "__main__":
    main()

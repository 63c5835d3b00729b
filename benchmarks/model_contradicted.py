"""How often a fit says that its model does not hold: of sessions that obey it, and of others.

A session is answered as by `palpate fit`, which looks for a field of moduli where one modulus is
contradicted or less likely: its status is then no longer ok.

The truth comes from quadratic tetrahedra, the fit from boundary elements on a coarser surface, so
that truthful sessions carry an ordinary error of discretisation. Noise is added anew in every
session: independent from point to point, or shared over some millimetres as by windows that
overlap. A fault may hide in the errors that a laboratory grants: then the intervals are to hold
what the sound part of the body is made of. Run it with
`python -m benchmarks.model_contradicted [SESSIONS [NOISE ...]]`, NOISE as in `NOISES`: "1 %".
"""

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from benchmarks.bodies import Shape
from benchmarks.body_truth import RADIUS, SHEAR_MODULUS, Contact as Place, contacts, graded_solid
from benchmarks.coverage import unit_noise
from benchmarks.coverage_of_bodies import NAMES, held
from palpate.estimation import FitResult, ProbeObservations, fit
from palpate.field import DECISIVE, evidence_of_errors, explanations
from palpate.geometry import TriangleMesh, closest_points
from palpate.lab.specimens import block, cylinder, half_ball, toy
from palpate.pipeline import graded_observations, refined_session
from palpate.pipeline.model.grading import graded_session
from palpate.records import Contact, DisplacementField, Probing, Session, Status
from palpate.records.contact import smooth_pressure
from palpate.solids.finite_elements import (
    free_part,
    hooke_moduli,
    pressure_load,
    quadratic_basis,
    stiffness_matrix,
    surface_values,
)
from palpate.solids.sparse_cholesky import factorise
from palpate.solids.tetrahedra import Solid

POISSON_RATIO = 0.3
TRUTH = dict(
    zip(NAMES, (POISSON_RATIO, SHEAR_MODULUS, 2 * SHEAR_MODULUS * (1 + POISSON_RATIO)), strict=True)
)
BODIES = {
    "half ball": Shape(lambda edge: half_ball(radius=0.04, edge=edge), 7e-3),
    "cylinder": Shape(lambda edge: cylinder(radius=0.02, height=0.06, edge=edge), 6e-3),
    "block": Shape(lambda edge: block(length=0.08, width=0.05, height=0.03, edge=edge), 6.5e-3),
    "toy": Shape(lambda edge: toy(radius=0.03, edge=edge), 6e-3),
}
# Edge of the tetrahedra at the rim of the support, over that of the surface's triangles.
_RIM = 0.15
# Noise over the root mean square motion, the length it is shared over [m], share of outliers.
NOISES = {
    "0.1 %": (0.001, 0.0, 0.0),
    "1 %": (0.01, 0.0, 0.0),
    "10 %": (0.1, 0.0, 0.0),
    "10 %, 5 % gross outliers": (0.1, 0.0, 0.05),
    "1 %, shared over 4 mm": (0.01, 4e-3, 0.0),
    "10 %, shared over 4 mm": (0.1, 4e-3, 0.0),
    "5 %, shared over 8 mm": (0.05, 8e-3, 0.0),
    "10 %, shared over 8 mm": (0.1, 8e-3, 0.0),
}


@dataclass(frozen=True, slots=True)
class Fault:
    """How a truth differs from what its session says.

    Attributes
    ----------
    moduli : callable or None       points of quadrature (3, ...) -> factor on the stiffness
    fibre : float                   stiffness along z is raised by so many times the shear modulus
    held : callable or None         nodes (n, 3) of the support -> whether they are held in truth
    contact_shift : float [m]       the tool really pressed so far beside its contact point
    """

    moduli: Callable[[np.ndarray], np.ndarray] | None = None
    fibre: float = 0.0
    held: Callable[[np.ndarray], np.ndarray] | None = None
    contact_shift: float = 0.0


def _three_quarters(nodes: np.ndarray) -> np.ndarray:
    """Where a support holds that has come loose over a quarter of its width."""
    low, high = nodes[:, 0].min(), nodes[:, 0].max()
    return nodes[:, 0] > low + 0.25 * (high - low)


def _inclusion(point: np.ndarray) -> np.ndarray:
    """A ball of 20 mm inside every one of the bodies, off their axes."""
    centre = np.array([5e-3, 0.0, 14e-3])
    far = np.linalg.norm(point - centre.reshape(3, *(1,) * (point.ndim - 1)), axis=0)
    return np.where(far < 10e-3, 5.0, 1.0)


FAULTS = {
    "none": Fault(),
    "contact 5 mm off": Fault(contact_shift=5e-3),
    "half of the support loose": Fault(held=lambda x: x[:, 0] > 0.0),
    "a quarter of the support loose": Fault(held=_three_quarters),
    "stiffer along z": Fault(fibre=6.0),
    # Young's modulus along z rises by the fibre's stiffness alone.
    "1.3 times as stiff along z": Fault(fibre=0.3 * 2.0 * (1.0 + POISSON_RATIO)),
    "an inclusion five times as stiff": Fault(moduli=_inclusion),
    "stiff on one side": Fault(moduli=lambda x: np.where(x[0] > 5e-3, 5.0, 1.0)),
}


def truth(
    mesh: TriangleMesh,
    places: Sequence[Place],
    solid: Solid,
    held: Bool[np.ndarray, " n"],
    fault: Fault,
) -> list[np.ndarray]:
    """True displacement of the mesh's vertices in every probing."""
    basis = quadratic_basis(solid)
    moduli = hooke_moduli(SHEAR_MODULUS, POISSON_RATIO)
    moduli[2, 2, 2, 2] += fault.fibre * SHEAR_MODULUS
    if fault.moduli is not None:
        factor = fault.moduli(np.asarray(basis.global_coordinates()))
        moduli = moduli[..., None, None] * factor
    if fault.held is not None:
        on_support = np.flatnonzero(held)
        held = np.zeros_like(held)
        held[on_support] = fault.held(solid.nodes[on_support])
    solver = factorise(free_part(stiffness_matrix(basis, moduli), held), solid.nodes[~held])
    values = surface_values(solid, mesh.vertices)
    moved = []
    for push in places:
        along = np.cross(push.inward, [0.3, 0.9, 0.2])
        shift = fault.contact_shift * along / np.linalg.norm(along)
        point = closest_points(mesh, (push.point + shift)[None]).position[0]
        load = pressure_load(solid, point, RADIUS, smooth_pressure)[:, None] * push.inward
        nodal = np.zeros(solid.nodes.shape)
        nodal[~held] = solver.solve(load[~held].reshape(-1, 1)).reshape(-1, 3)
        moved.append(values @ nodal)
    return moved


def exact_session(mesh: TriangleMesh, places: Sequence[Place], moved: list[np.ndarray]) -> Session:
    """A session of these probings, all free vertices seen, displacements as given."""
    base = on_base(mesh)
    seen = np.flatnonzero(~base)
    surface = closest_points(mesh, mesh.vertices[seen])
    probings = tuple(
        Probing(
            name=f"n{k}", contact=Contact(push.point, RADIUS, "smooth"), force=push.inward,
            force_std=np.full(3, 0.005), tip_displacement=None, tip_displacement_std=None,
            displacement=DisplacementField(
                mesh.vertices[seen], u[seen], None, seen, surface, "truth"
            ),
            images=None,
        )
        for k, (push, u) in enumerate(zip(places, moved, strict=True), start=1)
    )  # fmt: skip
    held = np.flatnonzero(base[mesh.triangles].all(axis=1))
    return refined_session(Session("truth", Path(), mesh, held, probings, None, None, None, ()))


def on_base(mesh: TriangleMesh) -> Bool[np.ndarray, " v"]:
    """Vertices that stand on the support."""
    return np.isclose(mesh.vertices[:, 2], 0.0)


def cases() -> Iterator[tuple[str, str, Session, list[ProbeObservations]]]:
    """Body, fault, session as it is fitted, and its exact probings."""
    for name, shape in BODIES.items():
        mesh = shape.make(shape.edge)
        places = contacts(mesh, shape)
        solid, held = graded_solid(shape, edge=shape.edge, rim=_RIM * shape.edge)
        model: list[ProbeObservations] = []
        for fault_name, fault in FAULTS.items():
            moved = truth(mesh, places, solid, held, fault)
            session = exact_session(mesh, places, moved)
            model = model or graded_observations(session)
            free = ~on_base(mesh)
            yield (
                name,
                fault_name,
                graded_session(session),
                [
                    replace(probe, displacement=u[free])
                    for probe, u in zip(model, moved, strict=True)
                ],
            )


def noisy(
    probe: ProbeObservations, share: float, length: float, wild: float, rng: np.random.Generator
) -> ProbeObservations:
    """A probing with noise that is a share of its motion, and some gross outliers."""
    moved = probe.displacement
    sigma = share * float(np.sqrt((moved**2).mean()))
    moved = moved + sigma * unit_noise(probe.position, length, rng)
    far = (rng.random(len(moved)) < wild)[:, None]
    moved = moved + np.where(far, 20.0 * sigma * rng.normal(size=moved.shape), 0.0)
    return replace(probe, displacement=moved)


def cause_of(session: Session, probes: Sequence[ProbeObservations], result: FitResult) -> str:
    """What `palpate fit` says is wrong with one modulus: nothing, or the likeliest cause."""
    likeliest, *_ = explanations(session, probes, result.minimum)
    if likeliest.log_evidence > max(DECISIVE, evidence_of_errors(result.minimum)):
        return likeliest.cause.name.lower()
    return "" if result.estimate.status is Status.OK else "another"


def main() -> None:
    """Print how many sessions of each kind were contradicted or better explained by another model,
    how many of the others hold the truth, and the causes that were named."""
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    noises = [name for name in NOISES if name in sys.argv[2:]] or list(NOISES)
    rng = np.random.default_rng(1)
    print(f"Of {repeats} sessions: said to be wrong; of the others, E and nu held; causes named")
    for body, fault, session, probes in cases():
        for noise in noises:
            given = [
                [noisy(probe, *NOISES[noise], rng) for probe in probes] for _ in range(repeats)
            ]
            fits = [fit(observations) for observations in given]
            causes = [
                cause_of(session, *given_and_fit) for given_and_fit in zip(given, fits, strict=True)
            ]
            others = [fitted for fitted, cause in zip(fits, causes, strict=True) if not cause]
            right = [held(fitted.estimate, TRUTH) for fitted in others] or [np.zeros(3, dtype=int)]
            ratio, _, young = np.sum(right, axis=0)
            named = ", ".join(f"{n} {name}" for name, n in Counter(causes).items() if name)
            print(
                f"{body:10s} {fault:34s} {noise:26s} {repeats - len(others):4d} {young:4d}"
                f" {ratio:4d}  {named}",
                flush=True,
            )


if __name__ == "__main__":
    main()

"""A ball pressed into bodies until it touches a circle of 0.6 of its radius, sliding or sticking.

The truth is the facility's contact on quadratic tetrahedra: nodes do not enter the ball, whose
shape is exact, and slide along it or stick where they touched it first. The session names the ball,
which `slides` or `sticks`; the fit finds what it touches. Run it with

    python -m benchmarks.ball_contacts [BODY ...]

It prints, for a half ball as the virtual bench has it and for some bodies of `bodies.py` (on most
of the others the ball would sink in by its radius first), the circles that were touched, and the
errors of E and nu: of data without noise, all else exact; and with noise and priors as a laboratory
has them by default. Three to six minutes a body.
"""

import sys
from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.bodies import BODIES, Shape
from benchmarks.body_truth import (
    RADIUS,
    SHEAR_MODULUS,
    contacts,
    element_size,
    held_triangles,
    make_truth,
)
from benchmarks.coverage_of_bodies import MESHES, NOISE, constants, errors_of, held
from palpate.geometry import TriangleMesh, closest_points
from palpate.lab import half_ball
from palpate.pipeline import fit_session
from palpate.records import (
    EXACT,
    FRICTIONS,
    SLIDES,
    STICKS,
    Contact,
    DisplacementField,
    Probing,
    Session,
    Sphere,
)
from palpate.records.error_priors import ErrorPriors
from palpate.solids.contact import Press, press, press_to_force
from palpate.solids.tips import Tip

# The half ball has some 600 vertices, too.
SHAPES = {"half_ball": Shape(lambda edge: half_ball(radius=0.04, edge=edge), 5.1e-3), **BODIES}
USUAL = ("half_ball", "slab", "block")
# The touched circle has `RADIUS`.
BALL = RADIUS / 0.6
# Steps to the depth at which a ball sticks: where a node sticks depends on the path.
_STEPS = 24
# The force's standard deviation where everything is exact [N].
_FORCE = 1e-3
_WORDS = {friction: name for name, friction in FRICTIONS.items()}
# Prior errors, and noise over the root mean square displacement.
_KNOWN = {"all else exact": (EXACT, 0.0), "defaults": (ErrorPriors(), NOISE)}


def presses(name: str, mesh: TriangleMesh) -> dict[float, list[Press]]:
    """The presses of a body by friction, one a contact, with displacements of the vertices."""
    shape = SHAPES[name]
    edge, rim = MESHES[-1]
    truth = make_truth(shape, edge=edge * element_size(mesh, shape), rim=rim * shape.edge)
    modulus = 2.0 * SHEAR_MODULUS / (1.0 - shape.poisson_ratio)
    # Hertz' force for the circle on a plane.
    force = 4.0 / 3.0 * modulus * RADIUS**3 / BALL
    by_friction: dict[float, list[Press]] = {SLIDES: [], STICKS: []}
    for spot in contacts(mesh, shape):
        ball, glued = (
            Tip(tool, spot.point - 2.0 * BALL * spot.inward, spot.inward)
            for tool in (Sphere(BALL), Sphere(BALL, friction=STICKS))
        )
        on_plane = press_to_force(truth.body, ball, force)
        sliding = press_to_force(truth.body, ball, force * (RADIUS / on_plane.radius) ** 3)
        depths = sliding.depth * np.arange(1, _STEPS + 1) / _STEPS
        sticking = press(truth.body, glued, depths)[-1]
        for friction, pressed in ((SLIDES, sliding), (STICKS, sticking)):
            moved = truth.at(pressed.displacement, mesh.vertices)
            by_friction[friction].append(replace(pressed, displacement=moved))
    return by_friction


def session(
    name: str, mesh: TriangleMesh, pressed: Iterable[Press], friction: float, noise: float
) -> Session:
    """What a laboratory measures of some presses; no camera sees what the ball covers."""
    shape, rng = SHAPES[name], np.random.default_rng(0)
    held = np.flatnonzero(held_triangles(mesh, shape))
    seen = np.setdiff1d(np.arange(len(mesh.vertices)), np.unique(mesh.triangles[held]))
    points = closest_points(mesh, mesh.vertices[seen])
    tool = Sphere(BALL, friction=friction)
    probings = []
    for k, (spot, measured) in enumerate(zip(contacts(mesh, shape), pressed, strict=True)):
        sigma = noise * float(np.sqrt((measured.displacement**2).mean()))
        field = measured.displacement[seen] + sigma * rng.normal(size=(len(seen), 3))
        field[np.linalg.norm(mesh.vertices[seen] - spot.point, axis=1) < BALL] = np.nan
        std = np.full_like(field, sigma) if noise else None
        displacement = DisplacementField(points.position, field, std, None, points, "truth")
        contact = Contact.under(tool, spot.point, float(np.ptp(mesh.vertices)))
        certain = np.full(3, _FORCE)
        probings.append(
            Probing(f"n{k}", contact, measured.force, certain, None, None, displacement, None)
        )
    return Session(
        name, Path(name), mesh, held, tuple(probings), None, None, None, (), errors=EXACT
    )


def main() -> None:
    """Print the figures, body by body."""
    for name in sys.argv[1:] or USUAL:
        shape = SHAPES[name]
        mesh, truth = shape.make(shape.edge), constants(shape)
        by_friction = presses(name, mesh)
        for friction, assumed in product((SLIDES, STICKS), repeat=2):
            touched = ", ".join(f"{pressed.radius / BALL:.2f}" for pressed in by_friction[friction])
            print(
                f"{name:10s} {_WORDS[friction]}, taken as {_WORDS[assumed]}: circles of {touched}"
                " radii"
            )
            for known, (errors, noise) in _KNOWN.items():
                measured = session(name, mesh, by_friction[friction], assumed, noise)
                estimate = fit_session(replace(measured, errors=errors)).estimate
                holds = ", ".join(
                    "holds" if is_held else "misses" for is_held in held(estimate, truth)
                )
                print(f"  {known:16s}{errors_of(estimate, truth)}   {holds}", flush=True)


if __name__ == "__main__":
    main()

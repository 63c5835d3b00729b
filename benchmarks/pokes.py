"""Pokes without pictures: the force at places nobody poked, by a field of moduli and by a peer.

    python -m benchmarks.pokes FOLDER [--count N ...] [--kind KIND] [--seed S]

A robot pokes a block with three inclusions it does not know of, with a ball, to 2 mm in ten
steps; positions and forces go through the steps of `palpate import pokes`, with the block's
surface. Its force at the same depth at 150 other places is predicted: by the field, by the
homogeneous body, and by a Gaussian process of the stiffness over the place, the usual map of a
palpating robot.

The truth is of tetrahedra half as large as the estimate's, by another assembly, with the modulus
of every quadrature point; what is left under the tool, within 5 mm, is the half space of the
body's own modulus there. FOLDER keeps the truth, which takes minutes; `--check` compares it at
some places with elements that resolve the contact itself.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import brentq, minimize

from benchmarks.bodies import box_mesh
from palpate.geometry import TriangleMesh
from palpate.pipeline import Material, fit_session
from palpate.probe import dent
from palpate.recording import read_pokes, write_pokes
from palpate.records import PokeTable, Session, Sphere, read_session
from palpate.shapes import Points
from palpate.solids import Solid, held_nodes, make_solid, pressure_load, surface_values
from palpate.solids.finite_elements import (
    free_part,
    hooke_moduli,
    quadratic_basis,
    solve_free,
    stiffness_matrix,
)
from palpate.solids.sparse_cholesky import factorise

SIZE, SHEAR_MODULUS, POISSON_RATIO = (0.06, 0.06, 0.03), 7e3, 0.45
TOOL, DEPTHS = Sphere(4e-3), 1e-3 * np.linspace(0.2, 2.0, 10)
# Noise of a force, of a position, and of the depth at which contact begins.
NOISE, PLACE, TOUCH = 3e-3, 10e-6, 0.1e-3
# Centre, radius and ratio of the modulus of each inclusion.
INCLUSIONS = (
    ((0.020, 0.020, 0.018), 8e-3, 5.0),
    ((0.042, 0.024, 0.021), 6e-3, 3.0),
    ((0.028, 0.044, 0.020), 7e-3, 0.3),
)
KINDS = {"homogeneous": (), "inclusions": INCLUSIONS}
PLACES, HELD_OUT = 320, 150
_EDGE, _SPREAD = 3e-3, 1.5


def log_modulus(x: np.ndarray, kind: str) -> np.ndarray:
    """Logarithm of the modulus over that of the rest."""
    total = np.zeros(x.shape[:-1])
    for centre, radius, ratio in KINDS[kind]:
        total = np.where(np.linalg.norm(x - centre, axis=-1) < radius, np.log(ratio), total)
    return total


def places() -> Points:
    """Places of pokes, evenly spread (Halton), 6 mm from the edges or more."""
    number = np.arange(1, PLACES + 1)
    share = np.stack([_radical_inverse(number, base) for base in (2, 3)], axis=1)
    flat = 6e-3 + share * (np.array(SIZE[:2]) - 12e-3)
    return np.column_stack([flat, np.full(PLACES, SIZE[2])])


def _radical_inverse(number: np.ndarray, base: int) -> np.ndarray:
    value, part, rest = np.zeros(len(number)), 1.0 / base, number.copy()
    while rest.any():
        value += part * (rest % base)
        rest //= base
        part /= base
    return value


def _block(edge: float) -> tuple[TriangleMesh, np.ndarray]:
    """The block, and the triangles of its base."""
    mesh = box_mesh(*(1e3 * side for side in SIZE))(edge)
    mesh = TriangleMesh(mesh.vertices + 0.5 * np.array([*SIZE[:2], 0.0]), mesh.triangles)
    return mesh, np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] < 1e-9).all(axis=1))


def _factored(solid: Solid, base: np.ndarray, kind: str):
    held = held_nodes(solid, base)
    basis = quadratic_basis(solid)
    x = np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1)
    moduli = hooke_moduli(1.0, POISSON_RATIO)[..., None, None] * np.exp(log_modulus(x, kind))
    return held, factorise(free_part(stiffness_matrix(basis, moduli), held), solid.nodes[~held])


def smooth(s: np.ndarray) -> np.ndarray:
    """Pressure over the patch on which a load is spread."""
    return np.clip(1.0 - s**2, 0.0, None)


def regular(kind: str, folder: Path) -> Float[np.ndarray, " p"]:
    """Compliance beyond that of a half space at every place, times the shear modulus [1/m]."""
    file = folder / f"pokes_{kind}.npy"
    if not file.exists():
        mesh, base = _block(4e-3)
        solid = make_solid(mesh, edge=_EDGE)
        held, factor = _factored(solid, base, kind)
        load = np.zeros((3 * len(solid.nodes), PLACES))
        for k, point in enumerate(places()):
            load[2::3, k] = pressure_load(solid, point, _SPREAD * _EDGE, smooth)
        seen = (solve_free(held, factor, load) * load).sum(axis=0)
        folder.mkdir(parents=True, exist_ok=True)
        half_space = 2.0695 / (2.0 * np.pi * _SPREAD * _EDGE)
        np.save(file, seen - (1.0 - POISSON_RATIO) * half_space)
    return np.load(file)


def force_at(depth: float, compliance: float) -> float:
    """Force that presses the ball in so far."""

    def excess(force: float) -> float:
        constants = {"shear_modulus": SHEAR_MODULUS, "poisson_ratio": POISSON_RATIO}
        return dent(TOOL, force, **constants) + compliance * force / SHEAR_MODULUS - depth

    return float(brentq(excess, 1e-9, 10.0))


def table(chosen: np.ndarray, compliance: np.ndarray, seed: int) -> PokeTable:
    """Samples of some pokes, with noise."""
    rng, at, rows = np.random.default_rng(seed), places(), []
    for k in chosen:
        touch = TOUCH * rng.normal()
        for depth in DEPTHS:
            force = force_at(depth, compliance[k]) + NOISE * rng.normal()
            offset = np.array([0.0, 0.0, touch - depth])
            rows.append([*(at[k] + offset + PLACE * rng.normal(size=3)), force, k])
    values = np.array(rows)
    number = np.unique(values[:, 4], return_inverse=True)[1]
    up = np.tile([0.0, 0.0, 1.0], (len(values), 1))
    return PokeTable(values[:, :3], values[:, 3:4], up, number, 0)


def gaussian_process(
    point: Float[np.ndarray, "n 2"],
    value: Float[np.ndarray, " n"],
    others: Float[np.ndarray, "m 2"],
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Mean and standard deviation at other places of a Gaussian process with a Matern covariance
    of order 3/2; size, length and noise by the likelihood (Rasmussen and Williams, 2006, 5.9)."""
    mean = value.mean()

    def covariance(first: np.ndarray, second: np.ndarray, theta: np.ndarray) -> np.ndarray:
        scaled = np.linalg.norm(first[:, None] - second, axis=2) * np.sqrt(3.0) / np.exp(theta[1])
        return np.exp(2.0 * theta[0]) * (1.0 + scaled) * np.exp(-scaled)

    def factored(theta: np.ndarray):
        noise = np.exp(2.0 * theta[2]) * np.eye(len(point))
        return cho_factor(covariance(point, point, theta) + noise, lower=True)

    def loss(theta: np.ndarray) -> float:
        factor = factored(theta)
        weighted = (value - mean) @ cho_solve(factor, value - mean)
        return 0.5 * float(weighted) + float(np.log(np.diag(factor[0])).sum())

    std, bounds = np.log(value.std()), [(-6.0, 2.0), (np.log(2e-3), np.log(0.2)), (-7.0, 1.0)]
    starts = [np.array([std, np.log(length), std - 1.5]) for length in (5e-3, 15e-3, 40e-3)]
    solutions = [minimize(loss, start, method="L-BFGS-B", bounds=bounds) for start in starts]
    theta = min(solutions, key=lambda solution: solution.fun).x
    factor, cross = factored(theta), covariance(others, point, theta)
    left = np.exp(2.0 * theta[0]) - np.einsum("mn,nm->m", cross, cho_solve(factor, cross.T))
    return mean + cross @ cho_solve(factor, value - mean), np.sqrt(np.maximum(left, 0.0))


def over_inclusions(at: Points, kind: str) -> np.ndarray:
    """Which places are above an inclusion."""
    above = np.zeros(len(at), dtype=bool)
    for centre, radius, _ in KINDS[kind]:
        above |= np.linalg.norm(at[:, :2] - centre[:2], axis=1) < radius
    return above


def exact(session: Session, chosen: np.ndarray, compliance: np.ndarray) -> Session:
    """Pokes at other places as they are, to the full depth: what is to be predicted."""
    at, depth, probings = places(), float(DEPTHS[-1]), []
    down = np.array([0.0, 0.0, -1.0])
    for k in chosen:
        first = session.probings[0]
        contact = replace(first.contact, point=at[k])
        force = force_at(depth, compliance[k]) * down
        probings.append(
            replace(
                first, name=f"q{k}", contact=contact, force=force, tip_displacement=depth * down
            )
        )
    return replace(session, probings=tuple(probings))


def force_errors(
    predicted: np.ndarray, chosen: np.ndarray, compliance: np.ndarray
) -> Float[np.ndarray, " m"]:
    """Relative error of the force at the full depth, from the depth predicted at the true force."""
    depth = float(DEPTHS[-1])
    errors = []
    for moved, k in zip(predicted, chosen, strict=True):
        true, step = force_at(depth, compliance[k]), 1.01
        power = np.log(force_at(depth * step, compliance[k]) / true) / np.log(step)
        errors.append((depth / moved) ** power - 1.0)
    return np.array(errors)


def run(count: int, kind: str, folder: Path, seed: int) -> None:
    """Print a line for each model."""
    compliance, at = regular(kind, folder), places()
    chosen, others = np.arange(count), np.arange(PLACES - HELD_OUT, PLACES)
    pokes = read_pokes(table(chosen, compliance, seed), TOOL)
    start = folder / f"session_{kind}_{count}_{seed}"
    start.mkdir(exist_ok=True)
    write_pokes(start, pokes, _block(6e-3)[0], TOOL, kind)
    session = read_session(start)
    truth = exact(session, others, compliance)
    above = over_inclusions(at[others], kind)
    lines = {}
    for material in (Material.HOMOGENEOUS, Material.FIELD):
        begin = time.perf_counter()
        result = fit_session(session, material=material)
        (made,) = result.predict(truth)
        off = force_errors(-made.predicted[:, 2], others, compliance)
        within = np.abs(made.predicted[:, 2] + DEPTHS[-1]) < 1.96 * made.std[:, 2]
        seconds = time.perf_counter() - begin
        note = (
            f"E {result.estimate.young_modulus.value:.0f} {result.estimate.status} {seconds:.0f} s"
        )
        lines[material.value] = off, within, note
        for part in () if result.estimate.field is None else result.estimate.field.parts:
            print("   ", part.sentence)
    stiffness = np.log(pokes.force / pokes.depth**1.5)
    mean, std = gaussian_process(pokes.point[:, :2], stiffness, at[others, :2])
    true = np.log([force_at(float(DEPTHS[-1]), compliance[k]) / DEPTHS[-1] ** 1.5 for k in others])
    lines["peer"] = np.exp(mean - true) - 1.0, np.abs(mean - true) < 1.96 * std, ""
    for name, (off, within, note) in lines.items():
        rms = [100 * np.sqrt(np.mean(off[rows] ** 2)) for rows in (above >= 0, above) if rows.any()]
        print(
            f"{kind} {count:4d} pokes {name:12s} rms {rms[0]:5.2f} %, over inclusions"
            f" {rms[-1]:5.2f} %, most {100 * np.abs(off).max():5.1f} %, within 95 %:"
            f" {100 * within.mean():.0f} % {note}",
            flush=True,
        )


def check(kind: str, folder: Path) -> None:
    """The truth against elements that resolve the contact, at some places."""
    compliance, at = regular(kind, folder), places()
    radius = 2e-3
    dented = 3.0 * (1.0 - POISSON_RATIO) / (8.0 * radius)
    for k in (0, 4, 5, *np.flatnonzero(over_inclusions(at, kind))[:5]):
        mesh, base = _block(6e-3)
        solid = make_solid(mesh, edge=5e-3, fine=[(at[k], 2.0 * radius, 0.4e-3)])
        held, factor = _factored(solid, base, kind)
        load = np.zeros((3 * len(solid.nodes), 1))
        hertz = pressure_load(solid, at[k], radius, lambda s: np.sqrt(np.clip(1 - s**2, 0, None)))
        load[2::3, 0] = hertz
        moved = solve_free(held, factor, load).reshape(-1, 3)[:, 2]
        seen = float((surface_values(solid, at[k][None]) @ moved)[0])
        off = (compliance[k] + dented) / seen - 1.0
        print(f"{kind} place {k} {at[k]}: truth off by {100 * off:.2f} %", flush=True)


def main() -> None:
    """Print what is predicted."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pokes", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, nargs="*", default=[40, 80, 150])
    parser.add_argument("--kind", default="inclusions", choices=KINDS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--check", action="store_true")
    given = parser.parse_args()
    if given.check:
        check(given.kind, given.folder)
        return
    for count in given.count:
        run(count, given.kind, given.folder, given.seed)


if __name__ == "__main__":
    main()

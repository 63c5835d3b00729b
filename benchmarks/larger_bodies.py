"""Time and memory of dense matrices and of the compressed operator over the size of a body.

    python -m benchmarks.larger_bodies grow FOLDER [FREQUENCY ...]    time, memory, error
    python -m benchmarks.larger_bodies fit FOLDER FREQUENCY [WAY]     a fit of three probings
    python -m benchmarks.larger_bodies draw FOLDER                    docs/images/larger_bodies.png

A body of frequency f has 10 f^2 + 2 vertices: 16 gives 2562, 32 10 242, 55 30 252, 63 39 692. Each
size has a process of its own, for its peak memory; what was measured is kept in FOLDER and not
measured again. Processor time is told beside the clock: it says the same on a machine that has more
to do.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from benchmarks.machine import ROOT, peak_memory
from benchmarks.meshes import geodesic
from palpate.bem import (
    BoundarySystem,
    CompressedSystem,
    RightHand,
    boundary_system,
    face_columns,
    factorise,
    make_elastic_map,
    make_surface,
    solve,
)
from palpate.bem.compressed import system as compressed
from palpate.bem.compressed.far_field import LeafMoments
from palpate.bem.compressed.iterative import cluster_inverse, solve_compressed
from palpate.bem.compressed.operator import NearBlock
from palpate.bem.compressed.system import LARGEST_DENSE as SIZE_CHOOSES, compressed_system
from palpate.bem.loads.right_hand import joined
from palpate.figures.style import BLUE, GREY, ORANGE, STYLE, open_frame, save_figure
from palpate.geometry import TriangleMesh, closest_points
from palpate.pipeline import fit_session, make_object_model
from palpate.pipeline.model.contact_loads import surface_load
from palpate.records import EXACT, Contact, DisplacementField, Probing, Session

SIZES = (16, 22, 32, 45, 63)
# The matrix of a larger dense model takes more than 8 GB.
LARGEST_DENSE = 32
NEAR_HALF = 0.4999
TICKS = (2500, 5000, 10_000, 20_000, 40_000)
PLACES = np.array([[0.5, 0.3, 0.8], [-0.9, 0.2, 0.3], [0.1, -1.0, 0.2]])
SCALE = 0.04
SHEAR_MODULUS, POISSON_RATIO, NOISE = 20e3, 0.3, 2e-5
CONTACT_RADIUS = 0.006
# The displacements that are fitted come from a body of 16 002 vertices, seen at every sixth.
SOURCE, EVERY = 40, 6


def body(frequency: int) -> TriangleMesh:
    """A lump of 8 cm, unlike on all sides."""
    mesh = geodesic(frequency)
    x = mesh.vertices * np.array([1.0, 1.3, 0.8])
    x *= 1.0 + 0.2 * np.sin(3.0 * x[:, :1]) + 0.1 * np.cos(4.0 * x[:, 1:2] + 2.0 * x[:, 2:])
    return TriangleMesh(SCALE * x, mesh.triangles)


def held(mesh: TriangleMesh) -> np.ndarray:
    """The lowest tenth of its height."""
    z = mesh.vertices[:, 2]
    low = z < z.min() + 0.12 * np.ptp(z)
    return np.flatnonzero(low[mesh.triangles].all(axis=1))


def patches(mesh: TriangleMesh) -> list[np.ndarray]:
    """Triangles within 6 mm of three places."""
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    at = closest_points(mesh, SCALE * PLACES).position
    return [np.flatnonzero(np.linalg.norm(middle - centre, axis=1) < 0.006) for centre in at]


def measured(way: str, frequency: int, folder: Path) -> dict[str, Any]:
    """Time, memory and solutions of nine right-hand sides at one Poisson's ratio."""
    _solved(way, 9)
    clock = _clock()
    system, right, solved = _solved(way, frequency)
    times, peak = clock(), peak_memory()
    solutions = [solved[0]]
    if frequency <= LARGEST_DENSE:
        solutions.append(_solution(system, right, NEAR_HALF)[0])
    free = 3 * system.unknowns.free_vertices.size
    np.save(folder / f"{way}-{frequency}.npy", np.array(solutions)[:, :free])
    return {
        "way": way,
        "vertices": len(system.surface.mesh.vertices),
        "times": times,
        "memory": peak,
        "iterations": solved[1],
        "product": _product_time(system),
        "bytes": _parts(system),
    }


def _solved(way: str, frequency: int) -> tuple[BoundarySystem, RightHand, tuple[np.ndarray, int]]:
    """The integrals of the body, its right-hand sides, their solutions and what these took."""
    mesh = body(frequency)
    make = boundary_system if way == "dense" else compressed_system
    system = make(make_surface(mesh, held(mesh)))
    right = joined([face_columns(system, patch) for patch in patches(mesh)])
    return system, right, _solution(system, right, POISSON_RATIO)


def _solution(system: BoundarySystem, right: RightHand, nu: float) -> tuple[np.ndarray, int]:
    if isinstance(system, CompressedSystem):
        solution = solve_compressed(cluster_inverse(system, nu), right.at(nu), tolerance=1e-8)
        return solution.solution, solution.iterations
    return solve(factorise(system, nu), right.at(nu)), 0


def _product_time(system: BoundarySystem) -> float:
    """Processor time of a product with 24 vectors [s]; none for dense matrices."""
    if not isinstance(system, CompressedSystem):
        return 0.0
    vectors = np.random.default_rng(0).normal(size=(system.size, 24))
    clock = _clock()
    system.product(POISSON_RATIO, vectors)
    return clock()[1]


def _kernel_bytes(part: NearBlock | LeafMoments) -> int:
    return part.traction_kernel.nbytes + part.displacement_kernel.nbytes


def _parts(system: BoundarySystem) -> dict[str, int]:
    if not isinstance(system, CompressedSystem):
        return {"matrix": 8 * system.size**2}
    near, far = system.operator.near, system.operator.far
    return {
        "near": sum(_kernel_bytes(block) for block in near),
        "far": sum(_kernel_bytes(moments) for moments in far.moments.values())
        + sum(matrix.nbytes for matrix in far.interpolation),
    }


def _clock() -> Callable[[], tuple[float, float]]:
    """Seconds since now: of the clock, and of all processors."""
    start = time.perf_counter(), time.process_time()
    return lambda: (time.perf_counter() - start[0], time.process_time() - start[1])


def grow(folder: Path, frequencies: list[int]) -> None:
    """Measure what is not measured yet, and print all of it."""
    for frequency in frequencies:
        for way in ("dense", "compressed") if frequency <= LARGEST_DENSE else ("compressed",):
            file = folder / f"{way}-{frequency}.json"
            if not file.exists():
                subprocess.run(
                    [sys.executable, "-m", "benchmarks.larger_bodies", "one", str(folder), way,
                     str(frequency)],
                    cwd=ROOT, check=True,
                )  # fmt: skip
            print(_line(json.loads(file.read_text()), folder, frequency), flush=True)
    for way, key in (("compressed", "times"), ("compressed", "memory")):
        sizes, values = _series(folder, way, key)
        if (sizes > 1e4).sum() > 1:
            large = sizes > 1e4
            exponent = np.polyfit(np.log(sizes[large]), np.log(values[large]), 1)[0]
            print(f"{way}, {key}: grows with the power {exponent:.2f} past 10 000 vertices")


def _line(row: dict[str, Any], folder: Path, frequency: int) -> str:
    text = (
        f"{row['vertices']:6d} {row['way']:10s} {row['times'][0]:7.1f} s of the clock,"
        f" {row['times'][1]:7.1f} s of processors, {row['memory'] / 1e9:5.2f} GB"
    )
    if row["iterations"]:
        text += f", {row['iterations']} iterations, product with 24 {row['product']:.2f} s"
        both = [folder / f"{way}-{frequency}.npy" for way in ("dense", "compressed")]
        if all(path.exists() for path in both):
            dense, compressed = (np.load(path) for path in both)
            size = np.abs(dense).max(axis=1)
            text += f", error {(np.abs(compressed - dense).max(axis=1) / size).max():.1e}"
    return text


def _series(folder: Path, way: str, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and one figure of all sizes that were measured; of times those of processors."""
    rows = [json.loads(path.read_text()) for path in folder.glob(f"{way}-*.json")]
    rows.sort(key=lambda row: row["vertices"])
    values = [row[key] if key == "memory" else row[key][1] for row in rows]
    return np.array([row["vertices"] for row in rows]), np.array(values, dtype=float)


def fit(folder: Path, frequency: int) -> None:
    """A fit of three probings whose displacements come from the model of another mesh."""
    mesh = body(frequency)
    fields = _fields_on(mesh)
    clock = _clock()
    estimate = fit_session(_session(mesh, fields)).estimate
    wall, processors = clock()
    first = (
        f"{len(mesh.vertices)} vertices ({estimate.settings['vertices']}), 3 probings, status"
        f" {estimate.status}: {wall / 60:.1f} min of the clock, {processors / 60:.1f} min of"
        f" processors, {peak_memory() / 1e9:.2f} GB"
    )
    lines = [first]
    for name, true in (("shear_modulus", SHEAR_MODULUS), ("poisson_ratio", POISSON_RATIO)):
        value = getattr(estimate, name)
        lines.append(f"  {name} {value.value:.9g} +- {value.std:.6g}, true {true:g}")
    lines.append(f"  seconds {estimate.seconds}")
    print("\n".join(lines))
    (folder / f"fit-{len(mesh.vertices)}.txt").write_text("\n".join(lines) + "\n")


def _fields_on(mesh: TriangleMesh) -> list[DisplacementField]:
    """What is seen of the other model; it is gone, with its memory, before the fit begins."""
    source = body(SOURCE)
    silent = _session(source, [None] * len(PLACES))
    model = make_object_model(replace(silent, errors=EXACT))
    elastic = make_elastic_map(
        model.system, shear_modulus=SHEAR_MODULUS, poisson_ratio=POISSON_RATIO
    )
    loads = [surface_load(patch) for patch in model.loads.patches.values()]
    states = elastic.respond(loads, np.array([probing.force for probing in silent.probings]))
    rng = np.random.default_rng(0)
    return [
        _observed(source, mesh, probing.contact.point, state.displacement, rng)
        for probing, state in zip(silent.probings, states, strict=True)
    ]


def _session(mesh: TriangleMesh, fields: Sequence[DisplacementField | None]) -> Session:
    """Pressed inward by half a newton at three places."""
    probings = []
    for k, point in enumerate(closest_points(mesh, SCALE * PLACES).position):
        force = -0.5 * point / np.linalg.norm(point)
        probings.append(
            Probing(
                name=f"n{k + 1}", contact=Contact(point, CONTACT_RADIUS, "smooth"), force=force,
                force_std=None, tip_displacement=None, tip_displacement_std=None,
                displacement=fields[k], images=None,
            )
        )  # fmt: skip
    return Session("lump", Path(), mesh, held(mesh), tuple(probings), None, None, None, ())


def _observed(
    source: TriangleMesh,
    mesh: TriangleMesh,
    contact: np.ndarray,
    displacement: np.ndarray,
    rng: np.random.Generator,
) -> DisplacementField:
    """What is seen of the source's vertices, on the surface of the other mesh."""
    points = source.vertices
    free = np.setdiff1d(np.arange(len(points)), source.triangles[held(source)])[::EVERY]
    seen = free[np.linalg.norm(points[free] - contact, axis=1) > 1.3 * CONTACT_RADIUS]
    noisy = displacement[seen] + NOISE * rng.normal(size=(seen.size, 3))
    return DisplacementField(
        points=points[seen], displacement=noisy, std=np.full((seen.size, 3), NOISE), vertex=None,
        surface=closest_points(mesh, points[seen]), source="",
    )  # fmt: skip


def draw(folder: Path) -> None:
    """Both ways over the number of vertices: time, and memory."""
    largest = _series(folder, "compressed", "times")[0][-1]
    with rc_context(STYLE):
        figure = Figure(figsize=(6.6, 2.9), layout="constrained")
        panels = figure.subplots(1, 2)
        for axes, key, unit, title, power in (
            (panels[0], "times", 1.0, "Processor time [s]", 3),
            (panels[1], "memory", 1e9, "Memory [GB]", 2),
        ):
            for way, colour, shift, side in (
                ("dense", ORANGE, (-8, 2), "right"), ("compressed", BLUE, (-14, 4), "right"),
            ):  # fmt: skip
                sizes, values = _series(folder, way, key)
                axes.loglog(sizes, values / unit, "o-", color=colour, ms=3.5, lw=1.2)
                axes.annotate(
                    way, (sizes[-1], values[-1] / unit), xytext=shift, textcoords="offset points",
                    ha=side, fontsize=7.5, color=colour,
                )  # fmt: skip
            sizes, values = _series(folder, "dense", key)
            last = np.array([sizes[-1], largest])
            further = values[-1] / unit * (last / last[0]) ** power
            axes.loglog(last, further, ":", color=ORANGE, lw=1.0)
            axes.annotate(
                "not measured", (last[1], further[1]), xytext=(-14, -2), ha="right",
                textcoords="offset points", fontsize=7.5, color=ORANGE,
            )  # fmt: skip
            axes.axvline(SIZE_CHOOSES, color=GREY, lw=0.6)
            axes.set_xlabel("Vertices")
            axes.set_title(title, loc="left")
            ticks = [size for size in TICKS if size < 1.1 * largest]
            axes.set_xticks(ticks, [f"{size:,}".replace(",", " ") for size in ticks])
            axes.minorticks_off()
            axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
            open_frame(axes)
        panels[1].annotate(
            "by itself\ncompressed", (SIZE_CHOOSES, 0.97), xycoords=("data", "axes fraction"),
            xytext=(4, 0), textcoords="offset points", va="top", fontsize=7.5, color=GREY,
        )  # fmt: skip
    save_figure(figure, ROOT / "docs" / "images" / "larger_bodies.png")


def main() -> None:
    """Do what the command line asks for."""
    task, folder, rest = sys.argv[1], Path(sys.argv[2]), sys.argv[3:]
    folder.mkdir(parents=True, exist_ok=True)
    if task == "grow":
        grow(folder, [int(argument) for argument in rest] or list(SIZES))
    elif task == "one":
        row = measured(rest[0], int(rest[1]), folder)
        (folder / f"{rest[0]}-{rest[1]}.json").write_text(json.dumps(row))
    elif task == "fit":
        if rest[1:]:
            # By itself, size decides; the body whose displacements are fitted stays compressed.
            compressed.LARGEST_DENSE = 0 if rest[1] == "compressed" else 10 * SOURCE**2
        fit(folder, int(rest[0]))
    else:
        draw(folder)


if __name__ == "__main__":
    main()

"""How near `palpate scan` comes to the truth, on turntables of the virtual facility.

    python -m benchmarks.scanning [--folder FOLDER] [--vertices 2000] [--views]

The time of one dense view; a toy and a half ball of speckle, twelve views 30 degrees apart by
three cameras, noise 1.5 grey levels, rendered into the folder where they are not there yet; then
the toy with unknown poses. Distances are from the exact shape, both ways, over what the
views show; the scan stands on its support, whose plane is given.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.figure import DOOR, Figure
from benchmarks.machine import MADE
from benchmarks.options import Options
from benchmarks.report import with_notes
from palpate.geometry import (
    TriangleMesh,
    checked_mesh,
    enclosed_volume,
    random_points,
    refined_surface,
)
from palpate.lab import SHAPES, choose_variant, make_session, read_lab_config
from palpate.records import read_rig
from palpate.scanning import ScannedSurface, distances, read_scan, scan_surface
from palpate.scanning.poses import posed
from palpate.vision import prepare_pictures, read_pictures, stereo_points

RADIUS = {"toy": 0.035, "half-ball": 0.05}
_VIEWS, _STEP, _VERTICES = 12, 30.0, 2000
# Edges of the true surface: chords of 1 mm leave 4 um of a ball of 35 mm.
_TRUE_EDGE = 1e-3
_CONFIG = """\
format = "palpate-lab/1"
name = "{shape} on a turntable"
seed = 3
[specimen]
shape = "{shape}"
radius = {radius}
edge = 0.002
[material]
young_modulus = 1e5
poisson_ratio = 0.3
[look]
texture = "speckle"
size = 1.1e-3
[stage]
steps = {steps}
rotation = {step}
[head]
distance = 0.8
toward = [1.0, 0.0, 0.45]
[pictures]
noise = 1.5
"""


@dataclass(frozen=True, slots=True)
class Row:
    """Errors of one scan.

    Attributes
    ----------
    near, far : float [m]           95 % and largest distance over what was seen
    all_near : float [m]            95 % over the whole surface, guessed parts too
    flat, smooth : float            relative error of the volume: of flat triangles, and of the
                                    curved ones that the model has
    ratio, typical : float          actual over claimed deviation of the vertices: of the roots of
                                    their mean squares, and of most of them, from the median
    """

    near: float
    far: float
    all_near: float
    flat: float
    smooth: float
    ratio: float
    typical: float


def turntable(folder: Path, shape: str) -> Path:
    """Render a turntable if it is not there; its scan.toml, with the angles and without."""
    root = folder / shape
    if not (root / "session.toml").exists():
        root.mkdir(parents=True)
        config = root / "bench.toml"
        config.write_text(
            _CONFIG.format(shape=shape, radius=RADIUS[shape], steps=_VIEWS - 1, step=_STEP)
        )
        make_session(read_lab_config(config), root, variant=choose_variant())
    head = 'format = "palpate-scan/1"\nlength_unit = "m"\n'
    rig = '[rig]\ncameras = "rig.toml"\n'
    views = [f'[[view]]\nimages = "images/s{k}_{{camera}}.png"\n' for k in range(_VIEWS)]
    table = "[turntable]\npoint = [0, 0, 0]\naxis = [0, 0, 1]\n"
    angles = [f"{view}angle = {_STEP * k}\n" for k, view in enumerate(views)]
    header = f'{head}support = "z=0"\n{rig}{table}'
    (root / "scan.toml").write_text(header + "".join(angles))
    (root / "unknown.toml").write_text(head + rig + "".join(views))
    return root


def compared(shape: str, made: ScannedSurface) -> Row:
    """A scan against the exact shape."""
    true = SHAPES[shape].make(radius=RADIUS[shape], edge=_TRUE_EDGE)
    rng = np.random.default_rng(1)
    on_scan = random_points(made.mesh, 20_000, rng)
    out = distances(on_scan, true)
    back_points = random_points(true, 20_000, rng)
    back = distances(back_points, made.mesh)
    hidden = TriangleMesh(vertices=made.mesh.vertices, triangles=made.mesh.triangles[made.guessed])
    seen_out = distances(on_scan, hidden) > 1e-6
    seen_back = distances(back_points, hidden) > back + 1e-6
    gaps = np.concatenate([out[seen_out], back[seen_back]])
    known = np.isfinite(made.sigma)
    # Chords of a millimetre are as far off as good vertices; the surface between is not.
    curved = TriangleMesh(*refined_surface(true, pieces=2))
    error = distances(made.mesh.vertices[known], curved)
    vertices, triangles = refined_surface(made.mesh, pieces=3)
    smooth = TriangleMesh(vertices=vertices, triangles=triangles)
    volume = enclosed_volume(true)
    return Row(
        near=float(np.quantile(gaps, 0.95)),
        far=float(gaps.max()),
        all_near=float(np.quantile(np.concatenate([out, back]), 0.95)),
        flat=enclosed_volume(made.mesh) / volume - 1.0,
        smooth=enclosed_volume(smooth) / volume - 1.0,
        ratio=float(np.sqrt(np.mean(error**2) / np.mean(made.sigma[known] ** 2))),
        typical=1.4826 * float(np.median(error / made.sigma[known])),
    )


def shape_figures(folder: Path, shape: str, vertices: int) -> list[Figure]:
    """How far the scan of one turntable is from the exact shape."""
    root = turntable(folder, shape)
    start = time.perf_counter()
    scan = read_scan(root / "scan.toml")
    read = time.perf_counter()
    made = scan_surface(scan.views, vertices=vertices, support=scan.support)
    seconds = read - start, time.perf_counter() - read
    row = compared(shape, made)
    _, notes = checked_mesh(made.mesh)
    name = f"scan of the {shape}, {_VIEWS} views"
    distance = (
        f"{len(made.mesh.vertices)} vertices; largest {1e3 * row.far:.3f} mm; over all, guessed"
        f" parts too, {1e3 * row.all_near:.3f} mm; actual over claimed sigma {row.ratio:.2f} in the"
        f" mean square, {row.typical:.2f} from the median; {seconds[0]:.1f} s for the views,"
        f" {seconds[1]:.1f} s to join them"
    )
    return [
        Figure(DOOR, f"{name}: what `palpate check` finds wrong with the mesh", float(len(notes)),
               note="; ".join(notes) or "closed, manifold, outward"),
        Figure(DOOR, f"{name}: distance from the true surface, 95 % of what was seen",
               1e3 * row.near, "mm", note=distance),
        Figure(DOOR, f"{name}: volume of the flat triangles, off by", 100 * abs(row.flat), "%",
               note=f"{100 * row.flat:+.2f} %; of the model's curved ones"
               f" {100 * row.smooth:+.2f} %"),
    ]  # fmt: skip


def pose_figures(folder: Path) -> list[Figure]:
    """Where the views of the toy stood, found from its shape alone."""
    root = turntable(folder, "toy")
    views = read_scan(root / "unknown.toml").views
    start = time.perf_counter()
    placed_views = posed(views)
    seconds = time.perf_counter() - start
    turns, shifts = [], []
    for k, (view, placed) in enumerate(zip(views, placed_views, strict=True)):
        back = Rotation.from_euler("z", -_STEP * k, degrees=True).as_matrix()
        place_true = view.points @ back.T
        turn, _ = Rotation.align_vectors(
            placed.points - placed.points.mean(axis=0), place_true - place_true.mean(axis=0)
        )
        turns.append(np.degrees(turn.magnitude()))
        shifts.append(1e3 * np.linalg.norm(placed.points.mean(axis=0) - place_true.mean(axis=0)))
    name = f"turntable of {_VIEWS} views, unknown poses: largest"
    return [
        Figure(DOOR, f"{name} {what}", float(max(errors)), unit,
               note=f"rms {np.sqrt(np.mean(np.square(errors))):.3f} {unit}; {seconds:.0f} s")
        for what, errors, unit in (("turn", turns, "deg"), ("shift", shifts, "mm"))
    ]  # fmt: skip


def view_figure(folder: Path, shape: str) -> Figure:
    """How long the dense match of one step takes."""
    root = turntable(folder, shape)
    rig = read_rig(root / "rig.toml")
    pictures = read_pictures(rig, "images/s1_{camera}.png", folder=root, what="view")
    seconds = []
    # The first run is not counted: what is compiled once. Processors' time does not know what else
    # a machine does; of several threads it is more than the clock's.
    for _ in range(4):
        start = time.process_time()
        cloud = stereo_points(prepare_pictures(rig, pictures.grey))
        seconds.append(time.process_time() - start)
    size = " x ".join(str(side) for side in rig.cameras[0].size or ())
    return Figure(
        DOOR, f"one dense view of the {shape}, {size} x 3, seconds of processors", min(seconds[1:]),
        "s", note=f"{len(cloud.point)} points; least of 3, threads: {numba.get_num_threads()}",
    )  # fmt: skip


def measure(options: Options) -> list[Figure]:
    """Turntables of the half ball and of the toy; the toy's with unknown poses."""
    folder = MADE / "turntables"
    shapes = ("toy",) if options.quick else tuple(RADIUS)
    figures = [view_figure(folder, shape) for shape in shapes]
    for shape in shapes:
        figures += shape_figures(folder, shape, 500 if options.quick else _VERTICES)
    return figures + pose_figures(folder)


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scanning", description=__doc__)
    parser.add_argument("--folder", type=Path, default=MADE / "turntables")
    parser.add_argument("--vertices", type=int, default=_VERTICES)
    parser.add_argument("--views", action="store_true", help="the time of one dense view only")
    options = parser.parse_args()
    print(with_notes([view_figure(options.folder, shape) for shape in RADIUS]), flush=True)
    if not options.views:
        for shape in RADIUS:
            figures = shape_figures(options.folder, shape, options.vertices)
            print(with_notes(figures), flush=True)
        print(with_notes(pose_figures(options.folder)))


if __name__ == "__main__":
    main()

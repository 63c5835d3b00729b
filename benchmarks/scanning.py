"""How near `palpate scan` comes to the truth, on turntables of the virtual facility.

    python -m benchmarks.scanning [--folder FOLDER] [--vertices 2000] [--views]

Rows: the time of one dense view; a toy and a half ball of speckle, twelve views 30 degrees apart by
three cameras, noise 1.5 grey levels, rendered into the folder where they are not there yet; then
the toy with its poses not told. Distances are from the exact shape, both ways, over what the
views show; the scan stands on its support, whose plane is given.
"""

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.geometry import TriangleMesh, enclosed_volume, refined_surface
from palpate.lab import SHAPES, choose_variant, make_session, read_lab_config
from palpate.records import read_rig
from palpate.scanning import ScannedSurface, distances, read_scan, scan_surface
from palpate.scanning.joining import posed
from palpate.scanning.mending import spread
from palpate.vision import prepare_pictures, read_pictures, stereo_points

RADIUS = {"toy": 0.035, "half-ball": 0.05}
_VIEWS, _STEP = 12, 30.0
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
    place = folder / shape
    if not (place / "session.toml").exists():
        place.mkdir(parents=True)
        config = place / "bench.toml"
        config.write_text(
            _CONFIG.format(shape=shape, radius=RADIUS[shape], steps=_VIEWS - 1, step=_STEP)
        )
        make_session(read_lab_config(config), place, variant=choose_variant())
    head = 'format = "palpate-scan/1"\nlength_unit = "m"\n'
    rig = '[rig]\ncameras = "rig.toml"\n'
    views = [f'[[view]]\nimages = "images/s{k}_{{camera}}.png"\n' for k in range(_VIEWS)]
    table = "[turntable]\npoint = [0, 0, 0]\naxis = [0, 0, 1]\n"
    angles = [f"{view}angle = {_STEP * k}\n" for k, view in enumerate(views)]
    told = f'{head}support = "z=0"\n{rig}{table}'
    (place / "scan.toml").write_text(told + "".join(angles))
    (place / "unknown.toml").write_text(head + rig + "".join(views))
    return place


def compared(shape: str, made: ScannedSurface) -> Row:
    """A scan against the exact shape."""
    true = SHAPES[shape].make(radius=RADIUS[shape], edge=_TRUE_EDGE)
    on_scan = spread(made.mesh, 20_000)
    out = distances(on_scan, true)
    back_points = spread(true, 20_000)
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


def _report_shape(folder: Path, shape: str, vertices: int) -> None:
    place = turntable(folder, shape)
    start = time.perf_counter()
    scan = read_scan(place / "scan.toml")
    read = time.perf_counter()
    made = scan_surface(scan.views, vertices=vertices, support=scan.support)
    row = compared(shape, made)
    print(
        f"{shape}, {_VIEWS} views, {len(made.mesh.vertices)} vertices, watertight:\n"
        f"  distance 95 %, largest       {1e3 * row.near:.3f}, {1e3 * row.far:.3f} mm of what was"
        f" seen; 95 % of all {1e3 * row.all_near:.3f} mm\n"
        f"  volume                       {100 * row.flat:+.2f} % in flat triangles,"
        f" {100 * row.smooth:+.2f} % in the model's curved ones\n"
        f"  actual over claimed sigma    {row.ratio:.2f} in the mean square,"
        f" {row.typical:.2f} from the median\n"
        f"  seconds                      {read - start:.1f} for the views,"
        f" {time.perf_counter() - read:.1f} to join them"
    )


def _report_poses(folder: Path) -> None:
    place = turntable(folder, "toy")
    views = read_scan(place / "unknown.toml").views
    start = time.perf_counter()
    found = posed(views)
    seconds = time.perf_counter() - start
    turns, shifts = [], []
    for k, (view, one) in enumerate(zip(views, found, strict=True)):
        back = Rotation.from_euler("z", -_STEP * k, degrees=True).as_matrix()
        place_true = view.points @ back.T
        turn, _ = Rotation.align_vectors(
            one.points - one.points.mean(axis=0), place_true - place_true.mean(axis=0)
        )
        turns.append(np.degrees(turn.magnitude()))
        shifts.append(np.linalg.norm(one.points.mean(axis=0) - place_true.mean(axis=0)))
    print(
        f"toy, {_VIEWS} views, poses not told:\n"
        f"  pose error, largest          {max(turns):.3f} deg, {1e3 * max(shifts):.3f} mm\n"
        f"  pose error, rms              {np.sqrt(np.mean(np.square(turns))):.3f} deg,"
        f" {1e3 * np.sqrt(np.mean(np.square(shifts))):.3f} mm\n"
        f"  seconds                      {seconds:.1f}"
    )


def _report_view(folder: Path, shape: str) -> None:
    place = turntable(folder, shape)
    rig = read_rig(place / "rig.toml")
    pictures = read_pictures(rig, "images/s1_{camera}.png", folder=place, what="view")
    # The second run: what is compiled once is not timed.
    for _ in range(2):
        start, busy = time.perf_counter(), time.process_time()
        found = stereo_points(prepare_pictures(rig, pictures.grey))
        seconds, busy = time.perf_counter() - start, time.process_time() - busy
    size = " x ".join(str(side) for side in rig.cameras[0].size or ())
    print(
        f"one view of the {shape}, {size} x 3: {len(found.point)} points in {seconds:.1f} s,"
        f" {busy:.1f} s of processors"
    )


def main() -> None:
    """Print all rows."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scanning", description=__doc__)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--vertices", type=int, default=2000)
    parser.add_argument("--views", action="store_true", help="the time of one dense view only")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.folder or Path(scratch)
        for shape in RADIUS:
            _report_view(folder, shape)
        for shape in [] if options.views else RADIUS:
            _report_shape(folder, shape, options.vertices)
        if not options.views:
            _report_poses(folder)


if __name__ == "__main__":
    main()

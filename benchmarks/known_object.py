"""`palpate calibrate object` before a turntable whose truth is known, and what `--refine` does.

    python -m benchmarks.known_object [--folder FOLDER] [--draws 3] [--kind "moved cameras"]

The toy of `benchmarks.scanning` stands before three cameras, in four turns of its table; its mesh
is that of the exact shape. Rigs are wrong in several ways, each drawn several times: cameras that
were moved, with no covariance; a calibration's usual errors, with their covariance; none at all.
How wrong a rig is, is what is left of points of the surface after the best rigid motion, where its
cameras see them as the true ones do: zero for the true rig.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.figure import DOOR, Figure
from benchmarks.machine import MADE
from benchmarks.options import Options
from benchmarks.report import with_notes
from benchmarks.scanning import RADIUS, turntable
from palpate.calibration import view_object
from palpate.geometry import TriangleMesh
from palpate.lab import SHAPES
from palpate.records import Rig, RigCovariance, read_rig
from palpate.shapes import Points
from palpate.vision import calibration_numbers, moved_rig, project, surface_map, triangulate

_TERMS = ("rx", "ry", "rz", "tx", "ty", "tz")
# Far below what any rig is off by [m].
_ROUNDING = 1e-12
_EDGE, _VIEWS, _DRAWS = 2e-3, 4, 3


@dataclass(frozen=True, slots=True, eq=False)
class Wrong:
    """How a rig is wrong.

    Attributes
    ----------
    name : str
    turn, shift : float [rad], [m]  standard deviations, of every camera but the first
    focal : float                   of every focal length, relative
    has_covariance : bool           whether its covariance lies beside it
    """

    name: str
    turn: float
    shift: float
    focal: float
    has_covariance: bool


KINDS = (
    Wrong("moved cameras", np.deg2rad(0.1), 3e-4, 0.0, False),
    Wrong("moved a little", np.deg2rad(0.01), 3e-5, 0.0, False),
    Wrong("as calibrated", np.deg2rad(0.01), 3e-5, 3e-4, True),
    Wrong("right, no covariance", 0.0, 0.0, 0.0, False),
)


def off(rig: Rig, truth: Rig, points: Points) -> float:
    """What a rig leaves of points that it sees as the true one does, rms [m]."""
    pixels = np.stack([project(camera, points) for camera in truth.cameras])
    triangulated = triangulate(rig, pixels, 1.0).point
    centre, middle = points.mean(axis=0), triangulated.mean(axis=0)
    turn, _ = Rotation.align_vectors(points - centre, triangulated - middle)
    rest = points - centre - turn.apply(triangulated - middle)
    return float(np.sqrt((rest**2).sum(axis=1).mean()))


def pose_error(rig: Rig, truth: Rig, centre: Points) -> tuple[float, float]:
    """How far the object is turned [rad] and its middle shifted [m] before the first camera."""
    first, true = rig.cameras[0].T_camera_object, truth.cameras[0].T_camera_object
    away = np.linalg.inv(true) @ first
    moved = away[:3, :3] @ centre + away[:3, 3] - centre
    return float(Rotation.from_matrix(away[:3, :3]).magnitude()), float(np.linalg.norm(moved))


def seen_by_all(rig: Rig, mesh: TriangleMesh) -> Points:
    """Points of the surface that the first camera sees, thinned."""
    camera = rig.cameras[0]
    columns, rows = camera.size or (640, 480)
    surface = surface_map(camera, (rows, columns), mesh.vertices, mesh.triangles)
    return surface.point[surface.triangle >= 0][::50]


def wrong_rig(truth: Rig, kind: Wrong, seed: int) -> tuple[Rig, RigCovariance | None]:
    """A rig that is wrong in one way."""
    rng = np.random.default_rng(seed)
    names, sigma = [], []
    for camera in truth.cameras:
        names += [f"{camera.name}.fx", f"{camera.name}.fy"]
        sigma += [kind.focal * camera.matrix[0, 0], kind.focal * camera.matrix[1, 1]]
    for camera in truth.cameras[1:]:
        names += [f"{camera.name}.{term}" for term in _TERMS]
        sigma += [kind.turn] * 3 + [kind.shift] * 3
    rig = moved_rig(truth, names, np.array(sigma) * rng.normal(size=len(sigma)))
    if not kind.has_covariance:
        return rig, None
    value = calibration_numbers(rig.cameras, names)
    return rig, RigCovariance(tuple(names), value, np.diag(np.square(sigma)), "calibration")


def kind_figures(folder: Path, kind: Wrong, draws: int) -> list[Figure]:
    """What refining makes of rigs that are wrong in one way."""
    root = turntable(folder, "toy")
    truth = read_rig(root / "rig.toml")
    mesh = SHAPES["toy"].make(radius=RADIUS["toy"], edge=_EDGE)
    points, centre = seen_by_all(truth, mesh), mesh.vertices.mean(axis=0)
    instants = [str(root / f"images/s{k}_{{camera}}.png") for k in range(_VIEWS)]
    rows, worse, taken, seconds = [], 0, 0, 0.0
    for seed in range(draws if kind.turn else 1):
        rig, known = wrong_rig(truth, kind, seed)
        start = time.perf_counter()
        view = view_object(rig, mesh, instants, known=known, refine=True)
        seconds += time.perf_counter() - start
        before, after = off(rig, truth, points), off(view.rig, truth, points)
        taken += view.refined is not None and view.refined.better
        worse += after > before + _ROUNDING
        rows.append((before, after, *pose_error(view.rig, truth, centre)))
    before, after, turn, shift = np.sqrt(np.mean(np.square(rows), axis=0))
    name = f"`calibrate object --refine`, {kind.name}"
    note = (
        f"{len(rows)} rigs, off by {1e3 * before:.4f} mm before and {1e3 * after:.4f} mm after,"
        f" refined {taken}; the object's pose off by {np.degrees(turn):.3f} deg,"
        f" {1e3 * shift:.3f} mm; {seconds / len(rows):.0f} s each"
    )
    return [
        Figure(DOOR, f"{name}: rigs made worse", float(worse), note=note),
        Figure(DOOR, f"{name}: rig off by", 1e3 * after, "mm"),
    ]


def measure(options: Options) -> list[Figure]:
    """Rigs that are wrong in all ways."""
    kinds = KINDS[:1] if options.quick else KINDS
    draws = 1 if options.quick else _DRAWS
    return [figure for kind in kinds for figure in kind_figures(MADE / "turntables", kind, draws)]


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.known_object", description=__doc__)
    parser.add_argument("--folder", type=Path, default=MADE / "turntables")
    parser.add_argument("--draws", type=int, default=_DRAWS)
    parser.add_argument("--kind", choices=[kind.name for kind in KINDS])
    options = parser.parse_args()
    for kind in KINDS:
        if options.kind in (None, kind.name):
            figures = kind_figures(options.folder, kind, options.draws)
            print(with_notes(figures), flush=True)


if __name__ == "__main__":
    main()

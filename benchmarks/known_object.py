"""`palpate calibrate object` before a turntable whose truth is known, and what `--refine` does.

    python -m benchmarks.known_object [--folder FOLDER] [--draws 4] [--kind "moved cameras"]

The toy of `benchmarks.scanning` stands before three cameras, in four turns of its table; its mesh
is that of the exact shape. Rigs are wrong in several ways, each drawn several times: cameras that
were moved, with no covariance; a calibration's usual errors, with their covariance; none at all.
How wrong a rig is, is what is left of points of the surface after the best rigid motion, where its
cameras see them as the true ones do: zero for the true rig.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.scanning import RADIUS, turntable
from palpate.calibration import view_object
from palpate.geometry import TriangleMesh
from palpate.lab import SHAPES
from palpate.records import Rig, RigCovariance, read_rig
from palpate.shapes import Points
from palpate.vision import calibration_numbers, moved_rig, project, surface_map, triangulate

_TERMS = ("rx", "ry", "rz", "tx", "ty", "tz")
_EDGE, _VIEWS = 2e-3, 4


@dataclass(frozen=True, slots=True, eq=False)
class Wrong:
    """How a rig is wrong.

    Attributes
    ----------
    name : str
    turn, shift : float [rad], [m]  standard deviations, of every camera but the first
    focal : float                   of every focal length, relative
    told : bool                     whether its covariance lies beside it
    """

    name: str
    turn: float
    shift: float
    focal: float
    told: bool


KINDS = (
    Wrong("moved cameras", np.deg2rad(0.1), 3e-4, 0.0, False),
    Wrong("moved a little", np.deg2rad(0.01), 3e-5, 0.0, False),
    Wrong("as calibrated", np.deg2rad(0.01), 3e-5, 3e-4, True),
    Wrong("right, nothing told", 0.0, 0.0, 0.0, False),
)


def off(rig: Rig, truth: Rig, points: Points) -> float:
    """What a rig leaves of points that it sees as the true one does, rms [m]."""
    pixels = np.stack([project(camera, points) for camera in truth.cameras])
    found = triangulate(rig, pixels, 1.0).point
    centre, middle = points.mean(axis=0), found.mean(axis=0)
    turn, _ = Rotation.align_vectors(points - centre, found - middle)
    rest = points - centre - turn.apply(found - middle)
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
    found = surface_map(camera, (rows, columns), mesh.vertices, mesh.triangles)
    return found.point[found.triangle >= 0][::50]


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
    if not kind.told:
        return rig, None
    value = calibration_numbers(rig.cameras, names)
    return rig, RigCovariance(tuple(names), value, np.diag(np.square(sigma)), "calibration")


def report(folder: Path, kinds: Sequence[Wrong], draws: int) -> None:
    """Print a row of every kind."""
    place = turntable(folder, "toy")
    truth = read_rig(place / "rig.toml")
    mesh = SHAPES["toy"].make(radius=RADIUS["toy"], edge=_EDGE)
    points = seen_by_all(truth, mesh)
    instants = [str(place / f"images/s{k}_{{camera}}.png") for k in range(_VIEWS)]
    centre = mesh.vertices.mean(axis=0)
    for kind in kinds:
        rows, worse, taken, seconds = [], 0, 0, 0.0
        for seed in range(draws if kind.turn else 1):
            rig, known = wrong_rig(truth, kind, seed)
            start = time.perf_counter()
            view = view_object(rig, mesh, instants, known=known, refine=True)
            seconds += time.perf_counter() - start
            before, after = off(rig, truth, points), off(view.rig, truth, points)
            taken += view.refined is not None and view.refined.better
            worse += after > before
            rows.append((before, after, *pose_error(view.rig, truth, centre)))
        before, after, turn, shift = np.sqrt(np.mean(np.square(rows), axis=0))
        print(
            f"{kind.name}, {len(rows)} rigs: off by {1e3 * before:.4f} mm before,"
            f" {1e3 * after:.4f} mm after; refined {taken}, worse {worse};"
            f" object off by {np.degrees(turn):.3f} deg, {1e3 * shift:.3f} mm;"
            f" {seconds / len(rows):.0f} s each",
            flush=True,
        )


def main() -> None:
    """Print all rows."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.known_object", description=__doc__)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--draws", type=int, default=4)
    parser.add_argument("--kind", choices=[kind.name for kind in KINDS])
    options = parser.parse_args()
    kinds = [kind for kind in KINDS if options.kind in (None, kind.name)]
    with tempfile.TemporaryDirectory() as scratch:
        report(options.folder or Path(scratch), kinds, options.draws)


if __name__ == "__main__":
    main()

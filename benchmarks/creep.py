"""Does the modulus over time come out: terms, times, intervals, also under a ball; and how fast.

A body is solved once by the static model, and what it moves is multiplied by c(t) of a compliance
that is known; noise is drawn anew in every repeat.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from palpate.geometry import TriangleMesh, write_mesh
from palpate.pipeline import (
    graded_session,
    make_object_model,
    refined_session,
    session_observations,
)
from palpate.records import read_session
from palpate.relaxation import CreepCompliance

SHEAR, NU = 2e4, 0.3
PRESS = np.array([0.1, 0.0, -1.2])
ELASTIC = CreepCompliance(1.0, np.zeros(0), np.zeros(0))
ONE = CreepCompliance(1.0, np.array([0.4]), np.array([8.0]))
TWO = CreepCompliance(1.0, np.array([0.3, 0.5]), np.array([3.0, 60.0]))
TRUTHS = {"elastic": ELASTIC, "one term": ONE, "two terms": TWO}
RISE, HOLD, INSTANTS = 0.5, 300.0, 300
AT = np.array([1.0, 10.0, 100.0])
SECTION = "Bodies that creep"
_SESSION = """\
format = "palpate-session/1"
[object]
mesh = "mesh.ply"
length_unit = "m"
[support]
plane = {{ point = [0, 0, 0], normal = [0, 0, 1], tolerance = 1e-6 }}
[[probe]]
name = "n01"
contact = {{ point = [0.02, 0.02, 0.04], radius = 0.006, profile = "smooth" }}
force = [{}, {}, {}]
displacement = "n01.csv"
"""
_SERIES = 'series = "n01_series.csv"\n'


def pressed() -> tuple[np.ndarray, np.ndarray]:
    """Times and forces over the largest of a push that is held, (INSTANTS + 20,)."""
    rising = np.linspace(0.0, RISE, 21)
    times = np.append(rising, RISE + np.geomspace(0.05, HOLD, INSTANTS - 1))
    return times, np.minimum(times / RISE, 1.0)


def cube() -> TriangleMesh:
    """A cube of 40 mm, 6 by 6 squares on each face."""
    from_tests = np.linspace(0.0, 0.04, 7)
    grid = np.stack(np.meshgrid(from_tests, from_tests, indexing="ij"), axis=-1).reshape(-1, 2)
    index = np.arange(49).reshape(7, 7)
    a, b, c, d = (index[i : i + 6, j : j + 6].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    flat = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    vertices: list[np.ndarray] = []
    triangles: list[np.ndarray] = []
    for axis in range(3):
        for side in (0.0, 0.04):
            points = np.full((49, 3), side)
            points[:, [(axis + 1) % 3, (axis + 2) % 3]] = grid
            triangles.append((flat if side else flat[:, ::-1]) + 49 * len(vertices))
            vertices.append(points)
    every, number = np.unique(np.round(np.concatenate(vertices), 9), axis=0, return_inverse=True)
    return TriangleMesh(every, number.ravel()[np.concatenate(triangles)])


def write_creeping_session(
    folder: Path, truth: CreepCompliance, *, noise: float = 0.0, seed: int = 0,
    instants: Sequence[int] | None = None, drift: float = 0.0, gain: float = 1.0,
) -> Path:  # fmt: skip
    """A session of a cube that creeps: frames of its upper half, and the force that presses it.

    Parameters
    ----------
    folder : Path                   made here
    truth : CreepCompliance         over 1 / SHEAR
    noise : float                   of every component, over the largest displacement
    seed : int
    instants : numbers or None      that have frames; None: all from the contact on; empty: static
    drift : float                   change of Poisson's ratio over the hold
    gain : float                    force of the session over the true one
    """
    folder.mkdir()
    rng, mesh = np.random.default_rng(seed), cube()
    write_mesh(folder / "mesh.ply", mesh)
    points = mesh.vertices[mesh.vertices[:, 2] > 0.015]
    text = _SESSION.format(*(gain * PRESS))
    (folder / "session.toml").write_text(text)
    _write_field(folder / "n01.csv", points, -1e-4 * np.ones_like(points), 1e-5)
    graded = graded_session(refined_session(read_session(folder)))
    observed = session_observations(graded, make_object_model(graded))[0]
    shapes = [
        (observed.response.value(nu) @ np.append(PRESS, 0.0) / SHEAR).reshape(-1, 3)
        for nu in (NU, NU + 0.01)
    ]
    times, force = pressed()
    moved, std = truth.response(times, force), noise * float(np.abs(shapes[0]).max())
    turn = 100.0 * drift * np.log(np.maximum(times, RISE) / RISE) / np.log(times[-1] / RISE)

    def frame(k: int) -> np.ndarray:
        shape = shapes[0] + turn[k] * (shapes[1] - shapes[0])
        return moved[k] * shape + std * rng.standard_normal(shape.shape)

    _write_field(folder / "n01.csv", points, frame(len(times) - 1), std or 1e-9)
    seen = range(1, len(times)) if instants is None else instants
    rows = ["t,fx,fy,fz,displacement"]
    for k, (at, share) in enumerate(zip(times, force, strict=True)):
        name = f"frame{k}.csv" if k in seen else ""
        if name:
            _write_field(folder / name, points, frame(k), std or 1e-9)
        rows.append(",".join([*map(repr, [float(at), *(gain * share * PRESS).tolist()]), name]))
    if len(seen):
        (folder / "n01_series.csv").write_text("\n".join([*rows, ""]))
        (folder / "session.toml").write_text(text + _SERIES)
    return folder


def _write_field(path: Path, points: np.ndarray, moved: np.ndarray, std: float) -> None:
    rows = np.hstack([points, moved, np.full((len(points), 1), std)])
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", header="x,y,z,ux,uy,uz,sigma", comments="")

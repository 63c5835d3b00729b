"""The paper's method on the rendered sets, and what of its error the default method leaves."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.figure import FLOW, Figure
from benchmarks.machine import SHARED
from benchmarks.options import Options
from palpate.pipeline import FLOW_METHODS, measure_motion
from palpate.records import Session, read_session

RIGID = ("rigid_translation_x", "rigid_translation_y", "rigid_rotation_z")
BALL = "halfball_images"
# Those with truth maps and a single later instant each.
PROBES = ("n01", "n03", "n08", "n11", "n15")
# Pixels around a vertex that a plane is laid through, and how near the nearest one must be: the
# pixels lie 0.31 mm apart, so farther away a vertex is outside of what the camera sees.
_AROUND, _NEAR = 12, 4e-4


@dataclass(frozen=True, slots=True)
class _Compared:
    """Errors of both methods at the vertices that both measured.

    Attributes
    ----------
    name : str                          of the set
    ours, theirs : lists over instants of (k, 3) float [m]
    truth : the same                    the motion itself
    """

    name: str
    ours: list[np.ndarray]
    theirs: list[np.ndarray]
    truth: list[np.ndarray]


def measure(options: Options) -> list[Figure]:
    """Errors of the paper's method by sequence, and the share that is left."""
    sets = [_rigid(name) for name in (RIGID[:1] if options.quick else RIGID)]
    if not options.quick:
        sets.append(_ball())
    return [figure for compared in sets for figure in (_share(compared), *_own(compared))]


def _rigid(name: str) -> _Compared:
    session = read_session(SHARED / name)
    return _compared(session, _moved_by_steps(SHARED / name, session.mesh.vertices))


def _ball() -> _Compared:
    folder = SHARED / BALL
    session = read_session(folder, probes=PROBES)
    truth = [_moved_by_pixels(folder / f"truth_{p}.npz", session.mesh.vertices) for p in PROBES]
    return _compared(session, truth)


def _compared(session: Session, truth: list[np.ndarray]) -> _Compared:
    """Both methods over the same instants, at the same vertices."""
    motions = {
        name: measure_motion(session, method=FLOW_METHODS[name](), pose="given").motions
        for name in ("joint", "lang-pai")
    }
    ours, theirs, moved = [], [], []
    for joint, paper, true in zip(motions["joint"], motions["lang-pai"], truth, strict=True):
        errors = [flow.vertices.displacement - true for flow in (joint, paper)]
        both = np.isfinite(errors).all(axis=(0, 2))
        ours.append(errors[0][both])
        theirs.append(errors[1][both])
        moved.append(true[both])
    return _Compared(session.path.parent.name, ours, theirs, moved)


def _share(compared: _Compared) -> Figure:
    ours, theirs = (_rms(np.concatenate(errors)) for errors in (compared.ours, compared.theirs))
    count = sum(len(error) for error in compared.ours)
    return Figure(
        FLOW,
        f"{compared.name}: share of the paper's method's error that is left",
        ours / theirs,
        note=f"rms of vertex displacement {1e3 * ours:.4f} mm against {1e3 * theirs:.3f} mm at the"
        f" same {count} vertices of {len(compared.ours)} instants",
    )


def _own(compared: _Compared) -> list[Figure]:
    """Rows beside those of `flow_rendered`."""
    rms = [1e3 * _rms(error) for error in compared.theirs]
    title = f"beside it: lang-pai, {compared.name}"
    listed = ", ".join(f"{value:.3g}" for value in rms)
    figures = [
        Figure(FLOW, f"{title}: rms of vertex displacement, worst instant", max(rms), "mm",
               note=f"by instant {listed}")
    ]  # fmt: skip
    if "translation" in compared.name:
        bias = [float(np.mean(_length(e + t) - _length(t))) for e, t in _instants(compared)]
        angle = [float(_angle(e + t, t).std()) for e, t in _instants(compared)[1:]]
        figures += [
            Figure(FLOW, f"{title}: bias of the vertices' displacement, worst step",
                   1e3 * max(map(abs, bias)), "mm"),
            Figure(FLOW, f"{title}: sd of the angle from step 2 on, worst step", max(angle), "deg"),
        ]  # fmt: skip
    return figures


def _instants(compared: _Compared) -> list[tuple[np.ndarray, np.ndarray]]:
    return list(zip(compared.theirs, compared.truth, strict=True))


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vectors, axis=1)


def _angle(vectors: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Angle between rows [degrees]."""
    cosine = (vectors * other).sum(axis=1) / (_length(vectors) * _length(other))
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _rms(vectors: np.ndarray) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def _moved_by_steps(folder: Path, points: np.ndarray) -> list[np.ndarray]:
    """Displacement of points of a rigid object at every step after the first.

    Parameters
    ----------
    folder : Path             of the set, with truth.toml
    points : (n, 3) float [m]

    Returns
    -------
    list of (n, 3) float [m]
    """
    steps = tomllib.loads((folder / "truth.toml").read_text(encoding="utf-8"))["step"]
    return [points @ np.array(step["R"]).T + step["t"] - points for step in steps[1:]]


def _moved_by_pixels(file: Path, points: np.ndarray) -> np.ndarray:
    """Displacement of points of the half ball from the pixels around them.

    Parameters
    ----------
    file : Path               truth_NAME.npz
    points : (n, 3) float [m]

    Returns
    -------
    (n, 3) float [m]          NaN where the reference camera does not see the point
    """
    truth = np.load(file)
    near, which = cKDTree(truth["X"]).query(points, k=_AROUND)
    moved = np.full(points.shape, np.nan)
    for v in np.flatnonzero(near[:, 0] < _NEAR):
        away = truth["X"][which[v]] - points[v]
        design = np.concatenate([np.ones((_AROUND, 1)), away], axis=1)
        moved[v] = np.linalg.lstsq(design, truth["U"][which[v]], rcond=1e-6)[0][0]
    return moved

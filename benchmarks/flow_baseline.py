"""The paper's method on the rendered sets, and what of its error the default method leaves."""

from dataclasses import dataclass

import numpy as np

from benchmarks.figure import FLOW, Figure
from benchmarks.machine import SHARED
from benchmarks.options import Options
from benchmarks.rendered_truth import moved_by_pixels, moved_by_steps
from palpate.pipeline import FLOW_METHODS, measure_motion
from palpate.records import Session, read_session

__all__ = ["measure"]

RIGID = ("rigid_translation_x", "rigid_translation_y", "rigid_rotation_z")
BALL = "halfball_images"
# Those with truth maps and a single later instant each.
PROBES = ("n01", "n03", "n08", "n11", "n15")


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
    return [figure for one in sets for figure in (_share(one), *_own(one))]


def _rigid(name: str) -> _Compared:
    session = read_session(SHARED / name)
    return _compared(session, None, moved_by_steps(SHARED / name, session.mesh.vertices))


def _ball() -> _Compared:
    folder = SHARED / BALL
    session = read_session(folder)
    truth = [moved_by_pixels(folder / f"truth_{p}.npz", session.mesh.vertices) for p in PROBES]
    return _compared(session, PROBES, truth)


def _compared(
    session: Session, probes: tuple[str, ...] | None, truth: list[np.ndarray]
) -> _Compared:
    """Both methods over the same instants, at the same vertices."""
    found = {
        name: measure_motion(
            session, probes=probes, method=FLOW_METHODS[name](), pose="given"
        ).motions
        for name in ("joint", "lang-pai")
    }
    ours, theirs, moved = [], [], []
    for joint, paper, true in zip(found["joint"], found["lang-pai"], truth, strict=True):
        errors = [one.vertices.displacement - true for one in (joint, paper)]
        both = np.isfinite(errors).all(axis=(0, 2))
        ours.append(errors[0][both])
        theirs.append(errors[1][both])
        moved.append(true[both])
    return _Compared(session.path.parent.name, ours, theirs, moved)


def _share(one: _Compared) -> Figure:
    ours, theirs = (_rms(np.concatenate(errors)) for errors in (one.ours, one.theirs))
    count = sum(len(error) for error in one.ours)
    return Figure(
        FLOW,
        f"{one.name}: share of the paper's method's error that is left",
        ours / theirs,
        must=0.1,
        reach=1 / 30,
        note=f"rms of vertex displacement {1e3 * ours:.4f} mm against {1e3 * theirs:.3f} mm at the"
        f" same {count} vertices of {len(one.ours)} instants",
    )


def _own(one: _Compared) -> list[Figure]:
    """Rows beside those of `flow_rendered`."""
    rms = [1e3 * _rms(error) for error in one.theirs]
    title = f"beside it: lang-pai, {one.name}"
    listed = ", ".join(f"{value:.3g}" for value in rms)
    figures = [
        Figure(FLOW, f"{title}: rms of vertex displacement, worst instant", max(rms), "mm",
               note=f"by instant {listed}")
    ]  # fmt: skip
    if "translation" in one.name:
        bias = [float(np.mean(_length(e + t) - _length(t))) for e, t in _instants(one)]
        angle = [float(_angle(e + t, t).std()) for e, t in _instants(one)[1:]]
        figures += [
            Figure(FLOW, f"{title}: bias of the vertices' way, worst step",
                   1e3 * max(map(abs, bias)), "mm"),
            Figure(FLOW, f"{title}: sd of the angle from step 2 on, worst step", max(angle), "deg"),
        ]  # fmt: skip
    return figures


def _instants(one: _Compared) -> list[tuple[np.ndarray, np.ndarray]]:
    return list(zip(one.theirs, one.truth, strict=True))


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vectors, axis=1)


def _angle(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Angle between rows [degrees]."""
    cosine = (one * other).sum(axis=1) / (_length(one) * _length(other))
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _rms(vectors: np.ndarray) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))

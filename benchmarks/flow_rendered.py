"""Rendered sequences with known motion: rigid steps, and a probed half ball."""

import tomllib
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.figure import FLOW, Figure
from benchmarks.machine import SHARED
from benchmarks.options import Options
from palpate.pipeline import (
    SessionFlow,
    fit_session,
    measure_motion,
    with_measured_displacement,
)
from palpate.records import Session, read_rig, read_session
from palpate.vision import (
    JointFlow,
    VertexDisplacement,
    is_valid,
    read_pictures,
)

RIGID = ("rigid_translation_x", "rigid_translation_y", "rigid_rotation_z")
MAPPED = ("n01", "n03", "n05", "n08", "n11", "n15")


@dataclass(frozen=True, slots=True)
class Rigid:
    """Errors of vertex displacements of one sequence, by step."""

    name: str
    error: list[np.ndarray]
    truth: list[np.ndarray]
    square: list[np.ndarray]


def measure(options: Options) -> list[Figure]:
    """All figures from rendered pictures."""
    joint = [_rigid(name) for name in RIGID]
    session = read_session(SHARED / "halfball_images")
    flow = measure_motion(session, pose="given")
    ball, squares = _half_ball(session, flow)
    return [
        *_translations(joint),
        _rotation(joint[2]),
        *ball,
        *_constants(session, flow),
        _sigmas(joint, squares),
        _cameras(),
    ]


def _rigid(name: str) -> Rigid:
    folder = SHARED / name
    truth = tomllib.loads((folder / "truth.toml").read_text(encoding="utf-8"))["step"]
    session = read_session(folder)
    flow = measure_motion(session, pose="given")
    point = session.mesh.vertices
    errors, moves, squares = [], [], []
    for motion, step in zip(flow.motions, truth[1:], strict=True):
        moved = point @ np.array(step["R"]).T + step["t"] - point
        error, square, ok = _errors(motion.vertices, moved)
        errors.append(error)
        moves.append(moved[ok])
        squares.append(square)
    return Rigid(name, errors, moves, squares)


def _errors(
    measured: VertexDisplacement, truth: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors, their squares in claimed sigmas (mean over three components), rows."""
    ok = np.isfinite(measured.displacement).all(axis=1) & np.isfinite(truth).all(axis=1)
    error = (measured.displacement - truth)[ok]
    inverse = np.linalg.inv(measured.covariance[ok])
    return error, np.einsum("ni,nij,nj->n", error, inverse, error) / 3.0, ok


def _translations(joint: list[Rigid]) -> list[Figure]:
    bias, rms, angles = [], [], []
    for rigid in joint[:2]:
        for step, (error, truth) in enumerate(zip(rigid.error, rigid.truth, strict=True), start=1):
            moved = error + truth
            length = np.linalg.norm(moved, axis=1)
            bias.append(float((length - np.linalg.norm(truth, axis=1)).mean()))
            rms.append(float(np.sqrt((error**2).sum(axis=1).mean())))
            if step > 1:
                cosine = (moved * truth).sum(axis=1) / length / np.linalg.norm(truth, axis=1)
                angles.append(float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).std()))
    note = f"{len(joint[0].error[0])} vertices a step, eight steps of 2.5 mm along x and along y"
    return [
        Figure(FLOW, "rigid translation: bias of the vertices' displacement, worst step",
               1e3 * max(map(abs, bias)), "mm", note=note),
        Figure(FLOW, "rigid translation: rms of vertex displacement, worst step", 1e3 * max(rms),
               "mm", note=f"best step {1e3 * min(rms):.3f} mm; {note}"),
        Figure(FLOW, "rigid translation: sd of the angle from step 2 on, worst step", max(angles),
               "deg", note=note),
    ]  # fmt: skip


def _rotation(rigid: Rigid) -> Figure:
    rms = [1e3 * float(np.sqrt((error**2).sum(axis=1).mean())) for error in rigid.error]
    return Figure(
        FLOW, "rigid rotation: rms of vertex displacement at 16 degrees", rms[-1], "mm",
        note="steps of 2 degrees: " + ", ".join(f"{value:.3f}" for value in rms),
    )  # fmt: skip


def _half_ball(session: Session, flow: SessionFlow) -> tuple[list[Figure], list[np.ndarray]]:
    """Errors per point of the reference camera outside occlusion, and of vertices in sigmas."""
    camera = flow.rig.cameras[flow.rig.reference]
    turn = camera.T_camera_object[:3, :3]
    squares, errors, seen, valid = [], [], 0, 0
    for motion in flow.motions:
        if motion.name not in MAPPED:
            continue
        truth = np.load(SHARED / "halfball_images" / f"truth_{motion.name}.npz")
        row = np.full(truth["shape"], -1)
        row.ravel()[truth["pixel"]] = np.arange(len(truth["pixel"]))
        column, line = motion.flow.pixel.astype(int).T
        at = row[line, column]
        open_view = (at >= 0) & ((truth["hidden_rest"] | truth["hidden_loaded"])[at] == 0)
        ok = open_view & is_valid(motion.flow)
        errors.append((motion.flow.displacement[ok] - truth["U"][at[ok]]) @ turn.T)
        seen, valid = seen + int(open_view.sum()), valid + int(ok.sum())
        squares.append(_errors(motion.vertices, _truth_at(truth, session.mesh.vertices))[1])
    rms = 1e3 * np.sqrt((np.concatenate(errors) ** 2).mean(axis=0))
    note = (
        f"{valid} of {seen} points that no camera loses sight of are valid"
        f" ({100 * valid / seen:.0f} %;"
        f" the others lie where a window meets the rod or the outline); {', '.join(MAPPED)}"
    )
    return [
        Figure(FLOW, "half ball: lateral rms per point", float(np.max(rms[:2])), "mm", note=note),
        Figure(FLOW, "half ball: depth rms per point", float(rms[2]), "mm", note=note),
    ], squares  # fmt: skip


def _truth_at(truth: np.lib.npyio.NpzFile, point: np.ndarray) -> np.ndarray:
    """Displacement at vertices from the pixels around: a plane through the nearest twelve."""
    near, which = cKDTree(truth["X"]).query(point, k=12)
    moved = np.full(point.shape, np.nan)
    for v in np.flatnonzero(near[:, 0] < 4e-4):
        design = np.c_[np.ones(12), truth["X"][which[v]] - point[v]]
        moved[v] = np.linalg.lstsq(design, truth["U"][which[v]], rcond=1e-6)[0][0]
    return moved


def _constants(session: Session, flow: SessionFlow) -> list[Figure]:
    truth = tomllib.loads((session.path.parent / "truth.toml").read_text(encoding="utf-8"))
    estimate = fit_session(with_measured_displacement(session, flow)).estimate
    e, nu = estimate.young_modulus, estimate.poisson_ratio
    return [
        Figure(FLOW, "half ball from pictures, 17 probings: error of E",
               100 * abs(e.value / truth["young_modulus"] - 1), "%",
               note=f"E {e.value:.0f} Pa, claimed sigma {e.std:.0f} Pa, 95 % interval"
               f" {e.ci95[0]:.0f} to {e.ci95[1]:.0f}, truth {truth['young_modulus']:.0f}"),
        Figure(FLOW, "half ball from pictures, 17 probings: error of nu",
               abs(nu.value - truth["poisson_ratio"]),
               note=f"nu {nu.value:.4f}, claimed sigma {nu.std:.4f}, 95 % interval"
               f" {nu.ci95[0]:.4f} to {nu.ci95[1]:.4f}, truth {truth['poisson_ratio']}"),
    ]  # fmt: skip


def _sigmas(joint: list[Rigid], ball: list[np.ndarray]) -> Figure:
    sets = {rigid.name: np.concatenate(rigid.square) for rigid in joint}
    sets["halfball_images"] = np.concatenate(ball)
    listed = ", ".join(f"{name} {np.sqrt(value.mean()):.2f}" for name, value in sets.items())
    pooled = float(np.sqrt(np.concatenate(list(sets.values())).mean()))
    return Figure(
        FLOW, "actual over claimed sigma per vertex, all rendered sets", pooled, "x",
        note=f"rms of the error in claimed sigmas; {listed}",
    )  # fmt: skip


def _cameras() -> Figure:
    """Three cameras against the best pair, translation along x, three steps."""
    folder = SHARED / RIGID[0]
    session, rig = read_session(folder), read_rig(folder / "rig.toml")
    error, sigma = {}, {}
    for chosen in ((0, 1, 2), (0, 1), (0, 2)):
        part = replace(rig, cameras=tuple(rig.cameras[c] for c in chosen))
        grey = [
            read_pictures(part, step.images, folder=folder, what=step.name).grey
            for step in session.steps[:4]
        ]
        method = JointFlow()
        state, displacements = method.start(part, grey[0], session.mesh), []
        for pictures in grey[1:]:
            state, flow = method.follow(state, pictures)
            displacements.append(method.vertices(flow, part, session.mesh))
        error[chosen] = np.stack(
            [
                motion.displacement - [0.0025 * k, 0, 0]
                for k, motion in enumerate(displacements, start=1)
            ]
        )
        sigma[chosen] = np.stack(
            [np.trace(motion.covariance, axis1=1, axis2=2) for motion in displacements]
        )
    common = np.all([np.isfinite(errors).all(axis=2) for errors in error.values()], axis=0)
    rms = {c: float(np.sqrt((e[common] ** 2).sum(axis=1).mean())) for c, e in error.items()}
    claim = {c: float(np.sqrt(s[common].mean())) for c, s in sigma.items()}
    pair = min(((0, 1), (0, 2)), key=rms.__getitem__)
    return Figure(
        FLOW, "three cameras jointly over the best pair: rms of vertex displacement",
        rms[0, 1, 2] / rms[pair], "x",
        note=f"ratio of the claimed sigmas {claim[0, 1, 2] / claim[pair]:.2f}; pairs"
        f" {1e3 * rms[0, 1]:.3f} and {1e3 * rms[0, 2]:.3f} mm",
    )  # fmt: skip

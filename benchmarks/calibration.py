"""How near `palpate calibrate` comes to the truth, and how honest its covariance is.

    python -m benchmarks.calibration [--seeds 50] [--pictures 3] [--folder FOLDER] [--real FOLDER]

Rigs of three cameras of 1280 x 1024 pixels that look at 25 boards of 240 x 180 mm, which fill
most of a picture. First with computed corners that are off by 0.1 px, then with drawn pictures of
such noise that corners scatter as much (written into the folder where they are not there yet). With
--real the shared pictures of chessboards, of a calibration object and of a cylinder moved rigidly.
"""

import argparse
import contextlib
import io
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.boards import (
    SIZE,
    bundle_errors,
    draw_board,
    seen_corners,
    sightings,
    true_bundle,
)
from benchmarks.figure import DOOR, Figure
from benchmarks.machine import MADE, SHARED
from benchmarks.options import Options
from benchmarks.real_calibration import real_figures
from benchmarks.report import with_notes
from palpate.app.cli import main as palpate
from palpate.calibration import Charuco, calibrate, find_boards, find_pictures
from palpate.calibration.adjustment import Bundle, adjust
from palpate.calibration.sightings import Sightings

BOARD = Charuco(12, 9, 0.02, 0.015)
_NOISE = 0.1
# Grey levels of noise and pixels of blur that let corners of drawn boards scatter by 0.1 px.
_PIXEL_NOISE, _BLUR = 20.0, 0.6
_CAMERAS = 3
# Fewer rigs say nothing of a single number's scatter.
_MANY = 20


@dataclass(frozen=True, slots=True)
class Run:
    """One rig: its truth, errors of all unknowns, their claimed sigmas and those of the bound."""

    truth: Bundle
    found: Bundle
    error: np.ndarray
    sigma: np.ndarray
    bound: np.ndarray
    distance: float
    noise: np.ndarray


def _truth(seed: int) -> tuple[Bundle, np.random.Generator]:
    rng = np.random.default_rng(seed)
    truth = true_bundle(rng, cameras=_CAMERAS)
    middle = BOARD.points.mean(axis=0)
    truth.view[:, :3, 3] -= np.einsum("vij,j->vi", truth.view[:, :3, :3], middle)
    return truth, rng


def _run(truth: Bundle, boards: Sightings) -> Run:
    """A calibration of sightings against the truth, in all its unknowns."""
    made = calibrate(boards, [BOARD])
    used = [int(name) for name in made.sightings.views]
    true = Bundle(truth.intrinsics, truth.camera, truth.view[used])
    error = bundle_errors(made.adjusted.bundle, true)
    covariance = made.adjusted.covariance
    # The bound of Cramer and Rao: every corner that the cameras can see, linearised at the truth
    # (a hundredth of the noise moves it nowhere), with the noise that was found.
    exact = seen_corners(true, BOARD.points, np.random.default_rng(0), noise=0.01 * _NOISE)
    best = adjust(true, exact)
    scale = float(_rms(made.adjusted.noise) / _rms(best.noise))
    return Run(
        true, made.adjusted.bundle, error, np.sqrt(np.diag(covariance)),
        scale * np.sqrt(np.diag(best.covariance)),
        float(error @ np.linalg.solve(covariance, error) / len(error)), made.adjusted.noise,
    )  # fmt: skip


def _computed(seed: int) -> Run:
    truth, rng = _truth(seed)
    corners = seen_corners(truth, BOARD.points, rng, noise=_NOISE)
    return _run(truth, sightings(corners, BOARD, _CAMERAS))


def _pictures(folder: Path, seed: int) -> tuple[Path, Bundle]:
    """Folders of drawn pictures."""
    truth, _ = _truth(seed)
    root = folder / f"boards_{seed}"
    texture = BOARD.drawing(160)
    extent = (BOARD.columns * BOARD.square, BOARD.rows * BOARD.square)
    for c, intrinsics in enumerate(truth.intrinsics):
        (root / f"c{c}").mkdir(parents=True, exist_ok=True)
        for v, view in enumerate(truth.view):
            file = root / f"c{c}" / f"{v:02d}.png"
            if not file.exists():
                picture = draw_board(
                    texture, extent, intrinsics, truth.camera[c] @ view, SIZE,
                    rng=np.random.default_rng([seed, c, v]), noise=_PIXEL_NOISE, blur=_BLUR,
                )  # fmt: skip
                cv2.imwrite(str(file), picture)
    return root, truth


def _figures(title: str, runs: list[Run]) -> list[Figure]:
    """How far rigs are from the truth, in percent and pixels, and against their covariance."""
    lens = np.stack(
        [(run.found.intrinsics - run.truth.intrinsics) / run.truth.intrinsics for run in runs]
    )
    centre = np.stack([run.found.intrinsics - run.truth.intrinsics for run in runs])[..., 2:4]
    length, true = (
        np.stack([np.linalg.norm(bundle.camera[1:, :3, 3], axis=1) for bundle in bundles])
        for bundles in ([run.found for run in runs], [run.truth for run in runs])
    )
    rig = 9 * _CAMERAS + 6 * (_CAMERAS - 1)
    error, sigma, bound = (
        np.stack([getattr(run, name)[:rig] for run in runs]) for name in ("error", "sigma", "bound")
    )
    claimed = np.sqrt(((error / sigma) ** 2).mean(axis=0))
    least = np.sqrt(((error / bound) ** 2).mean(axis=0))
    boards = np.concatenate([run.error[rig:] / run.sigma[rig:] for run in runs])
    whole = np.sqrt(np.mean([run.distance for run in runs]))
    noise = np.mean([run.noise for run in runs])
    name = f"{title}, {len(runs)} rigs of three cameras, 25 views"
    rows = (
        ("focal length, rms", 100 * _rms(lens[..., :2]), "%",
         f"corners scatter by {noise:.3f} px"),
        ("principal point, rms", _rms(centre), "px", ""),
        ("baseline, rms", 100 * _rms(length / true - 1.0), "%", ""),
        ("rms error over the Cramer-Rao bound", _rms(least), "x",
         f"of all {rig} numbers of a rig; the bound counts every corner within a picture"),
    )  # fmt: skip
    figures = [
        Figure(DOOR, f"{name}: {what}", value, unit, note=note) for what, value, unit, note in rows
    ]
    if len(runs) < _MANY:
        return figures
    note = (
        f"rms of all {_rms(claimed):.3f}, of the boards' poses {_rms(boards):.3f}; in the metric of"
        f" the whole covariance {whole:.3f}"
    )
    return figures + [
        Figure(DOOR, f"{name}: actual over claimed sigma, {which} of {rig} numbers", value, "x",
               note=note)
        for which, value in (("smallest", claimed.min()), ("largest", claimed.max()))
    ]  # fmt: skip


def _rms(values: np.ndarray | list) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _picture_figures(folder: Path, count: int) -> list[Figure]:
    """The same of drawn pictures, and how long the command takes."""
    runs = []
    for seed in range(count):
        root, truth = _pictures(folder, seed)
        runs.append(_run(truth, find_boards(find_pictures(root), [BOARD])))
    words = f"calibrate {root} --columns 12 --rows 9 --square 20mm --marker 15mm --force --out"
    start = time.perf_counter()
    with contextlib.redirect_stdout(io.StringIO()):
        code = palpate([*words.split(), str(folder / "rig")])
    seconds = time.perf_counter() - start
    size = f"{_CAMERAS} x 25 pictures of {SIZE[0]} x {SIZE[1]}"
    return [
        *_figures("drawn pictures", runs),
        Figure(DOOR, f"`palpate calibrate`, {size}, all steps", seconds, "s",
               note=f"exit code {code}; {seconds:.0f} s of the clock"),
    ]  # fmt: skip


def measure(options: Options) -> list[Figure]:
    """Rigs against the truth and against the real pair's own calibration."""
    figures = _figures(
        "computed corners", [_computed(s) for s in range(4 if options.quick else 50)]
    )
    if options.quick:
        return figures
    figures += _picture_figures(MADE / "boards", 3)
    pair = SHARED / "real" / "multidic_pair"
    return figures + (real_figures(pair) if pair.is_dir() else [])


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.calibration", description=__doc__)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--pictures", type=int, default=3)
    parser.add_argument("--folder", type=Path, default=MADE / "boards")
    parser.add_argument("--real", type=Path)
    options = parser.parse_args()
    if options.seeds:
        runs = [_computed(seed) for seed in range(options.seeds)]
        print(with_notes(_figures("computed corners", runs)), flush=True)
    if options.pictures:
        print(with_notes(_picture_figures(options.folder, options.pictures)), flush=True)
    if options.real:
        print(with_notes(real_figures(options.real)))


if __name__ == "__main__":
    main()

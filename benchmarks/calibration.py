"""How near `palpate calibrate` comes to the truth, and how honest its covariance is.

    python -m benchmarks.calibration [--seeds 50] [--real FOLDER]

Rows: rigs of three cameras and 25 boards of 220 x 160 mm that fill most of a picture, corners of
0.1 px; with --real the chessboard pictures of single cameras (a folder each, 14 x 19 corners),
against OpenCV's own calibration of the same corners.
"""

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

from benchmarks.boards import board_points, seen_corners, true_bundle
from palpate.calibration import Chessboard, calibrate, find_boards, find_pictures
from palpate.calibration.adjustment import Bundle, adjust

_NOISE = 0.1


def _errors(seed: int) -> tuple[np.ndarray, np.ndarray, Bundle]:
    """Errors and claimed deviations of lenses and camera centres, and the true rig."""
    rng = np.random.default_rng(seed)
    truth = true_bundle(rng)
    corners = seen_corners(truth, board_points(12, 9, 0.02), rng, noise=_NOISE)
    found = adjust(truth, corners)
    lens = (found.bundle.inner - truth.inner).ravel()
    shift = (found.bundle.camera[1:, :3, 3] - truth.camera[1:, :3, 3]).ravel()
    sigma = np.sqrt(np.diag(found.covariance))
    moved = sigma[27 : 27 + 12].reshape(2, 6)[:, 3:].ravel()
    return np.concatenate([lens, shift]), np.concatenate([sigma[:27], moved]), truth


def _report_rigs(seeds: int) -> None:
    start = time.perf_counter()
    runs = [_errors(seed) for seed in range(seeds)]
    error, sigma = np.stack([run[0] for run in runs]), np.stack([run[1] for run in runs])
    ratio = np.sqrt((error**2).mean(axis=0) / (sigma**2).mean(axis=0))
    lens = error[:, :27].reshape(seeds, 3, 9)
    true = np.stack([run[2].inner for run in runs])
    focal = np.sqrt(np.mean((lens[..., :2] / true[..., :2]) ** 2))
    centre = np.sqrt(np.mean(lens[..., 2:4] ** 2))
    baseline = []
    for (_, _, truth), shift in zip(runs, error[:, 27:].reshape(seeds, 2, 3), strict=True):
        across = truth.camera[1:, :3, 3]
        length = np.linalg.norm(across, axis=1)
        baseline.append((np.linalg.norm(across + shift, axis=1) - length) / length)
    print(f"{seeds} rigs of 3 cameras, 25 views, corners of {_NOISE} px:")
    print(f"  focal length, rms            {100 * focal:.4f} %")
    print(f"  principal point, rms         {centre:.3f} px")
    print(f"  baseline, rms                {100 * np.sqrt(np.mean(np.square(baseline))):.4f} %")
    print(f"  actual over claimed sigma    {ratio.min():.2f} to {ratio.max():.2f}, rms of all"
          f" {np.sqrt(np.mean(ratio**2)):.3f}")  # fmt: skip
    print(f"  seconds a rig                {(time.perf_counter() - start) / seeds:.2f}")


def _report_real(folder: Path) -> None:
    board = Chessboard(14, 19, 0.01)
    for camera in sorted(path for path in folder.iterdir() if path.is_dir()):
        start = time.perf_counter()
        found = find_boards(find_pictures(camera), [board])
        seen = time.perf_counter()
        result = calibrate(found, [board])
        done = time.perf_counter()
        corners = result.corners
        views = range(len(result.found.views))
        points = [corners.point[corners.view == v].astype(np.float32) for v in views]
        pixels = [corners.pixel[corners.view == v].astype(np.float32) for v in views]
        rms, *_ = cv2.calibrateCamera(points, pixels, found.sizes[0], None, None)
        own = np.sqrt((result.adjusted.residual**2).sum(axis=1).mean())
        good = result.adjusted.good
        kept = np.sqrt((result.adjusted.residual[good] ** 2).sum(axis=1).mean())
        print(
            f"{camera.name}: {len(views)} views, rms {own:.3f} px ({kept:.3f} without"
            f" {int((~good).sum())} gross errors), OpenCV {rms:.3f} px, ratio {own / rms:.3f};"
            f" search {seen - start:.1f} s, adjustment {done - seen:.1f} s"
        )


def main() -> None:
    """Print all rows."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.calibration", description=__doc__)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--real", type=Path)
    options = parser.parse_args()
    _report_rigs(options.seeds)
    if options.real:
        _report_real(options.real)


if __name__ == "__main__":
    main()

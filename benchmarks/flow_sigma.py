"""Are displacements from pictures as certain as they claim, whatever the pictures are like?

A dome with an analytic texture moves before analytic cameras, rigidly or as under a tool; pictures
get noise, blur, a gain. Error over claimed standard deviation should be 1; what is rejected is
counted. Run it with

    python -m benchmarks.flow_sigma
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from vision.scenes import LENS, Stage, bump, dome, make_rig, rigid

from palpate.vision import JointFlow
from palpate.vision.range_flow import Outcome, is_valid

MOTIONS = {
    "rigid": rigid((0.004, -0.003, 0.006), (3e-4, -2e-4, 1e-4)),
    "under a tool": bump((6e-4, -4e-4, 8e-4), 0.012),
}


@dataclass(frozen=True, slots=True)
class Shot:
    """How pictures are taken.

    Attributes
    ----------
    cameras : int
    speckle : float [px]            standard deviation of its size
    noise : float [grey levels]
    blur : (float, float) [px]      of the first pictures and of the later ones
    gain : float                    of the later pictures over the first
    """

    cameras: int = 3
    speckle: float = 1.7
    noise: float = 1.5
    blur: tuple[float, float] = (0.0, 0.0)
    gain: float = 1.0


SHOTS = (
    Shot(),
    *(Shot(speckle=size) for size in (0.5, 0.8, 1.2)),
    *(Shot(noise=level) for level in (3.0, 6.0)),
    *(Shot(blur=both) for both in ((0.0, 1.0), (1.0, 0.0), (0.0, 2.0), (2.0, 0.0), (1.0, 1.0))),
    *(Shot(gain=factor) for factor in (0.7, 1.3)),
    *(Shot(cameras=count) for count in (2, 4)),
)


def measured(shot: Shot, name: str, seed: int = 0) -> tuple[float, float, float, float]:
    """Error over claimed standard deviation, the same of the noise alone, rms error [px], and the
    share of what the cameras see that is valid."""
    stage = Stage(make_rig(shot.cameras, lens=LENS), dome(0.05), seed, shot.speckle)
    motion, rng = MOTIONS[name], np.random.default_rng(seed + 5)
    # Room for a gain of 1.3 below 255.
    light = 0.7
    first, later = (
        [_taken(view, width, light * gain, shot.noise, rng) for view in views]
        for views, width, gain in (
            (stage.views(), shot.blur[0], 1.0),
            (stage.views(motion), shot.blur[1], shot.gain),
        )
    )
    method = JointFlow()
    _, flow = method.follow(method.start_on(stage.rig, first, *stage.mesh()), later)
    good = is_valid(flow)
    error = (flow.displacement - motion(flow.point))[good]
    whole, bias = flow.covariance[good], flow.bias[good]
    size = stage.rig.cameras[0].matrix[0, 0] / 0.3
    return (
        _over_claim(error, whole),
        _over_claim(error, whole - bias),
        float(size * np.sqrt((error**2).mean())),
        float(good.sum() / (flow.outcome != Outcome.HIDDEN).sum()),
    )


def _taken(
    view: np.ndarray, width: float, gain: float, noise: float, rng: np.random.Generator
) -> np.ndarray:
    """What a camera makes of a view, 8 bit."""
    blurred = cv2.GaussianBlur(view, (0, 0), width) if width else view
    grey = np.round(gain * blurred + noise * rng.normal(size=view.shape))
    return np.clip(grey, 0, 255).astype(np.float32)


def _over_claim(error: np.ndarray, covariance: np.ndarray) -> float:
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    return float(np.sqrt(square.mean() / 3.0))


def main() -> None:
    """Print a row for each kind of pictures and each motion."""
    print("motion        cameras  speckle  noise     blur gain | over claim alone      px  valid")
    for name in MOTIONS:
        for shot in SHOTS:
            ratio, alone, pixels, valid = measured(shot, name)
            blur = f"{shot.blur[0]:g}, {shot.blur[1]:g}"
            print(
                f"{name:13s} {shot.cameras:7d} {shot.speckle:8.1f} {shot.noise:6.1f} {blur:>8s}"
                f" {shot.gain:4.1f} | {ratio:10.2f} {alone:5.2f} {pixels:7.4f}"
                f" {100 * valid:4.0f} %",
                flush=True,
            )


if __name__ == "__main__":
    main()

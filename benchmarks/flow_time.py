"""How long one instant of three cameras takes, from pictures in memory to vertices."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from unittest.mock import patch

import numpy as np

from benchmarks.figure import FLOW, Figure
from benchmarks.floors import interpolation_rate
from benchmarks.machine import CORES, SHARED
from benchmarks.options import Options
from palpate.records import read_rig, read_session
from palpate.vision import JointFlow, RangeFlow, read_pictures
from palpate.vision.joint import flow, match, sharpness

# A window is sampled at its start and where the iteration ends, at least.
FEWEST_SAMPLES = 2
FOLDER = SHARED / "halfball_images"
NAMES = ("n01", "n02", "n03", "n04")


def measure(options: Options) -> list[Figure]:
    """Frames per second of 640 x 480 x 3, some two thousand points, all cores, warm."""
    followed = _followed(JointFlow())
    return [
        Figure(
            FLOW, "640 x 480 x 3 cameras, one instant, warm", 1.0 / followed.seconds, "1/s",
            note=f"{len(followed.flow.point)} points in the reference camera, {followed.vertices}"
            " vertices measured; dense start, refinement with retries, judgement and vertices; best"
            f" of three, the first left aside; {followed.parts.described()}",
        ),
    ]  # fmt: skip


@dataclass(frozen=True)
class Followed:
    """Some instants, each followed from the first one.

    Attributes
    ----------
    seconds : float             the quickest instant but the first, vertices included
    parts : Parts               of the last instant
    flow : RangeFlow            of the last instant
    vertices : int              measured in it
    """

    seconds: float
    parts: "Parts"
    flow: RangeFlow
    vertices: int


def _followed(method: JointFlow) -> Followed:
    session, rig = read_session(FOLDER), read_rig(FOLDER / "rig.toml")
    patterns = ["images/rest_{camera}.png", *(f"images/{name}_{{camera}}.png" for name in NAMES)]
    grey = [read_pictures(rig, pattern, folder=FOLDER, what=pattern).grey for pattern in patterns]
    state, seconds = method.start(rig, grey[0], session.mesh), []
    for pictures in grey[1:]:
        begun = time.perf_counter()
        _, ranges = method.follow(state, pictures)
        displacement = method.vertices(ranges, rig, session.mesh)
        seconds.append(time.perf_counter() - begun)
    with timed_parts() as parts:
        method.follow(state, grey[-1])
    measured = int(np.isfinite(displacement.displacement[:, 0]).sum())
    return Followed(float(np.min(seconds[1:])), parts, ranges, measured)


@dataclass
class Parts:
    """What one instant consists of.

    Attributes
    ----------
    dense_start : float [s]     dense search, most of it OpenCV's
    refinement : float [s]
    calls : int                 of the refinement
    grey_levels : int           pixels of all windows that were refined
    """

    dense_start: float = 0.0
    refinement: float = 0.0
    calls: int = 0
    grey_levels: int = 0

    def described(self) -> str:
        """Each part, and the refinement's floor."""
        floor = FEWEST_SAMPLES * self.grey_levels / interpolation_rate() / CORES
        return (
            f"of it the dense start, most of it OpenCV's, {self.dense_start:.2f} s, the refinement"
            f" {self.refinement:.2f} s; floor of the refinement: to interpolate the"
            f" {1e-6 * self.grey_levels:.0f} million grey levels of its windows twice takes"
            f" {CORES} cores {floor:.2f} s"
        )


@contextmanager
def timed_parts() -> Iterator[Parts]:
    """Times the parts of the instants that are followed while the block runs."""
    parts, search, refine = Parts(), flow.dense_start, match.refine_joint

    def refined(scene, rows, moved, start, cameras, noise, limits):
        begun = time.perf_counter()
        matches = refine(scene, rows, moved, start, cameras, noise, limits)
        parts.refinement += time.perf_counter() - begun
        windows = cameras[np.isfinite(start).all(axis=(1, 2))].sum()
        parts.grey_levels += int(windows) * (2 * limits.half + 1) ** 2
        parts.calls += 1
        return matches

    def searched(first, second):
        begun = time.perf_counter()
        start = search(first, second)
        parts.dense_start += time.perf_counter() - begun
        return start

    with (
        patch.object(flow, "dense_start", searched),
        patch.object(match, "refine_joint", refined),
        patch.object(sharpness, "refine_joint", refined),
    ):
        yield parts

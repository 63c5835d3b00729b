"""Measuring live: how fast a displacement is seen, how soon constants follow a push, and how many
pushes a wanted precision takes where they are placed by information, and anywhere.

The virtual bench is that of `palpate measure virtual`; its questions are counted as they are asked.
"""

import sys
import tempfile
import time
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import cv2
import numpy as np

from benchmarks.figure import LIVE, Figure
from benchmarks.flow_time import FOLDER, NAMES
from benchmarks.live_films import Counting, measure_films
from benchmarks.live_memory import HOUR, measure as measure_memory, pushes as pressed_places
from benchmarks.options import Options
from palpate.bench import (
    Bench,
    measure as measure_live,
    read_bench,
    wanted_precision,
)
from palpate.checkpoints import Memory
from palpate.pipeline import (
    Material,
    NextProbings,
    fit_session,
)
from palpate.records import Estimate, Rig, read_rig, read_session
from palpate.shapes import Vector3
from palpate.vision import JointFlow, read_pictures

Pictures = tuple[np.ndarray, ...]

# Spacing that gives some five hundred points in the reference camera [px].
_COARSE = 9
# Instants of one push.
_SERIES = tuple(f"n05_{k}" for k in range(1, 6))
_UNTIL, _MOST = "E 3 %", 8
# Pushes after which a fit is timed a second time.
_MANY = 20


def measure(options: Options) -> list[Figure]:
    """Latency, instants per second, constants after a push; pushes and questions."""
    figures = [*_flow_figures(), *_constants_figures()]
    if options.quick:
        return figures
    return [*figures, *_push_figures(), *_hour_figures(), *measure_films()]


def _flow_figures() -> list[Figure]:
    """An instant of two cameras with few points, and of three with all, over OpenCV's DIS flow:
    pushes each from rest, and instants of one push, one after another."""
    session, rig = read_session(FOLDER), read_rig(FOLDER / "rig.toml")

    def grey(name: str) -> Pictures:
        pattern = f"images/{name}_{{camera}}.png"
        return read_pictures(rig, pattern, folder=FOLDER, what=pattern).grey

    rest, pushes, series = grey("rest"), list(map(grey, NAMES)), list(map(grey, _SERIES))
    figures = []
    for cameras, step, name in ((2, _COARSE, "live displacement"), (3, 5, "full precision")):
        method, few = JointFlow(step=step), Rig(rig.cameras[:cameras], 0, rig.source)
        begin = method.start(few, rest[:cameras], session.mesh)
        for given, how in ((pushes, "each from rest"), (series, "one after another")):
            seconds, dis = [], []
            for _ in range(6):
                state, before = begin, rest
                for k, pictures in enumerate(given):
                    begun = time.perf_counter()
                    ahead, flow = method.follow(state, pictures[:cameras])
                    method.vertices(flow, few, session.mesh)
                    seconds.append(time.perf_counter() - begun)
                    dis.append(_dis_seconds(before[:cameras], pictures[:cameras]))
                    if given is series:
                        state, before = ahead, pictures
                    if k == 0 and given is series:
                        # From rest.
                        del seconds[-1], dis[-1]
            # Without the first round.
            late = seconds[len(seconds) // 6 :]
            median, flows = float(np.median(late)), float(np.median(dis))
            note = (
                f"{len(flow.point)} points with covariances, vertices too, {len(late)} instants;"
                f" median {median:.3f} s, {median / flows:.1f} times OpenCV's DIS flow (medium) of"
                f" the same pictures in the same run, {flows:.3f} s"
            )
            size = f"640 x 480 x {cameras}, {how}"
            latency = float(np.percentile(late, 95))
            figures.append(Figure(LIVE, f"{name}, {size}, latency 95 %", latency, "s", note=note))
        figures.append(Figure(LIVE, f"{name}, {size}", 1.0 / median, "1/s", note=note))
    return figures


def _dis_seconds(first: tuple[np.ndarray, ...], second: tuple[np.ndarray, ...]) -> float:
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    pairs = [tuple(p.astype(np.uint8) for p in pair) for pair in zip(first, second, strict=True)]
    begun = time.perf_counter()
    for before, after in pairs:
        flow.calc(before, after, np.zeros((*before.shape, 2), dtype=np.float32))
    return time.perf_counter() - begun


def _constants_figures() -> list[Figure]:
    """A fit after the third and the twentieth push on the demo's half ball, with what fits of the
    earlier ones kept in memory."""
    rig = read_rig(FOLDER / "rig.toml")
    patterns = [f"images/{name}_{{camera}}.png" for name in ("rest", NAMES[0])]
    views = [read_pictures(rig, pattern, folder=FOLDER, what=pattern).grey for pattern in patterns]
    dis = float(np.median([_dis_seconds(*views) for _ in range(10)]))
    session, figures = pressed_places(_MANY), []
    memory, seconds = Memory(), []
    for count in range(1, _MANY + 1):
        given = replace(session, probings=session.probings[:count])
        begun = time.perf_counter()
        fit_session(given, cache=memory, material=Material.AUTO)
        seconds.append(time.perf_counter() - begun)
    for count, which in ((3, "third"), (_MANY, "twentieth")):
        note = (
            f"fits after one push and the next, the first in {seconds[0]:.1f} s; without its flow;"
            f" {seconds[count - 1] / dis:.0f} times OpenCV's DIS flow (medium) of three pictures of"
            f" 640 x 480 in the same run, {dis:.3f} s"
        )
        name = f"constants after the {which} push, {len(session.mesh.vertices)} vertices"
        figures.append(Figure(LIVE, name, seconds[count - 1], "s", note=note))
    return figures


def _push_figures() -> list[Figure]:
    """Pushes until E is known, by information and at three sequences of random places."""
    best, script = _pushes(nullcontext())
    drawn = []
    for seed in range(3):
        rng = np.random.default_rng(seed)

        def anywhere(
            bench: Bench, plan: NextProbings, rng: np.random.Generator = rng
        ) -> list[tuple[Vector3, Vector3]]:
            order = rng.permutation(len(plan.point))
            return [(plan.point[k], plan.inward[k]) for k in order]

        drawn.append(
            _pushes(patch.object(sys.modules[measure_live.__module__], "_allowed", anywhere))[0]
        )
    return [
        Figure(
            LIVE, f'pushes for "{_UNTIL}", by information over random places',
            best / float(np.mean(drawn)), "x",
            note=f"{best} against {', '.join(map(str, drawn))} (at most {_MOST}), virtual bench",
        ),
        Figure(
            LIVE, "steps a person must decide, virtual bench", 1 + script.asked, "",
            note="the command, and every question that was asked",
        ),
    ]  # fmt: skip


def _hour_figures() -> list[Figure]:
    """Disk and memory of a session of an hour, from the growth over short ones."""
    disk: list[int] = []

    class Watching(Counting):
        def judged(self, estimate: Estimate) -> None:
            files = (file for file in Path(folder).rglob("*") if file.is_file())
            disk.append(sum(file.stat().st_size for file in files))

    with tempfile.TemporaryDirectory() as folder:
        measure_live(read_bench("virtual"), Watching(), Path(folder), pushes=_MOST)
    growth = (disk[-1] - disk[0]) / (_MOST - 1)
    return [
        Figure(
            LIVE, "an hour's session, disk", (disk[-1] + (HOUR - _MOST) * growth) / 1e9, "GB",
            note=f"{HOUR} pushes, one in {3600 // HOUR} s, of {growth / 1e6:.2f} MB each",
        ),
        *measure_memory(),
    ]  # fmt: skip


def _pushes(places: AbstractContextManager[object]) -> tuple[int, Counting]:
    script = Counting()
    with tempfile.TemporaryDirectory() as folder, places:
        measure_live(
            read_bench("virtual"), script, Path(folder), until=wanted_precision(_UNTIL),
            pushes=_MOST,
        )  # fmt: skip
        return len(read_session(folder).probings), script

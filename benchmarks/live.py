"""Measuring live: how fast a displacement is seen, how soon constants follow a push, and how many
pushes a wanted precision takes where they are placed by information, and anywhere.

The virtual bench is that of `palpate measure virtual`; its questions are counted as they are asked.
"""

import sys
import tempfile
import time
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from unittest.mock import patch

import cv2
import numpy as np

from benchmarks.figure import LIVE, Figure
from benchmarks.flow_time import FOLDER, NAMES
from benchmarks.options import Options
from palpate.bench import (
    Bench,
    Questions,
    measure as measure_live,
    read_bench,
    wanted_precision,
)
from palpate.lab import built_in, choose_variant, make_session, read_lab_config
from palpate.parts import Memory
from palpate.pipeline import (
    Material,
    NextProbings,
    fit_session,
    with_pictures_measured,
)
from palpate.progress import Progress, silent
from palpate.records import Rig, read_rig, read_session
from palpate.shapes import Vector3
from palpate.vision import JointFlow, read_pictures

# Spacing that gives some five hundred points in the reference camera [px].
_COARSE = 9
_UNTIL, _MOST = "E 3 %", 8


def measure(options: Options) -> list[Figure]:
    """Latency, instants per second, constants after a push; pushes and questions."""
    figures = [*_flow_figures(), _constants_figure()]
    return figures if options.quick else [*figures, *_push_figures()]


def _flow_figures() -> list[Figure]:
    """An instant of two cameras with few points, and of three with all, over OpenCV's DIS flow."""
    session, rig = read_session(FOLDER), read_rig(FOLDER / "rig.toml")
    patterns = ["images/rest_{camera}.png", *(f"images/{name}_{{camera}}.png" for name in NAMES)]
    grey = [read_pictures(rig, pattern, folder=FOLDER, what=pattern).grey for pattern in patterns]
    figures = []
    for cameras, step, name in ((2, _COARSE, "live displacement"), (3, 5, "full precision")):
        method, few = JointFlow(step=step), Rig(rig.cameras[:cameras], 0, rig.source)
        state = method.start(few, grey[0][:cameras], session.mesh)
        seconds, dis = [], []
        for repeat in range(5):
            for pictures in grey[1:]:
                begun = time.perf_counter()
                _, flow = method.follow(state, pictures[:cameras])
                method.vertices(flow, few, session.mesh)
                seconds.append(time.perf_counter() - begun)
                dis.append(_dis_seconds(grey[0][:cameras], pictures[:cameras]))
            if repeat == 0:
                seconds, dis = [], []
        late = float(np.percentile(seconds, 95))
        times = float(np.median(seconds) / np.median(dis))
        note = (
            f"{len(flow.point)} points with covariances, vertices too, {len(seconds)} instants;"
            f" median {np.median(seconds):.3f} s, {times:.1f} times OpenCV's DIS flow (medium) of"
            f" the same pictures in the same run, {np.median(dis):.3f} s"
        )
        size = f"640 x 480 x {cameras}"
        figures.append(Figure(LIVE, f"{name}, {size}, latency 95 %", late, "s", note=note))
    rate = 1.0 / float(np.median(seconds))
    return [*figures, Figure(LIVE, f"instants, {size}", rate, "1/s", note=note)]


def _dis_seconds(first: tuple[np.ndarray, ...], second: tuple[np.ndarray, ...]) -> float:
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    pairs = [tuple(p.astype(np.uint8) for p in pair) for pair in zip(first, second, strict=True)]
    begun = time.perf_counter()
    for before, after in pairs:
        flow.calc(before, after, np.zeros((*before.shape, 2), dtype=np.float32))
    return time.perf_counter() - begun


def _constants_figure() -> Figure:
    """A fit after the third push on the demo's half ball, its factors kept from before."""
    kept, seconds = Memory(), []
    with tempfile.TemporaryDirectory() as folder:
        demo = read_lab_config(built_in()["demo"])
        make_session(demo, Path(folder), variant=choose_variant())
        session = with_pictures_measured(read_session(folder))
        for count in (1, 2, 3):
            given = replace(session, probings=session.probings[:count])
            begun = time.perf_counter()
            fit_session(given, cache=kept, material=Material.AUTO)
            seconds.append(time.perf_counter() - begun)
    rig = read_rig(FOLDER / "rig.toml")
    patterns = [f"images/{name}_{{camera}}.png" for name in ("rest", NAMES[0])]
    views = [read_pictures(rig, pattern, folder=FOLDER, what=pattern).grey for pattern in patterns]
    dis = float(np.median([_dis_seconds(*views) for _ in range(10)]))
    return Figure(
        LIVE, f"constants after a push, {len(session.mesh.vertices)} vertices", seconds[-1], "s",
        note=f"third push, with the body's factors kept from the first ({seconds[0]:.1f} s);"
        f" without its flow; {seconds[-1] / dis:.0f} times OpenCV's DIS flow (medium) of three"
        f" pictures of 640 x 480 in the same run, {dis:.3f} s",
    )  # fmt: skip


@dataclass
class _Counting(Questions):
    """Takes the usual answer to everything, and counts."""

    asked: int = 0
    told: list[str] = field(default_factory=list)

    def tell(self, text: str) -> None:
        """Keep it."""
        self.told.append(text)

    def choose(self, text: str, options: list[str]) -> str:
        """The usual one."""
        return self.ask(text, options[0])

    def ask(self, text: str, usual: str) -> str:
        """The usual one."""
        self.asked += 1
        return usual

    def wait(self, text: str) -> None:
        """At once."""
        self.asked += 1

    def working(self) -> AbstractContextManager[Progress]:
        """Without a bar."""
        return nullcontext(silent)


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


def _pushes(places: AbstractContextManager[object]) -> tuple[int, _Counting]:
    script = _Counting()
    with tempfile.TemporaryDirectory() as folder, places:
        measure_live(
            read_bench("virtual"), script, Path(folder), until=wanted_precision(_UNTIL),
            pushes=_MOST,
        )  # fmt: skip
        return len(read_session(folder).probings), script

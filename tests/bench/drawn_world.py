"""A virtual bench whose pictures are drawn in milliseconds, and answers for it."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from palpate.bench import Bench, DrawnBody, Questions, virtual_bench
from palpate.geometry import TriangleMesh, write_mesh
from palpate.lab import LabConfig, built_in, make_render_mesh, read_lab_config, texture
from palpate.progress import Progress, silent
from palpate.records import Rig, write_rig
from palpate.vision import surface_map

TOP, DOWN = np.array([0.0, 0.0, 0.04]), np.array([0.0, 0.0, -1.0])


def drawn_body(config: LabConfig, rig: Rig) -> DrawnBody:
    """The object as a surface with the texture as its light: no lamp, no shadows."""
    surface = config.specimen.mesh
    mesh = make_render_mesh(surface, rig.cameras, edge=1.5)
    rng = np.random.default_rng(0)
    look = config.look
    level = 40.0 + 180.0 * texture(look.texture, mesh.vertices, surface, size=look.size, rng=rng)

    def draw(vertices: np.ndarray, rod: TriangleMesh | None) -> tuple[np.ndarray, ...]:
        points, triangles = vertices, mesh.triangles
        grey = level
        if rod is not None:
            points = np.concatenate([vertices, rod.vertices])
            triangles = np.concatenate([triangles, rod.triangles + len(vertices)])
            grey = np.concatenate([level, np.full(len(rod.vertices), 8.0)])
        pictures = []
        for camera in rig.cameras:
            columns, rows = camera.size
            seen = surface_map(camera, (rows, columns), points, triangles)
            there = seen.triangle >= 0
            corner = points[triangles[seen.triangle[there]]]
            share = _barycentric(corner, seen.point[there])
            picture = np.full((rows, columns), 5.0, dtype=np.float32)
            picture[there] = (share * grey[triangles[seen.triangle[there]]]).sum(axis=1)
            pictures.append(cv2.GaussianBlur(picture, (0, 0), 0.6))
        return tuple(pictures)

    return DrawnBody(mesh.vertices, draw)


def _barycentric(corner: np.ndarray, point: np.ndarray) -> np.ndarray:
    a, b, c = (corner[:, k] for k in range(3))

    def area(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
        return np.linalg.norm(np.cross(q - p, r - p), axis=1)

    parts = np.stack([area(point, b, c), area(a, point, c), area(a, b, point)], axis=1)
    return parts / parts.sum(axis=1, keepdims=True)


def small_config() -> LabConfig:
    """The demo's half ball with coarser elements."""
    demo = read_lab_config(built_in()["demo"])
    return replace(demo, specimen=replace(demo.specimen, element=0.012))


def drawn_bench() -> Bench:
    """The virtual bench of that."""
    return virtual_bench(small_config(), draw=drawn_body)


def hand_bench(folder: Path) -> Bench:
    """That bench for a person who presses, and who is asked what the object in the folder is."""
    bench = drawn_bench()
    mesh = small_config().specimen.mesh
    write_mesh(folder / "ball.stl", TriangleMesh(1e3 * mesh.vertices, mesh.triangles))

    def supply(session: Path) -> None:
        write_rig(session / "rig.toml", bench.rig)

    return replace(bench, arm=None, head={}, contact=None, folder=folder, supply=supply)


class Hand:
    """Presses when told to, over half a second, holds, and lifts off when told to."""

    def __init__(self, bench: Bench, *, slides: bool = False):
        self.slides, self.there = slides, (TOP, DOWN)
        self.world = bench.cameras[0]._world
        self.begun, self.left, self.wait = np.inf, np.inf, self.world.wait
        self.world.position = TOP - 0.02 * DOWN
        self.world.wait = self.go_on

    def __call__(self, text: str) -> None:
        if text.startswith("Press"):
            self.world.position = self.there[0] - 0.02 * self.there[1]
            self.world.aim_at(*self.there)
            self.begun, self.left = self.world.time, np.inf
        if text.startswith("Got it"):
            self.left = self.world.time

    def go_on(self, seconds: float) -> None:
        now = self.world.time + seconds
        if now > self.begun:
            share = np.clip((now - self.begun) / 0.5, 0.0, 1.0) - (now > self.left)
            depth = 0.8 * share * self.world._press.depth
            self.world.position = self.there[0] + (depth if share > 0.0 else -0.02) * self.there[1]
        self.wait(seconds)
        if self.slides and now > self.begun + 0.5:
            self.world._drawn = None


class Script(Questions):
    """Answers by the beginnings of questions, others with the first choice; remembers all texts."""

    def __init__(self, *answers: tuple[str, str], on_tell: Callable[[str], None] | None = None):
        self.answers = list(answers)
        self.told: list[str] = []
        self.asked: list[str] = []
        self.on_tell = on_tell

    def tell(self, text: str) -> None:
        self.told.append(text)
        if self.on_tell:
            self.on_tell(text)

    def choose(self, text: str, options: list[str]) -> str:
        return self.ask(text, options[0])

    def ask(self, text: str, usual: str) -> str:
        self.asked.append(text)
        for k, (beginning, answer) in enumerate(self.answers):
            if text.startswith(beginning):
                del self.answers[k]
                return answer
        return usual

    def wait(self, text: str) -> None:
        self.asked.append(text)
        if self.on_tell:
            self.on_tell(text)

    def working(self) -> AbstractContextManager[Progress]:
        return nullcontext(silent)

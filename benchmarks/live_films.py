"""Constants of live sessions against those that `palpate record` finds in films of the same pushes.

All that the virtual bench's cameras and gauge send while it measures is kept: pictures with their
times, readings as vectors in the object's frame. Its cameras draw nothing while the arm moves, so
the films have gaps there, as if frames were dropped; clocks are said to be known.
"""

import tempfile
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import tomlkit

from benchmarks.figure import LIVE, Figure
from palpate.bench import Bench, Questions, measure as measure_live, virtual_bench
from palpate.bench.devices import Camera, ForceSource, Picture
from palpate.lab import Material as Truth, built_in, read_lab_config
from palpate.pipeline import Material, fit_session, with_pictures_measured
from palpate.progress import Progress, silent
from palpate.recording import find_presses, read_recording, write_recorded
from palpate.records import Estimate, Session, read_session, write_text
from palpate.shapes import Vector3

_DRAWS, _PUSHES = 3, 3


@dataclass
class _Filmed:
    """A camera whose pictures are kept."""

    camera: Camera
    folder: Path
    times: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.name = self.camera.name
        self.folder.mkdir(parents=True)

    def start(self) -> None:
        self.camera.start()

    def grab(self) -> tuple[Picture, float]:
        picture, when = self.camera.grab()
        cv2.imwrite(str(self.folder / f"{len(self.times):05d}.png"), picture)
        self.times.append(when)
        return picture, when

    @property
    def settings(self) -> Mapping[str, str]:
        return self.camera.settings

    def close(self) -> None:
        self.camera.close()


@dataclass
class Counting(Questions):
    """Takes the usual answer to everything, and counts; keeps where to press."""

    asked: int = 0
    places: list[tuple[Vector3, Vector3]] = field(default_factory=list)

    def tell(self, text: str) -> None:
        """Nothing is kept."""

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

    def place(self, point: Vector3, inward: Vector3, way: Sequence[Vector3] = ()) -> None:
        """Keep it."""
        self.places.append((point, inward))


@dataclass
class _Logged:
    """A gauge whose readings are kept as vectors, without the weight of the tool."""

    gauge: ForceSource
    person: Counting
    typed: bool = False
    limit: float | None = None
    rows: list[np.ndarray] = field(default_factory=list)
    weight: float | None = None

    def start(self) -> None:
        self.gauge.start()

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        time, newtons = self.gauge.read()
        if self.weight is None and len(newtons):
            # On its way to the first push.
            self.weight = float(np.median(newtons))
        vectors = (newtons - (self.weight or 0.0))[:, None] * self.person.places[-1][1]
        self.rows += list(np.column_stack([time, vectors]))
        return time, newtons

    def close(self) -> None:
        self.gauge.close()


def measure_films() -> list[Figure]:
    """Errors of both ways over some draws of all noise, on three pushes each."""
    config = read_lab_config(built_in()["demo"])
    errors = []
    for seed in range(1, _DRAWS + 1):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            live, films = _both(virtual_bench(replace(config, seed=seed)), folder)
        errors.append([_off(estimate, config.material) for estimate in (live, films)])
        print(errors[-1], flush=True)
    off = np.array(errors)
    figures = []
    for k, (short, factor, unit) in enumerate((("E", 100.0, " %"), ("nu", 1.0, ""))):
        ours, theirs = factor * off[:, 0, k], factor * off[:, 1, k]
        listed = ("; ".join(f"{x:+.2g}" for x in values) for values in (ours, theirs))
        both = "{}{unit} live, {}{unit} recorded".format(*listed, unit=unit)
        apart = float(np.sqrt(np.mean((ours - theirs) ** 2)))
        note = f"{_DRAWS} draws of {_PUSHES} pushes, off by {both}; apart by {apart:.2g}{unit} rms"
        ratio = float(np.sqrt(np.mean(ours**2) / np.mean(theirs**2)))
        name = f"live session: rms error of {short} over that of its films by `palpate record`"
        figures.append(Figure(LIVE, name, ratio, "x", note=note))
    return figures


def _off(estimate: Estimate, material: Truth) -> tuple[float, float]:
    """Errors of E, relative, and of nu."""
    young = estimate.young_modulus.value / material.young_modulus - 1.0
    return young, estimate.poisson_ratio.value - material.poisson_ratio


def _both(bench: Bench, folder: Path) -> tuple[Estimate, Estimate]:
    """The constants of a live session, and of its films."""
    cameras = tuple(_Filmed(camera, folder / "films" / camera.name) for camera in bench.cameras)
    person = Counting()
    gauge = _Logged(bench.force, person)
    live = folder / "live"
    live.mkdir()
    filmed = replace(bench, cameras=cameras, force=gauge)
    estimate = measure_live(filmed, person, live, pushes=_PUSHES)
    if estimate is None:
        raise RuntimeError("nothing was measured")
    files = folder / "films"
    for camera in cameras:
        np.savetxt(files / f"{camera.name}.csv", camera.times, header="time [s]", comments="")
    np.savetxt(
        files / "force.csv", gauge.rows, delimiter=",", comments="",
        header="time [s],fx [N],fy [N],fz [N]",
    )  # fmt: skip
    head = {"object": {**bench.head["object"], "mesh": "../live/mesh.ply"},
            "support": bench.head["support"], "rig": {"cameras": "../live/rig.toml"}}  # fmt: skip
    content = {
        "format": "palpate-recording/1", "name": "films", **head,
        "force": {"file": "force.csv", "axes": np.eye(3).tolist(), "sign": "on object"},
        "contact": {**(bench.contact or {}), "points": [x.tolist() for x, _ in person.places]},
        "camera": [
            {"name": camera.name, "pictures": f"{camera.name}/*.png", "times": f"{camera.name}.csv",
             "offset": 0.0}
            for camera in cameras
        ],
    }  # fmt: skip
    write_text(files / "recording.toml", tomlkit.dumps(content))
    recording = read_recording(files)
    out = folder / "recorded"
    out.mkdir()
    write_recorded(out, recording, find_presses(recording))
    session: Session = with_pictures_measured(read_session(out))
    return estimate, fit_session(session, material=Material.AUTO).estimate

"""What cheap cameras cost in precision: two webcams before a rendered half ball, pressed thrice.

Two cameras without a trigger, one 15 ms behind the other, with shutters that roll for 20 ms and an
exposure that changes by 10 % between pictures; a hand that holds still but for a tremor of 1 % of
the depth, or presses on at 5 mm a second. Force gain, noise, exposures and phases differ between
sessions, the arm's place and tilt between bodies; the rig is right. Writes a CSV, prints a table.

    python -m benchmarks.cheap_cameras FILE.csv [SESSIONS]
"""

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.coverage_of_bodies import held
from palpate.bench.live_session import LiveSession
from palpate.bench.pushing import TakenPush
from palpate.bench.virtual import VirtualWorld, rendered_body
from palpate.errors import PalpateError
from palpate.geometry import write_mesh
from palpate.lab import LabConfig, built_in, choose_variant, make_head, read_lab_config
from palpate.records import Rig, write_rig
from palpate.shapes import Vector3

SESSIONS, BODIES = 25, 5
# The depth that is held, over that of the largest force, and depths that are rendered about it.
DEPTH, DEPTHS = 0.8, np.array([0.76, 0.8, 0.84, 0.88])
# Of the hand: tremor over the depth, its rate [Hz], and what it moves by in a second when it does
# not hold, over the depth of the largest force: 1.6 mm are pressed in a third of a second.
TREMOR, SHAKES, RATE = 0.01, 8.0, 2.5
# Of the gauge, as the facility's: gain and noise; pictures a second, and how many are averaged.
GAIN, NOISE, FRAMES, AVERAGED = 0.01, 0.005, 30.0, 8
Levels = list[np.ndarray]


@dataclass(frozen=True)
class Cameras:
    """A kind of cameras, and how the hand holds."""

    name: str
    offset: float = 0.015
    rolling: float = 0.020
    exposure: float = 0.1
    noise: float = 3.0
    shrink: int = 1
    holds: bool = True
    share: float = 1.0


KINDS = (
    Cameras("triggered, global shutter, fixed exposure", 0.0, 0.0, 0.0, 1.5, share=0.4),
    Cameras("two webcams, held still"),
    Cameras("two webcams, pressing on", holds=False, share=0.4),
    Cameras("two webcams, 320 x 240, held still", shrink=2, share=0.4),
    Cameras("two webcams in the dark (noise 8), held still", noise=8.0, share=0.4),
)


@dataclass
class Body:
    """A pressed body as its cameras see it: levels of both at rest, and at each depth of a push."""

    config: LabConfig
    rig: Rig
    rest: Levels
    pushes: list[tuple[Vector3, Vector3, float, list[Levels]]]


def made(number: int) -> Body:
    """Render a body, pressed at the demo's places."""
    demo = read_lab_config(built_in()["demo"])
    head = replace(demo.head, layout="ring", cameras=2, baseline=0.25, columns=640, rows=480)
    config = replace(demo, head=head, seed=100 + number)
    rig = make_head(config.head, config.specimen.mesh)
    body = rendered_body(config, rig, choose_variant())
    force = demo.probes[0].force or 0.45
    world, pushes = VirtualWorld(config, rig, body, force), []
    for probe in demo.probes:
        inward = -probe.point / np.linalg.norm(probe.point)
        world.aim_at(probe.point, inward)
        newtons = float(world.force_at(np.array([DEPTH]))[0])
        loaded = [list(world.drawn(depth)) for depth in DEPTHS]
        pushes.append((probe.point, inward, newtons, loaded))
    return Body(config, rig, list(body.draw(body.vertices, None)), pushes)


def taken(kind: Cameras, camera: int, loaded: list[Levels], phase: float) -> np.ndarray:
    """Mean levels of one camera under load, each row at its own time."""
    stack = np.stack([levels[camera] for levels in loaded])
    rows = np.arange(stack.shape[1])
    total = np.zeros(stack.shape[1:])
    frames = AVERAGED if kind.holds else 1
    for frame in range(frames):
        time = kind.offset * camera + kind.rolling * (rows / len(rows) - 0.5) + frame / FRAMES
        depth = DEPTH * (1.0 + TREMOR * np.sin(2.0 * np.pi * SHAKES * time + phase))
        if not kind.holds:
            depth = DEPTH + RATE * time
        k = np.clip(np.searchsorted(DEPTHS, depth) - 1, 0, len(DEPTHS) - 2)
        share = ((depth - DEPTHS[k]) / np.diff(DEPTHS)[k])[:, None]
        total += (1.0 - share) * stack[k, rows] + share * stack[k + 1, rows]
    return total / frames


def shot(kind: Cameras, levels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The mean of some pictures of these levels as the camera gives it."""
    if kind.shrink > 1:
        levels = cv2.resize(levels, None, fx=1 / kind.shrink, fy=1 / kind.shrink,
                            interpolation=cv2.INTER_AREA)  # fmt: skip
    count = AVERAGED if kind.holds else 1
    levels = levels * np.exp(kind.exposure * rng.standard_normal())
    levels = levels + kind.noise / np.sqrt(count) * rng.standard_normal(levels.shape)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def measured(kind: Cameras, body: Body, seed: int, cache: Path) -> tuple[float, ...]:
    """Errors of E (relative) and nu with their standard deviations, and which intervals hold."""
    rng = np.random.default_rng([seed, 9])
    gain, material = 1.0 + GAIN * rng.standard_normal(), body.config.material
    head = {"object": {"mesh": "mesh.ply", "length_unit": "m"}, "rig": {"cameras": "rig.toml"},
            "support": dict(body.config.specimen.support)}  # fmt: skip
    contact = {"tool": "sphere", "tool_radius": body.config.arm.radius}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_mesh(folder / "mesh.ply", body.config.specimen.mesh)
        write_rig(folder / "rig.toml", shrunk(body.rig, kind.shrink))
        session = LiveSession(folder, head, contact, by_hand=False, cache=cache)
        for point, inward, newtons, loaded in body.pushes:
            phase = rng.uniform(0.0, 2.0 * np.pi)
            views = [taken(kind, camera, loaded, phase) for camera in range(2)]
            push = TakenPush(
                tuple(shot(kind, levels, rng) for levels in body.rest),
                tuple(shot(kind, levels, rng) for levels in views),
                None, newtons * gain * (1.0 + NOISE * rng.standard_normal()), NOISE * newtons,
            )  # fmt: skip
            session.add(push, point, inward)
        estimate = session.fit(session.measured()).estimate
    truth = {
        "young_modulus": material.young_modulus, "poisson_ratio": material.poisson_ratio,
        "shear_modulus": material.young_modulus / (2.0 * (1.0 + material.poisson_ratio)),
    }  # fmt: skip
    young, ratio = estimate.young_modulus, estimate.poisson_ratio
    holds = dict(zip(("nu", "G", "E"), held(estimate, truth), strict=True))
    return (
        young.value / truth["young_modulus"] - 1.0, young.std / truth["young_modulus"],
        ratio.value - truth["poisson_ratio"], ratio.std, float(holds["E"]), float(holds["nu"]),
    )  # fmt: skip


def shrunk(rig: Rig, by: int) -> Rig:
    """The rig of pictures so many times smaller."""
    cameras = []
    for camera in rig.cameras:
        matrix = camera.matrix / by
        matrix[:2, 2] = (camera.matrix[:2, 2] + 0.5) / by - 0.5
        matrix[2, 2] = 1.0
        columns, rows = camera.size or (0, 0)
        cameras.append(replace(camera, matrix=matrix, size=(columns // by, rows // by)))
    return replace(rig, cameras=tuple(cameras))


def main() -> None:
    """Measure all kinds, write what each session gave, and print the table."""
    file, count = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else SESSIONS
    bodies = [made(number) for number in range(min(BODIES, count))]
    lines = ["cameras,session,E error,E sigma,nu error,nu sigma,E held,nu held"]
    with tempfile.TemporaryDirectory() as cache:
        for kind in KINDS:
            rows = []
            for seed in range(round(kind.share * count)):
                try:
                    rows.append(measured(kind, bodies[seed % len(bodies)], seed, Path(cache)))
                except PalpateError as error:
                    print(f"{kind.name}, session {seed}: {error}", flush=True)
                    lines.append(f"{kind.name},{seed},,,,,0,0")
                    continue
                lines.append(f"{kind.name},{seed}," + ",".join(f"{x:.5g}" for x in rows[-1]))
                file.write_text("\n".join(lines) + "\n")
            if not rows:
                continue
            young, sigma, ratio, other, *hits = np.array(rows).T
            print(
                f"| {kind.name} | {100 * np.sqrt(np.mean(young**2)):.2g} %,"
                f" {100 * np.median(sigma):.2g} % | {np.sqrt(np.mean(ratio**2)):.2g},"
                f" {np.median(other):.2g} | {hits[0].sum():.0f}; {hits[1].sum():.0f}"
                f" of {round(kind.share * count)} |",
                flush=True,
            )


if __name__ == "__main__":
    main()

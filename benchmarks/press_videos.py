"""Videos of presses on the virtual half ball, with a force log: a recording whose truth is known.

The facility solves each press at twelve depths and renders the ball at rest once for each camera,
at twice the resolution. A frame is that picture warped by the projected displacement of the model,
interpolated over the depth; what is interpolated is the smooth motion, never a picture. The rod is
drawn as it is, without its shadow; light does not follow the surface's slope. Every frame has its
own noise. Files are AVI without losses (FFV1).
"""

import argparse
import pickle
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path

import cv2
import numpy as np
import tomlkit
from scipy.interpolate import CubicSpline
from scipy.ndimage import distance_transform_edt

from palpate.disk import write_bytes
from palpate.geometry import write_mesh
from palpate.lab import LabConfig, built_in, choose_variant, read_lab_config
from palpate.lab.bench.arm import aim, fine_place, rod_at
from palpate.lab.bodies import (
    Tip,
    held_nodes,
    make_body,
    make_solid,
    press,
    press_to_force,
    surface_values,
)
from palpate.lab.pictures import make_head, make_studio, photograph
from palpate.records import Camera, Rig, write_rig, write_text
from palpate.vision import project, surface_map

FRAME_RATE, GAUGE_RATE = 30.0, 500.0
# The gauge's clock is so far ahead of the cameras' [s].
CLOCK_OFFSET = 0.4
PRESSES, DEPTHS = 10, 6
# Of each press [s]: the tool comes, goes in, rests, comes out, goes away, is away; the last of
# these is not always the same.
APPROACH, RAMP, HOLD, PAUSE = 0.6, 0.7, 1.5, (1.6, 2.0, 1.8)
# The tool comes from so far [m]; its weight [N]; the gauge's noise and its drift till the end.
FAR = 0.06
WEIGHT = np.array([0.03, -0.05, -0.9])
GAUGE_NOISE, DRIFT = 0.002, 0.02
PICTURE_NOISE = 1.5
_ROD = 8.0
# Finite elements away from the tip [m]: both sessions that are compared rest on the same ones.
_ELEMENT = 0.008


@dataclass(frozen=True, slots=True)
class Truth:
    """One press as it was: the force at full depth [N], its contact, and its times [s]."""

    force: np.ndarray
    point: np.ndarray
    radius: float
    begin: float
    loaded: float
    rest: float


def smooth(share: np.ndarray) -> np.ndarray:
    """From 0 to 1 without a jerk."""
    s = np.clip(share, 0.0, 1.0)
    return s**2 * (3.0 - 2.0 * s)


def begins() -> np.ndarray:
    """When each press touches, gauge's clock [s]."""
    found, time = [], 2.0
    for k in range(PRESSES):
        found.append(time)
        time += 2.0 * RAMP + HOLD + 2.0 * APPROACH + PAUSE[k % 3]
    return np.array(found)


def depth_share(time: np.ndarray, begin: float) -> np.ndarray:
    """How deep the tool is of its greatest depth; negative above the surface, in parts of `FAR`."""
    inside = smooth((time - begin) / RAMP) - smooth((time - begin - RAMP - HOLD) / RAMP)
    before = np.clip((begin - time) / APPROACH, 0.0, None)
    after = np.clip((time - begin - 2.0 * RAMP - HOLD) / APPROACH, 0.0, None)
    away = before + after
    return np.where(away > 0.0, -away, inside)


def duration() -> float:
    """Length of the recording [s]."""
    return float(begins()[-1] + 2.0 * RAMP + HOLD + APPROACH + 1.5)


class PressedBall:
    """One press solved at several depths: its force, and how the pixels of every camera move."""

    def __init__(self, config: LabConfig, tip: Tip, file: Path) -> None:
        solved = pickle.loads(file.read_bytes())
        share, moved = solved["share"], solved["moved"]
        self.tip, self.point, self.radius = tip, solved["point"], solved["radius"]
        self.place, self.depth = solved["place"], solved["depth"]
        # Hertz: the force grows with the power 1.5 of the depth; the rest is smooth.
        self.force_law = CubicSpline(np.sqrt(share), solved["force"])
        self._motion = partial(pixel_motion, config=config, solid=solved["solid"], moved=moved)
        self._share = share

    def field(self, camera: Camera) -> CubicSpline:
        """Motion of the pixels of a camera over the share of the depth."""
        return CubicSpline(self._share, self._motion(camera))

    def force(self, share: np.ndarray) -> np.ndarray:
        """Force of the tool on the ball at a share of the depth [N], (n, 3)."""
        touching = np.clip(share, 0.0, 1.0)
        return np.where(touching[:, None] > 0.0, self.force_law(np.sqrt(touching)), 0.0)

    def tip_place(self, share: float) -> np.ndarray:
        """Where the tip is [m]; its own point of reference."""
        along = self.depth * (share - 1.0) if share >= 0.0 else -self.depth + FAR * share
        return self.place + along * self.tip.direction


def solve_press(config: LabConfig, tip: Tip, k: int) -> dict[str, object]:
    """One press solved at several depths: a body, its displacements, forces and the contact."""
    probe = config.probes[k]
    fine = (fine_place(tip, probe, config.material),)
    solid = make_solid(config.specimen.body, edge=config.specimen.element, fine=fine)
    body = make_body(
        solid, held_nodes(solid, config.specimen.held),
        shear_modulus=config.material.shear_modulus,
        poisson_ratio=config.material.poisson_ratio,
    )  # fmt: skip
    last = press_to_force(body, tip, float(probe.force or 0.0))
    share = np.arange(DEPTHS + 1) / DEPTHS
    states = press(body, tip, share[1:] * last.depth)
    return {
        "solid": solid, "share": share, "place": last.place, "depth": last.depth,
        "moved": np.stack([np.zeros_like(solid.nodes), *(s.displacement for s in states)]),
        "force": np.array([np.zeros(3), *(state.force for state in states)]),
        "point": probe.point, "radius": last.radius,
    }  # fmt: skip


def pixel_motion(camera: Camera, config: LabConfig, solid: object, moved: np.ndarray) -> np.ndarray:
    """Motion [px] of every second pixel in every state, (k, rows, columns, 2) float32."""
    mesh = config.specimen.mesh
    columns, rows = camera.size or (0, 0)
    seen = surface_map(camera, (rows, columns), mesh.vertices, mesh.triangles).point[::2, ::2]
    known = np.isfinite(seen[..., 0])
    rest = seen[known]
    carried = surface_values(solid, rest)  # type: ignore[arg-type]
    start = project(camera, rest)
    result = np.zeros((len(moved), *known.shape, 2), dtype=np.float32)
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    for k, displacement in enumerate(moved):
        single = np.zeros((*known.shape, 2), dtype=np.float32)
        single[known] = project(camera, rest + carried @ displacement) - start
        result[k] = single[nearest[0], nearest[1]]
    return result


def double_camera(camera: Camera) -> Camera:
    """The same camera with pixels of half the side."""
    columns, rows = camera.size or (0, 0)
    matrix = camera.matrix.copy()
    matrix[:2] *= 2.0
    matrix[:2, 2] += 0.5
    return replace(camera, size=(2 * columns, 2 * rows), matrix=matrix)


def rest_pictures(config: LabConfig, rig: Rig, file: Path) -> list[np.ndarray]:
    """The ball at rest in every camera at twice the resolution, without noise, float32."""
    if file.exists():
        with np.load(file) as kept:
            return list(kept["pictures"])
    sharp = replace(config.pictures, noise=0.0, response=0.0, bits=12, samples=9)
    double = Rig(tuple(map(double_camera, rig.cameras)), rig.reference, rig.source)
    studio = make_studio(
        replace(config, pictures=sharp), double, choose_variant(), rng=np.random.default_rng(1)
    )
    taken = photograph(studio, [studio.mesh.vertices], rng=np.random.default_rng(2))
    pictures = [picture.astype(np.float32) / 257.0 for picture in taken]
    np.savez(file, pictures=pictures)
    return pictures


def write_video(path: Path, pictures: Iterator[np.ndarray]) -> None:
    """Write frames without losses; the file has its name once it is whole."""
    draft = path.with_name(f"draft_{path.name}")
    first = next(pictures)
    code = cv2.VideoWriter_fourcc(*"FFV1")
    writer = cv2.VideoWriter(str(draft), code, FRAME_RATE, first.shape[::-1])
    for frame in chain([first], pictures):
        writer.write(cv2.merge([frame] * 3))
    writer.release()
    draft.rename(path)


def warped(rest: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """A picture at twice the resolution, moved by a field at half of it."""
    rows, columns = rest.shape
    field = cv2.resize(
        2.0 * motion.astype(np.float32), (columns, rows), interpolation=cv2.INTER_CUBIC
    )
    y, x = np.mgrid[0:rows, 0:columns].astype(np.float32)
    # The field's first sample is at the first pixel, not at the middle of four.
    shift = 1.0
    field = cv2.warpAffine(
        field, np.float32([[1, 0, -shift], [0, 1, -shift]]), (columns, rows),
        flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    back = field
    for _ in range(3):
        back = cv2.remap(field, x - back[..., 0], y - back[..., 1], cv2.INTER_LINEAR)
    return cv2.remap(rest, x - back[..., 0], y - back[..., 1], cv2.INTER_LANCZOS4)


def with_rod(
    picture: np.ndarray, camera: Camera, tip: Tip, place: np.ndarray, rig: Rig
) -> np.ndarray:
    """The rod in front of a picture at twice the resolution."""
    outline = project(double_camera(camera), rod_at(tip, place, rig.cameras).vertices)
    hull = cv2.convexHull(np.rint(16.0 * outline).astype(np.int32))
    return cv2.fillConvexPoly(picture, hull, _ROD, lineType=cv2.LINE_AA, shift=4)


def chip(picture: np.ndarray, config: LabConfig) -> np.ndarray:
    """What the chip gets of a picture at twice the resolution, without noise."""
    blurred = cv2.GaussianBlur(picture, (0, 0), 2.0 * config.pictures.response)
    rows, columns = blurred.shape
    return cv2.resize(blurred, (columns // 2, rows // 2), interpolation=cv2.INTER_AREA)


def frames(
    camera_number: int,
    rig: Rig,
    config: LabConfig,
    rest: np.ndarray,
    balls: list[PressedBall],
    seed: int,
) -> Iterator[np.ndarray]:
    """Frames of one camera, with noise."""
    camera = rig.cameras[camera_number]
    rng = np.random.default_rng([3, camera_number, seed])
    times = np.arange(0.0, duration() - CLOCK_OFFSET, 1.0 / FRAME_RATE) + CLOCK_OFFSET
    kept: tuple[tuple[int, float], np.ndarray] | None = None
    fields = [ball.field(camera) for ball in balls]
    for time in times:
        shares = [float(depth_share(np.array([time]), begin)[0]) for begin in begins()]
        k = int(np.argmax(shares))
        key = (k, shares[k]) if shares[k] > -1.0 else (-1, 0.0)
        if kept is None or kept[0] != key:
            picture = rest
            if key[0] >= 0:
                if key[1] > 0.0:
                    picture = warped(rest, fields[k](key[1]))
                place = balls[k].tip_place(key[1])
                picture = with_rod(picture.copy(), camera, balls[k].tip, place, rig)
            kept = key, chip(picture, config)
        noisy = kept[1] + PICTURE_NOISE * rng.standard_normal(kept[1].shape)
        yield np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def gauge_readings(balls: list[PressedBall], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and readings of the gauge: weight, drift and noise in them."""
    time = np.arange(0.0, duration(), 1.0 / GAUGE_RATE)
    rng = np.random.default_rng([4, seed])
    force = sum(
        ball.force(depth_share(time, begin)) for ball, begin in zip(balls, begins(), strict=True)
    )
    share = time / time[-1]
    drift = DRIFT * (share + 0.3 * np.sin(2.0 * np.pi * share))[:, None] * [1.0, -0.7, 1.0]
    return time, force + WEIGHT + drift + GAUGE_NOISE * rng.standard_normal((len(time), 3))


def make_recording(
    folder: Path, *, columns: int = 480, rows: int = 360, seed: int = 0
) -> list[Truth]:
    """Write videos, force log, mesh, rig and recording.toml; give what was true."""
    folder.mkdir(parents=True, exist_ok=True)
    config = read_lab_config(built_in()["half-ball"])
    config = replace(
        config,
        head=replace(config.head, columns=columns, rows=rows),
        specimen=replace(config.specimen, element=_ELEMENT),
    )
    rig = make_head(config.head, config.specimen.mesh)
    tips = [
        aim(probe, config.arm, config.specimen.mesh, rng=np.random.default_rng([1, 1, k]))
        for k, probe in enumerate(config.probes[:PRESSES])
    ]
    files = [folder / f"press_{k:02d}.pickle" for k in range(PRESSES)]
    for k, (tip, file) in enumerate(zip(tips, files, strict=True)):
        if not file.exists():
            write_bytes(file, pickle.dumps(solve_press(config, tip, k)))
            print(f"{file} is solved", flush=True)
    balls = [PressedBall(config, tip, file) for tip, file in zip(tips, files, strict=True)]
    videos = [folder / f"{camera.name}.avi" for camera in rig.cameras]
    rests = rest_pictures(config, rig, folder / "rest.npz")
    for number, path in enumerate(videos):
        if not path.exists():
            write_video(path, frames(number, rig, config, rests[number], balls, seed))
            print(f"{path} is written", flush=True)
    write_mesh(folder / "mesh.ply", config.specimen.mesh)
    write_rig(folder / "rig.toml", rig)
    time, force = gauge_readings(balls, seed)
    np.savetxt(
        folder / "force.csv", np.column_stack([time, force]), delimiter=",", comments="",
        header="time [s],Fx [N],Fy [N],Fz [N]", fmt="%.5f",
    )  # fmt: skip
    truths = [
        Truth(
            ball.force(np.ones(1))[0], np.array(ball.point), ball.radius, begin,
            begin + RAMP + HOLD / 2.0, begin - APPROACH - 0.5,
        )
        for ball, begin in zip(balls, begins(), strict=True)
    ]  # fmt: skip
    write_text(folder / "recording.toml", tomlkit.dumps(_recording(config, rig, truths)))
    np.savez(
        folder / "truth.npz", force=[t.force for t in truths], point=[t.point for t in truths],
        radius=[t.radius for t in truths], begin=begins(),
    )  # fmt: skip
    return truths


def _recording(config: LabConfig, rig: Rig, truths: list[Truth]) -> dict[str, object]:
    return {
        "format": "palpate-recording/1",
        "name": "half ball, ten presses",
        "object": {"mesh": "mesh.ply", "length_unit": "m"},
        "support": dict(config.specimen.support),
        "rig": {"cameras": "rig.toml"},
        "force": {"file": "force.csv", "axes": np.eye(3).tolist()},
        "contact": {
            "profile": "hertz",
            "radius": [truth.radius for truth in truths],
            "points": [truth.point.tolist() for truth in truths],
        },
        "camera": [{"name": c.name, "video": f"{c.name}.avi"} for c in rig.cameras],
    }


def main() -> None:
    """Make a recording."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.press_videos", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--columns", type=int, default=480)
    parser.add_argument("--rows", type=int, default=360)
    parser.add_argument("--seed", type=int, default=0, help="of the noise of pictures and gauge")
    options = parser.parse_args()
    make_recording(options.folder, columns=options.columns, rows=options.rows, seed=options.seed)


if __name__ == "__main__":
    main()

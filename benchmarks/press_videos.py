"""Videos of presses on the virtual half ball, with a force log: a recording whose truth is known.

How films are made: `palpate.lab.press_film`. Each press is solved at six depths; files are
AVI without losses (FFV1).
"""

import argparse
import pickle
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tomlkit

from palpate.disk import write_bytes
from palpate.geometry import write_mesh
from palpate.lab import LabConfig, built_in, choose_variant, read_lab_config
from palpate.lab.arm import aim
from palpate.lab.head import make_head
from palpate.lab.press_film import (
    Film,
    SolvedPress,
    film_frames,
    gauge_readings,
    rest_pictures,
    solve_press,
    write_film,
)
from palpate.records import Rig, write_rig, write_text

FILM = Film(presses=10)
# Finite elements away from the tip [m]: both sessions that are compared rest on the same ones.
_ELEMENT = 0.008
# Of every press [N]; those of table 3 are deeper than a recording needs.
_FORCE = 0.4


@dataclass(frozen=True, slots=True)
class Truth:
    """One press as it was: the force at full depth [N], its contact, and its times [s]."""

    force: np.ndarray
    point: np.ndarray
    radius: float
    begin: float
    loaded: float
    rest: float


def kept_press(config: LabConfig, k: int, file: Path) -> SolvedPress:
    """One press, solved once."""
    if not file.exists():
        tip = aim(
            config.probes[k], config.arm, config.specimen.mesh,
            rng=np.random.default_rng([1, 1, k]),
        )  # fmt: skip
        write_bytes(file, pickle.dumps(solve_press(config, tip, k, FILM)))
        print(f"{file} is solved", flush=True)
    press: SolvedPress = pickle.loads(file.read_bytes())
    return press


def make_recording(
    folder: Path, *, columns: int = 480, rows: int = 360, seed: int = 0, solved: Path | None = None
) -> list[Truth]:
    """Write videos, force log, mesh, rig and recording.toml; give what was true.

    `solved` is the folder of the presses, which every draw of the noise shares.
    """
    folder.mkdir(parents=True, exist_ok=True)
    shared = folder if solved is None else solved
    shared.mkdir(parents=True, exist_ok=True)
    config = read_lab_config(built_in()["half-ball"])
    config = replace(
        config,
        head=replace(config.head, columns=columns, rows=rows),
        specimen=replace(config.specimen, element=_ELEMENT),
        probes=tuple(replace(probe, force=_FORCE) for probe in config.probes),
    )
    rig = make_head(config.head, config.specimen.mesh)
    presses = [kept_press(config, k, shared / f"press_{k:02d}.pickle") for k in range(FILM.presses)]
    videos = [folder / f"{camera.name}.avi" for camera in rig.cameras]
    if not all(video.exists() for video in videos):
        rests = rest_pictures(config, rig, choose_variant())
        for number, path in enumerate(videos):
            rng = np.random.default_rng([3, number, seed])
            frames = film_frames(FILM, config, rig, number, rests[number], presses, rng=rng)
            draft = path.with_name(f"draft_{path.name}")
            write_film(draft, frames, FILM.frame_rate)
            draft.rename(path)
            print(f"{path} is written", flush=True)
    write_mesh(folder / "mesh.ply", config.specimen.mesh)
    write_rig(folder / "rig.toml", rig)
    time, force = gauge_readings(FILM, presses, rng=np.random.default_rng([4, seed]))
    np.savetxt(
        folder / "force.csv", np.column_stack([time, force]), delimiter=",", comments="",
        header="time [s],Fx [N],Fy [N],Fz [N]", fmt="%.5f",
    )  # fmt: skip
    truths = [
        Truth(
            press.force[-1], np.array(press.point), press.radius, begin,
            begin + FILM.ramp + FILM.hold / 2.0, begin - FILM.approach - 0.5,
        )
        for press, begin in zip(presses, FILM.start_times, strict=True)
    ]  # fmt: skip
    write_text(folder / "recording.toml", tomlkit.dumps(_recording(config, rig, truths)))
    np.savez(
        folder / "truth.npz", force=[t.force for t in truths], point=[t.point for t in truths],
        radius=[t.radius for t in truths], begin=FILM.start_times,
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
            "tool": "sphere",
            "tool_radius": config.arm.radius,
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

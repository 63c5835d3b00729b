"""`palpate record` on rendered videos whose truth is known, beside a session sorted by hand.

The videos are those of `benchmarks.press_videos`, which takes half an hour to make them once:

    python -m benchmarks.press_videos FOLDER
    python -m benchmarks.recording FOLDER

The session sorted by hand has the frames and readings that a person who knows the right moments
would take: one frame at rest, one in the middle of each hold, the mean of a second of readings less
that of a second before the tool comes.
"""

import argparse
import resource
import shutil
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import tomlkit

from benchmarks.press_videos import FILM
from palpate.lab import built_in, read_lab_config
from palpate.pipeline import fit_session, measure_motion, with_measured_displacement
from palpate.recording import (
    Recorded,
    Recording,
    find_presses,
    read_recording,
    write_recorded,
)
from palpate.records import SESSION_FORMAT, read_session, write_text

# Before the tool comes [s]: when a person takes the picture and the readings at rest.
_BEFORE = FILM.approach + 0.6


def hand_sorted(folder: Path, out: Path) -> None:
    """Write the session that a person who knows the truth would have sorted."""
    out.mkdir(parents=True)
    (out / "images").mkdir()
    recording = read_recording(folder)
    with np.load(folder / "truth.npz") as stored:
        truth = dict(stored)
    loaded = truth["begin"] + FILM.ramp + FILM.hold / 2.0
    wanted = [truth["begin"][0] - _BEFORE, *loaded]
    names = ["rest", *(f"n{k + 1:02d}" for k in range(len(loaded)))]
    numbers = [round((when - FILM.clock_offset) * FILM.frame_rate) for when in wanted]
    for footage in recording.footage:
        capture = cv2.VideoCapture(str(footage.video))
        number = 0
        while (read := capture.read())[0]:
            if number in numbers:
                name = f"{names[numbers.index(number)]}_{footage.camera}.png"
                cv2.imwrite(str(out / "images" / name), read[1][..., 0])
            number += 1
    rows = np.loadtxt(folder / "force.csv", delimiter=",", skiprows=1)

    def mean(centre: float) -> np.ndarray:
        return rows[np.abs(rows[:, 0] - centre) < 0.5, 1:].mean(axis=0)

    probes = [
        {
            "name": names[k + 1],
            "contact": {
                "point": truth["point"][k].tolist(), "tool": "sphere",
                "tool_radius": read_lab_config(built_in()["half-ball"]).arm.radius,
            },
            "force": (mean(loaded[k]) - mean(truth["begin"][k] - _BEFORE)).tolist(),
            "force_std": 0.002,
            "images": {
                "rest": "images/rest_{camera}.png",
                "loaded": [f"images/{names[k + 1]}_{{camera}}.png"],
            },
        }
        for k in range(len(loaded))
    ]  # fmt: skip
    for file in recording.files:
        shutil.copy(file, out)
    content = {"format": SESSION_FORMAT, "name": "by hand", **recording.head, "probe": probes}
    write_text(out / "session.toml", tomlkit.dumps(content))


def report_presses(folder: Path, recording: Recording, found: Recorded) -> None:
    """What was found, against what was true."""
    with np.load(folder / "truth.npz") as stored:
        truth = dict(stored)
    told = tuple(replace(one, offset=FILM.clock_offset) for one in recording.footage)
    known = find_presses(replace(recording, footage=told))
    held = [
        (b + FILM.ramp <= p.reading.begin) and (p.reading.end <= b + FILM.ramp + FILM.hold)
        for p in found.presses
        for b in (truth["begin"][p.number - 1],)
    ]
    errors = [
        np.linalg.norm(p.reading.force - truth["force"][p.number - 1])
        / np.linalg.norm(truth["force"][p.number - 1])
        for p in found.presses
    ]
    claims = [
        np.linalg.norm(p.reading.std) / np.linalg.norm(p.reading.force) for p in found.presses
    ]
    print(f"presses found                 {len(found.presses)} of {len(truth['begin'])}")
    print(f"plateaus within the holds     {sum(held)}")
    for clock in found.clocks:
        off = 1e3 * (clock.offset - FILM.clock_offset)
        print(f"clock of {clock.camera}, off by          {off:+.2f} ms, claimed"
              f" {1e3 * clock.std:.2f}; correlation {clock.correlation:.2f}")  # fmt: skip
    print(f"force, off by                 {100 * max(errors):.3f} % at most, rms"
          f" {100 * np.sqrt(np.mean(np.square(errors))):.3f} %, claimed"
          f" {100 * np.sqrt(np.mean(np.square(claims))):.3f} %")  # fmt: skip
    hysteresis = np.array([clock.hysteresis for clock in known.clocks])
    print(f"hysteresis (there is none)    {100 * np.abs(hysteresis).max():.2f} % at most")
    for note in found.notes:
        print(f"note: {note}")


def report_contacts(folder: Path, recording: Recording, found: Recorded, out: Path) -> None:
    """Contacts found from the pictures, against where the tool was sent."""
    with np.load(folder / "truth.npz") as stored:
        point, radius = stored["point"], stored["radius"]
    unknown = replace(recording.places, points=None)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    placed = write_recorded(out, replace(recording, places=unknown), found)
    off = np.array([np.linalg.norm(one.point - point[one.press.number - 1]) for one in placed])
    std = np.array([one.point_std for one in placed])
    print(f"contacts found, off by        {1e3 * np.sqrt((off**2).mean()):.2f} mm rms,"
          f" {1e3 * off.max():.2f} at most; claimed {1e3 * np.sqrt(2 * (std**2).mean()):.2f} mm;"
          f" contact radius {1e3 * radius.mean():.1f} mm")  # fmt: skip


def report_fit(name: str, folder: Path) -> None:
    """Constants of a session against the truth."""
    material = read_lab_config(built_in()["half-ball"]).material
    start = time.perf_counter()
    session = read_session(folder)
    motion = measure_motion(session, pose="given")
    estimate = fit_session(with_measured_displacement(session, motion)).estimate
    e, nu = estimate.young_modulus, estimate.poisson_ratio
    print(
        f"{name}: E off by {100 * (e.value / material.young_modulus - 1):+.2f} % (claimed"
        f" {100 * e.std / e.value:.2f}), nu by {nu.value - material.poisson_ratio:+.4f} (claimed"
        f" {nu.std:.4f}), {time.perf_counter() - start:.0f} s",
        flush=True,
    )


def main() -> None:
    """Print all rows."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recording", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--step", choices=("presses", "hand", "recorded", "contacts"), nargs="+")
    options = parser.parse_args()
    steps = options.step or ["presses", "hand", "recorded", "contacts"]
    recording = read_recording(options.folder)
    by_hand, recorded = (options.folder / name for name in ("by_hand", "recorded"))
    if "presses" in steps or "contacts" in steps:
        start = time.perf_counter()
        found = find_presses(recording)
        seconds = time.perf_counter() - start
    if "presses" in steps:
        report_presses(options.folder, recording, found)
        frames = sum(len(motion.time) for motion in found.motions)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"time, memory                  {seconds:.0f} s for {frames} frames, {memory:.0f} MB")
        shutil.rmtree(recorded, ignore_errors=True)
        recorded.mkdir()
        write_recorded(recorded, recording, found)
    if "hand" in steps:
        shutil.rmtree(by_hand, ignore_errors=True)
        hand_sorted(options.folder, by_hand)
        report_fit("sorted by hand", by_hand)
    if "recorded" in steps:
        report_fit("recorded      ", recorded)
    if "contacts" in steps:
        report_contacts(options.folder, recording, found, options.folder / "contacts")
        report_fit("contacts found", options.folder / "contacts")


if __name__ == "__main__":
    main()

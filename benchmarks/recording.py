"""`palpate record` on rendered videos whose truth is known, beside a session sorted by hand.

The videos are those of `benchmarks.press_videos`, which takes some minutes to make them once:

    python -m benchmarks.press_videos FOLDER --seed 1
    python -m benchmarks.recording FOLDER [FOLDER ...]

The session sorted by hand has the frames and readings that a person who knows the right moments
would take: one frame at rest, one in the middle of each hold, the mean of a second of readings less
that of a second before the tool comes.
"""

import argparse
import resource
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import tomlkit

from benchmarks.figure import DOOR, Figure
from benchmarks.machine import MADE
from benchmarks.options import Options
from benchmarks.press_videos import FILM, make_recording
from benchmarks.report import with_notes
from palpate.lab import built_in, read_lab_config
from palpate.pipeline import fit_session, measure_motion, with_measured_displacement
from palpate.recording import Recorded, find_presses, read_recording, write_recorded
from palpate.records import SESSION_FORMAT, read_session, write_text

# Before the tool comes [s]: when a person takes the picture and the readings at rest.
_BEFORE = FILM.approach + 0.6
# Recordings that differ in the noise of pictures and gauge.
DRAWS = 3


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


@dataclass(frozen=True, slots=True)
class Found:
    """What `palpate record` found of one recording, against what was true.

    Attributes
    ----------
    presses, held, true : int       found; with their plateau within the time the tool was held; all
    clock : float [s]               offset of the worst camera's clock
    force : float [-]               relative error of the worst force
    claimed : float [-]             of a force, rms
    megabytes, seconds : float      of the search
    """

    presses: int
    held: int
    true: int
    clock: float
    force: float
    claimed: float
    megabytes: float
    seconds: float


@dataclass(frozen=True, slots=True)
class Fitted:
    """Errors of the constants of one session, E's relative, and what was claimed of them."""

    young: float
    ratio: float
    young_std: float
    ratio_std: float


def found_presses(folder: Path) -> tuple[Found, Recorded]:
    """Make the session of a recording, and compare what was chosen with the truth."""
    recording = read_recording(folder)
    with np.load(folder / "truth.npz") as stored:
        truth = dict(stored)
    start = time.perf_counter()
    made = find_presses(recording)
    seconds = time.perf_counter() - start
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    shutil.rmtree(folder / "recorded", ignore_errors=True)
    (folder / "recorded").mkdir()
    write_recorded(folder / "recorded", recording, made)
    numbers = [p.number - 1 for p in made.presses]
    begin, size = truth["begin"][numbers] + FILM.ramp, np.linalg.norm(truth["force"], axis=1)
    held = [
        b <= p.reading.begin and p.reading.end <= b + FILM.hold
        for b, p in zip(begin, made.presses, strict=True)
    ]
    read, std = (np.stack([getattr(p.reading, x) for p in made.presses]) for x in ("force", "std"))
    errors = np.linalg.norm(read - truth["force"][numbers], axis=1) / size[numbers]
    claims = np.linalg.norm(std, axis=1) / size[numbers]
    outcome = Found(
        len(made.presses), sum(held), len(size),
        max(abs(clock.offset - FILM.clock_offset) for clock in made.clocks),
        float(errors.max()), float(np.sqrt(np.mean(claims**2))), megabytes, seconds,
    )  # fmt: skip
    return outcome, made


def found_contacts(folder: Path, made: Recorded) -> tuple[Fitted, str]:
    """The session whose contacts were found from the pictures, and how far off they are."""
    recording, out = read_recording(folder), folder / "contacts"
    with np.load(folder / "truth.npz") as stored:
        point, radius = stored["point"], stored["radius"]
    unknown = replace(recording.contact_source, points=None)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    placed = write_recorded(out, replace(recording, contact_source=unknown), made)
    off = np.array(
        [np.linalg.norm(press.point - point[press.press.number - 1]) for press in placed]
    )
    std = np.array([press.point_std for press in placed])
    said = (
        f"contacts found without a log are off by {1e3 * np.sqrt((off**2).mean()):.2f} mm rms,"
        f" {1e3 * off.max():.2f} at most; claimed {1e3 * np.sqrt(2 * (std**2).mean()):.2f} mm;"
        f" contact radius {1e3 * radius.mean():.1f} mm"
    )
    return fitted(out), said


def fitted(folder: Path) -> Fitted:
    """Constants of a session against the truth."""
    material = read_lab_config(built_in()["half-ball"]).material
    session = read_session(folder)
    motion = measure_motion(session, pose="given")
    estimate = fit_session(with_measured_displacement(session, motion)).estimate
    e, nu = estimate.young_modulus, estimate.poisson_ratio
    return Fitted(
        e.value / material.young_modulus - 1.0, nu.value - material.poisson_ratio,
        e.std / e.value, nu.std,
    )  # fmt: skip


def press_figures(outcomes: Sequence[Found]) -> list[Figure]:
    """What was found of some recordings."""
    name = f"`palpate record`, {len(outcomes)} x ten presses"
    every = sum(outcome.true for outcome in outcomes)
    presses, held = (
        sum(getattr(outcome, which) for outcome in outcomes) for which in ("presses", "held")
    )
    # The peak of the process: those after the first have fits before them.
    first = outcomes[0].megabytes
    return [
        Figure(DOOR, f"{name}: presses found", 100.0 * presses / every, "%",
               note=f"{presses} of {every}, {held} plateaus while the tool was held;"
               f" {first:.0f} MB and {np.mean([outcome.seconds for outcome in outcomes]):.0f} s a"
               " minute of three videos"),
        Figure(DOOR, f"{name}: clock of the worst camera",
               1e3 * max(outcome.clock for outcome in outcomes), "ms",
               note="the gauge's clock is 0.4 s ahead"),
        Figure(DOOR, f"{name}: the worst force",
               100 * max(outcome.force for outcome in outcomes), "%",
               note="claimed"
               f" {100 * np.sqrt(np.mean([outcome.claimed**2 for outcome in outcomes])):.3f} %"),
    ]  # fmt: skip


def fit_figures(recorded: Sequence[Fitted], by_hand: Sequence[Fitted], which: str) -> list[Figure]:
    """Errors over those of the sessions sorted by hand."""
    figures = []
    for term, short, factor, unit in (("young", "E", 100.0, " %"), ("ratio", "nu", 1.0, "")):
        ours, theirs = (
            factor * np.array([getattr(draw, term) for draw in some])
            for some in (recorded, by_hand)
        )
        claim, other = (
            factor * float(np.sqrt(np.mean([getattr(draw, f"{term}_std") ** 2 for draw in some])))
            for some in (recorded, by_hand)
        )
        note = (
            f"{len(ours)} draws of all noise; off by {_listed(ours)}{unit} (claimed {claim:.2g});"
            f" by hand {_listed(theirs)}{unit} (claimed {other:.2g})"
        )
        ratio = float(np.sqrt((ours**2).mean() / (theirs**2).mean()))
        what = f"{which}: rms error of {short} over that of sessions sorted by hand"
        figures.append(Figure(DOOR, what, ratio, "x", note=note))
    return figures


def _listed(errors: np.ndarray) -> str:
    return ", ".join(f"{error:+.2g}" for error in errors)


def measure(options: Options) -> list[Figure]:
    """Draws of the noise of pictures and gauge; in a quick run one, with small pictures."""
    if options.quick:
        folder = MADE / "press_videos" / "small"
        make_recording(folder, columns=240, rows=180, solved=folder.parent / "solved")
        return press_figures([found_presses(folder)[0]])
    folders = [MADE / "press_videos" / f"draw_{seed}" for seed in range(1, DRAWS + 1)]
    for seed, folder in enumerate(folders, start=1):
        if not (folder / "truth.npz").exists():
            make_recording(folder, seed=seed, solved=folder.parent / "solved")
    return figures_of(folders)


def figures_of(folders: Sequence[Path]) -> list[Figure]:
    """All figures of some recordings."""
    made = [found_presses(folder) for folder in folders]
    by_hand, recorded = [], []
    for folder in folders:
        shutil.rmtree(folder / "by_hand", ignore_errors=True)
        hand_sorted(folder, folder / "by_hand")
        by_hand.append(fitted(folder / "by_hand"))
        recorded.append(fitted(folder / "recorded"))
    contacts, said = found_contacts(folders[0], made[0][1])
    first = fit_figures([contacts], by_hand[:1], "session of which the contacts were found")
    return [
        *press_figures([outcome for outcome, _ in made]),
        *fit_figures(recorded, by_hand, "recorded session"),
        *(replace(figure, note=f"{said}; {figure.note}") for figure in first),
    ]


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recording", description=__doc__)
    parser.add_argument("folder", type=Path, nargs="+")
    print(with_notes(figures_of(parser.parse_args().folder)))


if __name__ == "__main__":
    main()

"""Kinds of broken recordings, and of folders that no session can be begun in."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from faults.kind import Kind, replaced, written
from recording.bench_footage import RATE
from recording.bench_signals import HOLD, RAMP, begins

_FILE = "recording.toml"
_RECORD = ("record", ".", "--out", "s")


def _kind(name: str, damage: Callable[[Path], object], *says: str) -> Kind:
    return Kind(f"recording: {name}", damage, _RECORD, says, example="recorded")


def _init(name: str, damage: Callable[[Path], object], folder: str, *says: str) -> Kind:
    return Kind(f"init: {name}", damage, ("init", folder), says)


def _log(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Damage: the force log's numbers are changed."""
    path = folder / "force.csv"
    heading = path.read_text().partition("\n")[0]
    rows = change(np.loadtxt(path, delimiter=",", skiprows=1))
    np.savetxt(path, rows, delimiter=",", header=heading, comments="", fmt="%.6g")


def _without_presses(rows: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(6)
    quiet = rows[:200, 1:].mean(axis=0) + 0.003 * rng.standard_normal((len(rows), 3))
    return np.column_stack([rows[:, 0], quiet])


def _with_gaps(rows: np.ndarray) -> np.ndarray:
    held = [(rows[:, 0] > b + RAMP) & (rows[:, 0] < b + RAMP + HOLD) for b in begins(3)]
    return rows[~np.any(held, axis=0)]


def _clipped(rows: np.ndarray) -> np.ndarray:
    return np.column_stack([rows[:, :3], np.maximum(rows[:, 3], -1.7)])


def _shortened(folder: Path) -> None:
    """Damage: a video ends after two seconds, before the first press rests."""
    capture = cv2.VideoCapture(str(folder / "c1.avi"))
    pictures = [capture.read()[1] for _ in range(int(2.0 * RATE))]
    code = cv2.VideoWriter_fourcc(*"FFV1")
    writer = cv2.VideoWriter(str(folder / "c1.avi"), code, RATE, pictures[0].shape[1::-1])
    for picture in pictures:
        writer.write(picture)
    writer.release()


def _both(*damages: Callable[[Path], object]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        for damage_one in damages:
            damage_one(folder)

    return damage


_UNIT = replaced("force.csv", "Fx [N],Fy [N],Fz [N]", "Fx [kN],Fy [kN],Fz [kN]")
_TOLD = replaced(_FILE, "axes = [[1, 0", 'unit = "mN"\naxes = [[1, 0')
_TURNED = replaced(_FILE, "axes = [[1, 0", 'sign = "on tool"\naxes = [[1, 0')
_TIMES = _both(
    written("t.csv", "time\n0.0\n0.1\n0.2\n"),
    replaced(_FILE, 'video = "c1.avi"', 'video = "c1.avi"\ntimes = "t.csv"'),
)
_POINT = replaced(_FILE, ", [0.0, 0.001, 0.0]", "")

KINDS = [
    _kind("one video for two cameras", replaced(_FILE, '"c1.avi"', '"c0.avi"'),
          "recording.toml: [[camera]] number 2 video: cameras 'c0' and 'c1' have the same"),
    _kind("times that are milliseconds", replaced("force.csv", "time [s]", "time [ms]"),
          "force.csv: its times run over 0.017595 s", "time_unit"),
    _kind("a log in kilonewtons", _UNIT, "force.csv", "another unit", "`unit`"),
    _kind("two units", _TOLD, "force.csv", "contradict"),
    _kind("a sign that is turned", _TURNED, _FILE, "press 1", "out of the surface", "on tool"),
    _kind("gaps at every load", partial(_log, change=_with_gaps), "none of the presses", "gaps"),
    _kind("a gauge at its end", partial(_log, change=_clipped), "end of its range", "none of the presses"),
    _kind("no press", partial(_log, change=_without_presses), "force.csv", "no press is found"),
    _kind("a log without rows", written("force.csv", "t,Fx,Fy,Fz\n"), "force.csv", "no rows"),
    _kind("no such log", replaced(_FILE, "force.csv", "f.csv"), "[force] file", "no such file"),
    _kind("no video", written("c0.avi", b"RIFF nothing"), "c0.avi", "cannot be decoded"),
    _kind("a video that names another file", written("c0.avi", "ffconcat version 1.0\nfile c1.avi\n"),
          "c0.avi: cannot be decoded as a video"),
    _kind("a video that is too short", _shortened, "'c1'", "do not change with the force"),
    _kind("a clock that is wrong", replaced(_FILE, '"c0.avi"', '"c0.avi"\noffset = 0.9'), "'c0'",
          "said to be 0.9 s", "not synchronised"),
    _kind("times of another video", _TIMES, "c1.avi", "3"),
    _kind("a point too few", _POINT, "[contact] points", "2 entries", "3 presses"),
    _kind("an unknown key", replaced(_FILE, "[force]\nfile", "[force]\nfil"), "unknown key", "file"),
    _kind("another format", replaced(_FILE, "recording/1", "recording/2"), _FILE, "format"),
    _kind("a camera without video", replaced(_FILE, '[[camera]]\nname = "c1"\nvideo = "c1.avi"', ""),
          "c1", "have no table"),
    _kind("axes askew", replaced(_FILE, "[0, 1, 0], [0, 0, 1]]", "[1, 1, 0], [0, 0, 1]]"), "axes",
          "perpendicular"),
    _kind("a camera twice", replaced(_FILE, 'name = "c1"', 'name = "c0"'), "[[camera]]", "twice"),
    _init("a session is there", lambda folder: None, ".", "session.toml", "already"),
    _init("a whole disk", lambda folder: None, "/", "the whole disk", "one measurement"),
    _init("no such folder", lambda folder: None, "nowhere", "nowhere", "no such folder"),
    _init("no mesh", lambda folder: (folder / "empty").mkdir(), "empty", "no surface"),
]  # fmt: skip

"""Every command that writes, killed at every step, asked to end, and on a full disk.

One run keeps what a kill would leave before each of its steps: the old state or the new one, as a
user sees it. Then steps fail one at a time, or a signal comes: some in `make test`, nearly all in
`make slow`, and with `PALPATE_FUZZ_EXAMPLES` all, in every way.
"""

import hashlib
import os
import shutil
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

import cv2
import numpy as np
import pytest
from fault_injection import all_states, in_child
from faults.bench import write_scan, write_shots
from faults.samples import POKES

from palpate.app import commands
from palpate.app.cli import main
from palpate.app.commands import calibrate
from palpate.calibration import ObjectView
from palpate.campaign.rows import Row
from palpate.campaign.store import Store
from palpate.geometry import TriangleMesh, register
from palpate.records import Rig

# What is run in a folder that has all that it needs, and what it reads there.
_COMMANDS = {
    "fit": ("fit", "cube", "--out", "made"),
    "flow": ("flow", "pictured", "--pose", "given", "--no-pictures", "--out", "made"),
    "init": ("init", "new", "--mesh", "mesh.ply"),
    "mesh": ("mesh", "mesh.ply", "--vertices", "60", "--out", "made"),
    "scan": ("scan", "ball", "--vertices", "60", "--out", "made"),
    "a board": ("calibrate", "board", "made.png", "--columns", "3", "--rows", "3"),
    "calibrate": (
        "calibrate", "shots", "--target", "chessboard", "--columns", "7", "--rows", "5", "--square",
        "16mm", "--out", "made",
    ),
    "an object before a rig": (
        "calibrate", "object", "rest_{camera}.png", "mesh.ply", "--rig", "rig.toml", "--out",
        "made",
    ),
    "a plan": ("plan", "cube", "--count", "1", "--out", "made"),
    "a recording": ("record", "recorded", "--out", "made"),
    "a screenshot": ("view", "result", "--screenshot", "made.png"),
    "export": ("export", "result", "--to", "obj", "--out", "made"),
    "report": ("report", "result", "--out", "made.html"),
    "a campaign's table": ("campaign", "table", "many", "--out", "made.csv"),
    "a campaign's picture": ("campaign", "plot", "many", "--out", "made.png"),
    "pokes": (
        "import", "pokes", "pokes.csv", "--tool-radius", "8mm", "--thickness", "20mm", "--out",
        "made",
    ),
    "a compression": (
        "compression", "record.csv", "--diameter", "50mm", "--height", "30mm", "--out", "made.json",
    ),
}  # fmt: skip
# Every state is copied and read: nothing lies beside what a command is about, but where all that is
# there must stay as it was.
_READS = {
    "fit": ("cube",),
    "flow": ("pictured",),
    "init": ("mesh.ply", "new"),
    "mesh": ("mesh.ply",),
    "scan": ("ball",),
    "a board": ("mesh.ply",),
    "calibrate": ("shots",),
    "an object before a rig": ("rest_c0.png", "rest_c1.png", "mesh.ply", "rig.toml"),
    "a plan": ("cube",),
    "a recording": ("recorded",),
    "a screenshot": ("result", "cube"),
    "export": ("result", "cube"),
    "report": ("result", "cube"),
    "a campaign's table": ("many", "list.txt", "cube"),
    "a campaign's picture": ("many", "list.txt", "cube"),
    "pokes": ("pokes.csv",),
    "a compression": ("record.csv",),
}
# They leave result folders as `fit` does, by whom some steps are tried.
_LIKE_FIT = (
    "flow", "scan", "calibrate", "pokes", "export", "an object before a rig", "a plan",
    "a recording",
)  # fmt: skip
# Seconds each: in `make slow` every fifth step, which the four faults take in turn.
_SLOW = ("flow", "scan", "a recording")
_FAULTS = ("ENOSPC", "SIGTERM", "EIO", "EINTR")
_IN_EVERY_WAY = "PALPATE_FUZZ_EXAMPLES" in os.environ


def _visible(folder: Path) -> dict[str, str]:
    """Digest of every file whose name, and whose folders' names, are not hidden."""
    return {
        name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not _is_hidden(name := path.relative_to(folder).as_posix())
    }


def _is_hidden(name: str) -> bool:
    return any(part.startswith(".") for part in Path(name).parts)


def _hidden(folder: Path) -> list[str]:
    return [path.name for path in folder.rglob(".*")]


@pytest.fixture(scope="module", autouse=True)
def _imported() -> None:
    """What commands import when they are called: here once, or each fork would do it again."""
    for module in walk_packages(commands.__path__, f"{commands.__name__}."):
        import_module(module.name)


@pytest.fixture(scope="module")
def place(bench: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bench with all that the commands need to end well."""
    folder = tmp_path_factory.mktemp("interrupted") / "work"
    shutil.copytree(bench, folder)
    (folder / "new").mkdir()
    strain = np.linspace(0.0, 0.1, 40)
    (folder / "pokes.csv").write_text(POKES)
    rows = np.stack([30.0 * strain, 1e5 * strain * np.pi * 0.025**2], axis=1)
    np.savetxt(folder / "record.csv", rows, delimiter=",", header="displacement,force", comments="")
    constants = {"young_modulus": 5e4, "poisson_ratio": 0.3, "shear_modulus": 2e4}
    ends = {f"{name}_{end}": value for name, value in constants.items() for end in ("low", "high")}
    Store(folder / "many").set_row(Row("cube", "", "done", "ok", **constants, **ends))
    write_shots(folder / "shots")
    return folder


def _copied(name: str, request: pytest.FixtureRequest, work: Path) -> None:
    """A folder with what a command reads; what few commands need is made for them alone."""
    work.mkdir()
    prepared: Path = request.getfixturevalue("place")
    for read in _READS[name]:
        if read in ("recorded", "pictured"):
            shutil.copytree(request.getfixturevalue(read), work / read)
            if read == "pictured":
                _speckle(work / read)
        elif read == "ball":
            write_scan(work / read)
        elif (prepared / read).is_dir():
            shutil.copytree(prepared / read, work / read)
        else:
            shutil.copy2(prepared / read, work / read)


def _speckle(folder: Path) -> None:
    """Pictures with a texture that can be followed, though not from one camera to the other."""
    rng = np.random.default_rng(2)
    for camera in ("c0", "c1"):
        blurred = cv2.GaussianBlur(rng.standard_normal((120, 160)), (0, 0), 1.5)
        for instant in ("a", "b"):
            noise = rng.standard_normal(blurred.shape)
            grey = np.clip(128.0 + 300.0 * blurred + noise, 0.0, 255.0).astype(np.uint8)
            cv2.imwrite(str(folder / f"{instant}_{camera}.png"), grey)


@pytest.mark.parametrize("name", [name for name in _COMMANDS if name not in _SLOW])
def test_old_or_new_wherever_it_is_stopped(
    name: str, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = _killed(name, request, tmp_path, monkeypatch)
    if name not in _LIKE_FIT:
        # Spread over all of it, by thirds.
        for fault, k in zip(_FAULTS, (1, 2, 3), strict=False):
            _failing(name, 1 + k * steps // 4, fault, request, tmp_path, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("fault", _FAULTS if _IN_EVERY_WAY else ["in turn"])
@pytest.mark.parametrize("name", _COMMANDS)
def test_old_or_new_whichever_step_fails(
    name: str,
    fault: str,
    request: pytest.FixtureRequest,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    every = 5 if name in _SLOW and not _IN_EVERY_WAY else 1
    for step in range(1, 1 + _killed(name, request, tmp_path, monkeypatch), every):
        step_fault = fault if fault in _FAULTS else _FAULTS[step % len(_FAULTS)]
        _failing(name, step, step_fault, request, tmp_path, monkeypatch)


def _killed(
    name: str, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> int:
    """Check what a kill leaves before each step of a command, and count its steps."""
    words = list(_COMMANDS[name])
    work, copies = tmp_path / "work", tmp_path / "copies"
    _copied(name, request, work)
    if name == "an object before a rig":
        monkeypatch.setattr(calibrate, "view_object", _viewed)
    monkeypatch.chdir(work)
    before = _visible(work)
    # An estimate that is not ok is a result, too.
    assert all_states(lambda: main(words) not in (0, 3), work, copies)
    after = _visible(work)
    assert after.keys() > before.keys()
    assert _hidden(work) == []
    # What is opened to be written is hidden until it is whole: a kill between two steps is one too.
    opened = (copies / "opened.txt").read_text().splitlines()
    assert [name_opened for name_opened in opened if not _is_hidden(name_opened)] == []
    states = sorted(path for path in copies.iterdir() if path.is_dir())
    assert len(states) > 4
    assert all(_visible(state) in (before, after) for state in states)
    _check_again(words, states[len(states) // 2], set(after), monkeypatch)
    return len(states)


def _failing(
    name: str,
    step: int,
    fault: str,
    request: pytest.FixtureRequest,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Check what a command leaves one step of which fails, or meets a signal."""
    words, folder = list(_COMMANDS[name]), tmp_path / f"{step} {fault}"
    _copied(name, request, folder)
    monkeypatch.chdir(folder)
    before = _visible(folder)
    new = set(_visible(tmp_path / "work"))
    outcome = in_child(lambda: main(words) not in (0, 3), folder, step=step, fault=fault)
    assert outcome in ("refused", "done all the same")
    # A signal that comes while all takes its place waits until it has.
    may_be_done = outcome == "done all the same" or fault == "SIGTERM"
    seen = _visible(folder)
    assert seen == before or (may_be_done and set(seen) == new)
    if left := _hidden(folder):
        # Finished instants, from which the next run goes on; and what could not be removed, as that
        # was the step that failed.
        assert len(set(left) - {".made.parts"}) <= (fault != "SIGTERM")
        # What is there is replaced, or refused: then its lock waits for whoever does replace it.
        if main(words) not in (0, 3):
            assert seen != before
            assert [name.endswith(".lock") for name in left] == [True]
            left = []
        else:
            left = _hidden(folder)
    assert left == []
    # The next one is made from a folder that is there.
    monkeypatch.chdir(tmp_path)
    shutil.rmtree(folder)


def _viewed(rig: Rig, mesh: TriangleMesh, *_: object, **__: object) -> ObjectView:
    """What pictures of an object would tell, in the place of pictures that show one."""
    points = mesh.vertices
    registration = register(points, None, mesh)
    grey = tuple(np.zeros(camera.size[::-1]) for camera in rig.cameras)
    return ObjectView(rig, registration, registration.covariance, len(points), None, grey, ())


def _check_again(
    words: list[str], state: Path, names: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a kill left is tidied by the next run of the same command."""
    if any(_is_hidden(path.name) for path in state.iterdir()):
        monkeypatch.chdir(state)
        assert main(words) in (0, 3)
        assert set(_visible(state)) == names
        assert _hidden(state) == []

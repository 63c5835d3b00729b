"""Every command in every surrounding: as another user, without a home, with closed streams.

A command does what it does elsewhere, or ends with one message and exit code 2. Each runs in a fork
that has taken on the surrounding; `make test` tries the quick ones, `make slow` all.
"""

import ctypes
import os
import shutil
import signal
import struct
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

import cv2
import numpy as np
import pytest
from faults.bench import write_scan, write_shots
from faults.samples import POKES

from palpate.app import commands
from palpate.app.cli import main

# A user whom no password file knows, as `docker run -u` has it.
_USER = 54_321
# prctl.h, capability.h: keep capabilities when the user changes; the one to read what it may not.
_PR_SET_KEEPCAPS, _READ_SEARCH = 8, 1 << 2
_QUICK = {
    "check": ("check", "cube"),
    "init": ("init", "new", "--mesh", "mesh.ply"),
    "a board": ("calibrate", "board", "board.png", "--columns", "3", "--rows", "3"),
    "a campaign's table": ("campaign", "table", "many", "--out", "table.csv"),
}
_ALL = _QUICK | {
    "version": ("--version",),
    "benches": ("lab", "--list"),
    "completion": ("completion", "bash"),
    "a campaign's status": ("campaign", "status", "many"),
    "no such experiment": ("reproduce", "table9"),
    "a live bench": ("measure", "live", "--out", "measured", "--dry-run"),
    "a live bench with nobody there": ("measure", "live", "--out", "measured"),
    "scan": ("scan", "ball", "--vertices", "60", "--out", "scanned"),
    "a recording": ("record", "recorded", "--out", "cut"),
    "a plan of the laboratory": (
        "lab", "plan", "pictured", "--young-modulus", "50kPa", "--out", "planned-there",
    ),
    "fit": ("fit", "cube", "--cache", "cache", "--out", "fitted"),
    "mesh": ("mesh", "mesh.ply", "--vertices", "60", "--out", "remeshed"),
    "calibrate": (
        "calibrate", "shots", "--target", "chessboard", "--columns", "7", "--rows", "5", "--square",
        "16mm", "--out", "calibrated",
    ),
    "poke": (
        "poke", "cube", "--force", "0", "0", "-1", "--at", "0.02", "0.02", "0.04",
        "--young-modulus", "50kPa", "--poisson-ratio", "0.4", "--cache", "cache",
    ),
    "a plan": ("plan", "cube", "--count", "1", "--cache", "cache", "--out", "planned"),
    "a screenshot": ("view", "result", "--screenshot", "view.png"),
    "export": ("export", "result", "--to", "obj", "--cache", "cache", "--out", "exported"),
    "report": ("report", "result", "--out", "report.html"),
    "a campaign's picture": ("campaign", "plot", "many", "--out", "plot.png"),
    "pictures that are not there": ("flow", "pictured", "--out", "flowed"),
    "pokes": (
        "import", "pokes", "pokes.csv", "--tool-radius", "8mm", "--thickness", "20mm", "--out",
        "poked",
    ),
    "a compression": (
        "compression", "record.csv", "--diameter", "50mm", "--height", "30mm", "--out", "made.json",
    ),
}  # fmt: skip


def _set(**variables: str | None) -> Callable[[Path], None]:
    def take_on(_: Path) -> None:
        for name, value in variables.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value
        tempfile.tempdir = None

    return take_on


def _closed(handle: int, name: str) -> Callable[[Path], None]:
    def take_on(_: Path) -> None:
        os.close(handle)
        setattr(sys, name, None)

    return take_on


def _ascii(_: Path) -> None:
    _set(LANG="C", LC_ALL="C", PYTHONUTF8="0")(_)
    sys.stdout.reconfigure(encoding="ascii")
    sys.stderr.reconfigure(encoding="ascii")


def _nohup(_: Path) -> None:
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


_SURROUNDINGS: dict[str, Callable[[Path], object]] = {
    "an installation of another user": lambda _: None,
    "a folder that may not be written": lambda _: None,
    "a home that may not be written": _set(HOME="/usr", XDG_CACHE_HOME=None),
    "no home": _set(HOME=None, XDG_CACHE_HOME=None),
    "LANG=C": _ascii,
    "standard input closed": _closed(0, "stdin"),
    "standard output closed": _closed(1, "stdout"),
    "umask 077": lambda _: os.umask(0o077),
    "a user's cache that may not be written": _set(XDG_CACHE_HOME="/usr/cache"),
    "TMPDIR is not there": _set(TMPDIR="/not/there"),
    "TERM=dumb": _set(TERM="dumb", COLUMNS=None),
    "nohup": _nohup,
    "a cache of another user": lambda _: None,
}
_READ_ONLY, _OTHERS_CACHE = "a folder that may not be written", "a cache of another user"


_LIVE = """\
format = "palpate-bench/1"
object = { mesh = "../mesh.ply", length_unit = "m" }
support = { plane = { point = [0, 0, 0], normal = [0, 0, 1], tolerance = 1e-6 } }
rig = { cameras = "../rig.toml" }
force = { driver = "typed", unit = "gf" }
contact = { tool = "sphere", tool_radius = "3 mm" }
[[camera]]
name = "c0"
driver = "opencv"
source = "0.avi"
[[camera]]
name = "c1"
driver = "opencv"
source = "1.avi"
"""


def _write_live(folder: Path) -> None:
    """A bench whose cameras are films, and whose scale a person reads."""
    folder.mkdir()
    (folder / "bench.toml").write_text(_LIVE)
    rng = np.random.default_rng(3)
    for k in range(2):
        film = cv2.VideoWriter(
            str(folder / f"{k}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 15.0, (64, 48)
        )
        for _ in range(60):
            film.write(rng.integers(20, 230, (48, 64, 3), dtype=np.uint8))
        film.release()


@pytest.fixture(scope="module")
def bench_and_more(bench: Path, recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bench with all that the commands need to end well."""
    for module in walk_packages(commands.__path__, f"{commands.__name__}."):
        import_module(module.name)
    folder = tmp_path_factory.mktemp("surroundings") / "work"
    shutil.copytree(bench, folder)
    (folder / "new").mkdir()
    (folder / "pokes.csv").write_text(POKES)
    strain = np.linspace(0.0, 0.1, 40)
    rows = np.stack([30.0 * strain, 1e5 * strain * np.pi * 0.025**2], axis=1)
    np.savetxt(folder / "record.csv", rows, delimiter=",", header="displacement,force", comments="")
    write_shots(folder / "shots")
    write_scan(folder / "ball")
    shutil.copytree(recorded, folder / "recorded")
    _write_live(folder / "live")
    return folder


@pytest.fixture
def work(bench_and_more: Path) -> Iterator[Path]:
    """A copy where every user may search."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        shutil.copytree(bench_and_more, Path(folder) / "work")
        yield Path(folder) / "work"


def _given_to_user(work: Path, surrounding: str) -> None:
    """The folder belongs to the user, or may be read only; the cache is somebody else's."""
    (work / "cache").mkdir()
    for path in (work, *work.rglob("*")):
        if surrounding == _READ_ONLY:
            path.chmod(0o555 if path.is_dir() else 0o444)
        else:
            os.chown(path, _USER, _USER)
    if surrounding == _OTHERS_CACHE:
        os.chown(work / "cache", 0, 0)
        (work / "cache").chmod(0o777)


def _as_user() -> None:
    """Become a user without rights, but to read what root alone may: Python may be there."""
    library = ctypes.CDLL(None)
    assert library.prctl(_PR_SET_KEEPCAPS, 1, 0, 0, 0) == 0
    os.setgroups([])
    os.setgid(_USER)
    os.setuid(_USER)
    # Version 3 of the header, this process; effective, permitted and inheritable, twice.
    header = struct.pack("Ii", 0x20080522, 0)
    capabilities = struct.pack("6I", _READ_SEARCH, _READ_SEARCH, 0, 0, 0, 0)
    assert library.capset(header, capabilities) == 0


def _outcome(words: tuple[str, ...], work: Path, surrounding: str | None) -> tuple[int, str]:
    """Exit code of a command, and what it said on standard error; None: here and now."""
    said = work.parent / "said.txt"
    child = os.fork()
    if child:
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        return code, said.read_text(errors="replace")
    code = 71
    try:
        os.chdir(work)
        for handle, name in ((1, os.devnull), (2, str(said))):
            target = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(target, handle)
            os.close(target)
        sys.stdin, sys.stdout, sys.stderr = (
            os.fdopen(k, "rw"[k > 0], closefd=False) for k in (0, 1, 2)
        )
        if surrounding is not None:
            _as_user()
            _SURROUNDINGS[surrounding](work)
        code = main(list(words))
        sys.stderr.flush()
    except BaseException as error:  # noqa: BLE001 - said in the parent
        os.write(2, f"Traceback: {error!r}".encode())
    finally:
        os._exit(code)


@pytest.fixture(scope="module")
def usual(bench_and_more: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], int]:
    """The exit code of a command where nothing is in the way."""
    work = tmp_path_factory.mktemp("usual") / "work"
    shutil.copytree(bench_and_more, work)
    return cache(lambda name: _outcome(_ALL[name], work, None)[0])


def _wrong(name: str, words: tuple[str, ...], work: Path, surrounding: str, code: int) -> str:
    """What is wrong with a command in a surrounding; empty where nothing is."""
    actual, said = _outcome(words, work, surrounding)
    allowed = {code, 2} if surrounding == _READ_ONLY else {code}
    clear = actual != 2 or 20 < len(said.strip()) < 1500
    if actual in allowed and clear and "Traceback" not in said:
        return ""
    return f"{name}: {actual} for {code}: {said}"


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="root alone may change the user"
)
@pytest.mark.parametrize("surrounding", _SURROUNDINGS)
@pytest.mark.parametrize("which", ["quick", pytest.param("all", marks=pytest.mark.slow)])
def test_done_or_said(
    work: Path, surrounding: str, which: str, usual: Callable[[str], int]
) -> None:
    _given_to_user(work, surrounding)
    tried = _QUICK if which == "quick" else _ALL
    wrong = [_wrong(name, words, work, surrounding, usual(name)) for name, words in tried.items()]
    assert not any(wrong), "\n".join(filter(None, wrong))

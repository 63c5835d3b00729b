"""Wall times of whole processes: the first after the install, later ones, and the help."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.figure import ESTIMATION, Figure
from benchmarks.machine import ROOT, SHARED
from benchmarks.options import Options

START = "import sys; from palpate.app.cli import main; sys.exit(main())"
IMPORTS = "import palpate.api, palpate.report, matplotlib.figure"
NOT_OK = 3  # the beam's Poisson's ratio is not identifiable


def measure(options: Options) -> list[Figure]:
    """`palpate fit` of the beam and of pictures, caches empty and filled; `palpate compile` and
    `--help`."""
    repeats = 2 if options.quick else 3
    beam = str(ROOT / "examples" / "beam")
    seen = str(SHARED / "halfball_images")
    with tempfile.TemporaryDirectory() as name:
        bare, ready = Path(name) / "bare", Path(name) / "ready"
        first, *later = _fits(beam, bare, 1 + repeats)
        compiling = seconds(["compile"], ready)
        after, *_ = _fits(beam, ready, 1)
        first_seen, *later_seen = _fits(seen, ready, repeats)
        imported = min(_run([sys.executable, "-c", IMPORTS], bare) for _ in range(repeats))
        help_times = [seconds(["--help"], bare) for _ in range(repeats + 2)]
    return [
        Figure(
            ESTIMATION,
            "`palpate fit` of the shipped beam, first process, compilation included",
            first,
            "s",
            note="without `palpate compile`: empty numba cache and empty matplotlib cache, plots"
            " written; files of the packages are warm in memory",
        ),
        Figure(
            ESTIMATION,
            "`palpate fit` of the shipped beam, later processes",
            min(later),
            "s",
            note=f"shortest of {len(later)}, plots written; floor: to start the interpreter and to"
            f" import what a fit uses takes {imported:.1f} s",
        ),
        Figure(
            ESTIMATION,
            "first `palpate fit` after the install: compilation, beam",
            after - min(later),
            "s",
            note=f"first process after `palpate compile` (which took {compiling:.1f} s) less the"
            f" shortest later one; without it {first - min(later):.1f} s",
        ),
        Figure(
            ESTIMATION,
            "first `palpate fit` after the install: compilation, half ball from pictures",
            first_seen - min(later_seen),
            "s",
            note=f"likewise; the first process took {first_seen:.1f} s",
        ),
        Figure(
            ESTIMATION,
            "`palpate --help`",
            min(help_times),
            "s",
            note=f"shortest of {len(help_times)}",
        ),
    ]


def _fits(session: str, caches: Path, count: int) -> list[float]:
    """Wall times of so many processes that fit a session, one after the other."""
    folder = _made(caches)
    outs = [str(folder / f"{Path(session).name} {k}") for k in range(count)]
    return [seconds(["fit", session, "--out", out], folder) for out in outs]


def _made(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    return folder


def seconds(arguments: list[str], cache: Path, folder: Path | None = None) -> float:
    """Wall time of one process of the command, its caches in a folder, run there or elsewhere."""
    script = Path(sys.executable).with_name("palpate")
    command = [str(script)] if script.exists() else [sys.executable, "-c", START]
    return _run([*command, *arguments], _made(cache), folder)


def _run(command: list[str], cache: Path, folder: Path | None = None) -> float:
    """Wall time of one process, its caches in a folder."""
    caches = {"NUMBA_CACHE_DIR": f"{cache}/numba", "MPLCONFIGDIR": f"{cache}/matplotlib"}
    # Python keeps what it has compiled of the modules, unless it is told not to.
    environment = {
        name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"
    }
    start = time.perf_counter()
    done = subprocess.run(
        command,
        env=environment | caches,
        cwd=folder or cache,
        capture_output=True,
        text=True,
        check=False,
    )
    elapsed = time.perf_counter() - start
    if done.returncode not in (0, NOT_OK):
        raise RuntimeError(f"{' '.join(command)} failed: {done.stderr.strip()}")
    return elapsed

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
NOT_OK = 3  # the beam's Poisson's ratio is not identifiable


def measure(options: Options) -> list[Figure]:
    """`palpate fit` of the beam and of pictures, caches empty and filled; `palpate --help`."""
    repeats = 2 if options.quick else 3
    beam = str(ROOT / "examples" / "beam")
    with tempfile.TemporaryDirectory() as folder:
        out = str(Path(folder) / "result")
        first = _seconds(["fit", beam, "--out", out], folder)
        later = [_seconds(["fit", beam, "--out", f"{out}-{k}"], folder) for k in range(repeats)]
        seen = str(SHARED / "halfball_images")
        caches = Path(folder) / "caches"
        caches.mkdir()
        with_pictures = [
            _seconds(["fit", seen, "--out", f"{out}-seen-{k}"], str(caches)) for k in range(repeats)
        ]
        help_times = [_seconds(["--help"], folder) for _ in range(repeats + 2)]
    return [
        Figure(
            ESTIMATION,
            "`palpate fit` of the shipped beam, first process, compilation included",
            first,
            "s",
            must=8.0,
            reach=2.0,
            note="empty numba cache and empty matplotlib cache, plots written; files of the"
            " packages are warm in memory",
        ),
        Figure(
            ESTIMATION,
            "`palpate fit` of the shipped beam, later processes",
            min(later),
            "s",
            must=2.0,
            reach=1.0,
            note=f"shortest of {len(later)}, plots written",
        ),
        Figure(
            ESTIMATION,
            "`palpate fit`: compilation, beam",
            first - min(later),
            "s",
            must=8.0,
            reach=0.0,
            note="first process less the shortest later one; the list of fonts is made in it, too",
        ),
        Figure(
            ESTIMATION,
            "`palpate fit`: compilation, half ball from pictures",
            with_pictures[0] - min(with_pictures[1:]),
            "s",
            must=12.0,
            reach=0.0,
            note=f"first process {with_pictures[0]:.1f} s less the shortest later one",
        ),
        Figure(
            ESTIMATION,
            "`palpate --help`",
            min(help_times),
            "s",
            must=0.7,
            reach=0.3,
            note=f"shortest of {len(help_times)}",
        ),
    ]


def _seconds(arguments: list[str], cache: str) -> float:
    """Wall time of one process of the command, its caches in a folder."""
    script = Path(sys.executable).with_name("palpate")
    command = [str(script)] if script.exists() else [sys.executable, "-c", START]
    caches = {"NUMBA_CACHE_DIR": f"{cache}/numba", "MPLCONFIGDIR": f"{cache}/matplotlib"}
    start = time.perf_counter()
    done = subprocess.run(
        [*command, *arguments],
        env={**os.environ, **caches},
        cwd=cache,
        capture_output=True,
        text=True,
        check=False,
    )
    elapsed = time.perf_counter() - start
    if done.returncode not in (0, NOT_OK):
        raise RuntimeError(f"palpate {' '.join(arguments)} failed: {done.stderr.strip()}")
    return elapsed

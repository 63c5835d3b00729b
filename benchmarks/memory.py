"""Peak memory of `palpate fit`, everything included, in a process of its own."""

import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.ball_session import write_ball_session
from benchmarks.figure import BEM, Figure
from benchmarks.machine import ROOT, peak_memory
from benchmarks.options import Options
from palpate.app.cli import main as palpate

GIGABYTE = 1e9


def measure(options: Options) -> list[Figure]:
    """Largest resident memory at 2562 vertices and 17 probings."""
    level = 3 if options.quick else 4
    with tempfile.TemporaryDirectory() as folder:
        session = write_ball_session(Path(folder), level)
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.memory", str(session)],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
    return [
        Figure(
            BEM,
            f"peak memory, {10 * 4**level + 2} vertices, 17 probings",
            int(done.stdout.splitlines()[-1]) / GIGABYTE,
            "GB",
            note="largest resident memory of `palpate fit` on a ball session: interpreter, fit,"
            " likelihood map and plots included",
        )
    ]


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    palpate(["fit", str(folder), "--out", str(folder / "result")])
    print(peak_memory())

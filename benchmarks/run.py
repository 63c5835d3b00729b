"""The one command: measures every subject in a process of its own and writes BENCHMARK.md.

A full run writes BENCHMARK.md at the root of the project. With `--only` or `--quick` the figures
are printed and nothing is written: a report never mixes runs.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.figure import Figure, figure_from_plain
from benchmarks.machine import ROOT, described, use_cores
from benchmarks.report import as_markdown, as_text

__all__ = ["SUBJECTS", "main"]

SUBJECTS = (
    "cube",
    "facets",
    "convergence",
    "incompressible",
    "assembly_time",
    "memory",
    "probes",
    "repeats",
    "fit_time",
    "beam",
    "process_times",
    "flow_speckle",
    "flow_rendered",
    "flow_time",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, report; 0, or 1 where a subject could not be measured."""
    options = _options(arguments)
    use_cores()
    machine = described()
    figures: list[Figure] = []
    failures: dict[str, str] = {}
    for name in options.only or SUBJECTS:
        start = time.perf_counter()
        print(f"{name} ...", end=" ", flush=True)
        found = _measured(name, quick=options.quick, peers=options.peers)
        print(f"{time.perf_counter() - start:.0f} s", flush=True)
        if isinstance(found, str):
            failures[name] = found
            print(f"{name} failed: {found}", file=sys.stderr)
            continue
        print(as_text(found), flush=True)
        figures += found
    out = options.out or (None if options.only or options.quick else ROOT / "BENCHMARK.md")
    if out is not None:
        out.write_text(as_markdown(figures, machine, failures), encoding="utf-8")
        print(f"written to {out}")
    return 1 if failures else 0


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.run", description=__doc__)
    names = ", ".join(SUBJECTS)
    parser.add_argument("--only", nargs="+", choices=SUBJECTS, metavar="NAME", help=names)
    parser.add_argument("--quick", action="store_true", help="small meshes, few repeats")
    parser.add_argument("--peers", action="store_true", help="make bempp-cl's environment")
    parser.add_argument("--out", type=Path, help="write the report here, whatever was measured")
    return parser.parse_args(arguments)


def _measured(name: str, *, quick: bool, peers: bool) -> list[Figure] | str:
    """Figures of one subject, or the reason why there are none."""
    command = [sys.executable, "-m", "benchmarks.measure", name]
    command += ["--quick"] * quick + ["--peers"] * peers
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        return f"stopped with exit code {done.returncode}; its message is on the screen"
    return [figure_from_plain(one) for one in json.loads(done.stdout.splitlines()[-1])]


if __name__ == "__main__":
    sys.exit(main())

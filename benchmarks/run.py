"""The one command: measures every subject in a process of its own and writes what it finds.

A full run writes figures.csv, and from it BENCHMARK.md at the root of the project and its plots;
`--part` does so for one part of the figures. With `--only` or `--quick` the figures are printed and
nothing is written: a part never mixes runs.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence

from benchmarks.figure import NOT_MEASURED, Figure
from benchmarks.machine import ROOT, described, use_cores
from benchmarks.plots import draw_plots
from benchmarks.report import as_text, write_page, write_part

FIGURES = ROOT / "benchmarks" / "figures.csv"
# Each part of the figures is measured as a whole and says when, where and on which commit.
PARTS = {
    "model": (
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
    ),
    "pictures": (
        "flow_time",
        "flow_video",
        "flow_speckle",
        "flow_peers",
        "flow_rendered",
        "flow_baseline",
        "flow_real",
    ),
    "facility": ("facility_time", "table3_repeats"),
    "plans": ("plan_holds",),
    "simulation": ("realtime", "replay"),
    "campaign": ("campaign",),
    "door": ("calibration", "known_object", "scanning", "scanned_constants", "recording"),
    "hour": ("first_hour",),
    "live": ("live",),
}
SUBJECTS = tuple(name for names in PARTS.values() for name in names)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, report; 0, or 1 where a subject could not be measured."""
    options = _options(arguments)
    use_cores()
    machine = described()
    chosen = {part: PARTS[part] for part in options.part or PARTS}
    if options.only:
        chosen = {"": options.only}
    failed = False
    for part, subjects in chosen.items():
        figures = _all_measured(subjects, quick=options.quick, peers=options.peers)
        failed |= any(figure.section == NOT_MEASURED for figure in figures)
        if part and not options.quick:
            write_part(FIGURES, part, figures, machine)
            draw_plots(FIGURES, FIGURES.parent / "plots")
            write_page(FIGURES, ROOT / "BENCHMARK.md")
            print(f"part '{part}' written to {FIGURES} and {ROOT / 'BENCHMARK.md'}")
    return 1 if failed else 0


def _all_measured(subjects: Sequence[str], *, quick: bool, peers: bool) -> list[Figure]:
    """Figures of some subjects; one that says why for each subject that stopped."""
    figures: list[Figure] = []
    for name in subjects:
        start = time.perf_counter()
        print(f"{name} ...", end=" ", flush=True)
        outcome = _measured(name, quick=quick, peers=peers)
        print(f"{time.perf_counter() - start:.0f} s", flush=True)
        if isinstance(outcome, str):
            figures.append(Figure(NOT_MEASURED, name, None, note=outcome))
            print(f"{name} failed: {outcome}", file=sys.stderr)
            continue
        print(as_text(outcome), flush=True)
        figures += outcome
    return figures


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.run", description=__doc__)
    names = ", ".join(SUBJECTS)
    parser.add_argument("--only", nargs="+", choices=SUBJECTS, metavar="NAME", help=names)
    parser.add_argument("--quick", action="store_true", help="small meshes, few repeats")
    parser.add_argument("--peers", action="store_true", help="make bempp-cl's environment")
    parser.add_argument("--part", nargs="+", choices=PARTS, help="measure these parts only")
    return parser.parse_args(arguments)


def _measured(name: str, *, quick: bool, peers: bool) -> list[Figure] | str:
    """Figures of one subject, or the reason why there are none."""
    command = [sys.executable, "-m", "benchmarks.measure", name]
    command += ["--quick"] * quick + ["--peers"] * peers
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        return f"stopped with exit code {done.returncode}; its message is on the screen"
    return [Figure(**values) for values in json.loads(done.stdout.splitlines()[-1])]


if __name__ == "__main__":
    sys.exit(main())

"""The one command: measures every subject in a process of its own and writes BENCHMARK.md.

A full run writes BENCHMARK.md at the root of the project; `--part` writes one part of it anew. With
`--only` or `--quick` the figures are printed and nothing is written: a part never mixes runs.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence

from benchmarks.figure import Figure, figure_from_plain
from benchmarks.machine import ROOT, described, use_cores
from benchmarks.report import as_markdown, as_text, write_part

# Each part of the report is measured as a whole and says when, where and on which commit.
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
        figures, failures = _all_measured(subjects, quick=options.quick, peers=options.peers)
        failed |= bool(failures)
        if part and not options.quick:
            write_part(ROOT / "BENCHMARK.md", part, as_markdown(figures, machine, failures))
            print(f"part '{part}' written to {ROOT / 'BENCHMARK.md'}")
    return 1 if failed else 0


def _all_measured(
    subjects: Sequence[str], *, quick: bool, peers: bool
) -> tuple[list[Figure], dict[str, str]]:
    """Figures of some subjects, and the subjects that stopped, with their messages."""
    figures: list[Figure] = []
    failures: dict[str, str] = {}
    for name in subjects:
        start = time.perf_counter()
        print(f"{name} ...", end=" ", flush=True)
        found = _measured(name, quick=quick, peers=peers)
        print(f"{time.perf_counter() - start:.0f} s", flush=True)
        if isinstance(found, str):
            failures[name] = found
            print(f"{name} failed: {found}", file=sys.stderr)
            continue
        print(as_text(found), flush=True)
        figures += found
    return figures, failures


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
    return [figure_from_plain(values) for values in json.loads(done.stdout.splitlines()[-1])]


if __name__ == "__main__":
    sys.exit(main())

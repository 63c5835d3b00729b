"""Where and with what the figures were measured."""

import os
import platform
import subprocess
from datetime import date
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Pictures and films that are made once.
MADE = ROOT / "build" / "benchmarks"
SHARED = ROOT.parent / "shared" / "data"
CORES = 2


def use_cores(count: int = CORES) -> int:
    """Keep this process and its children to some cores; returns how many it got.

    Must come before numba and OpenBLAS are imported: they count the cores at that moment.
    """
    if not hasattr(os, "sched_setaffinity"):
        return os.cpu_count() or 1
    chosen = sorted(os.sched_getaffinity(0))[:count]
    os.sched_setaffinity(0, chosen)
    return len(chosen)


def described() -> dict[str, str]:
    """Date, commit and processor, by the name of their column in figures.csv."""
    return {
        "date": date.today().isoformat(),
        "commit": _commit(),
        "processor": f"{_processor()}, {os.cpu_count()} cores seen, {CORES} used at most",
    }


def peak_memory() -> int:
    """Largest resident memory of this process so far [bytes].

    From /proc, not from getrusage: a child that was started by vfork inherits the parent's peak
    there.
    """
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return 1024 * int(line.split()[1])
    raise OSError("/proc/self/status has no VmHWM; peak memory is measured on Linux only")


def _processor() -> str:
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or "unknown processor"


def _commit() -> str:
    head = _git("rev-parse", "--short", "HEAD")
    if head is None:
        return "unknown"
    # What a run before this one wrote is no change of the program.
    written = (":!benchmarks/figures.csv", ":!benchmarks/plots")
    changed = _git("status", "--porcelain", "--", "src", "benchmarks", *written)
    return f"{head} with uncommitted changes" if changed else head


def _git(*arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()

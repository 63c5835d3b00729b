"""A probing that the estimate has not seen, repeated in simulators: those that are installed."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks import genesis_replay, newton_replay
from benchmarks.figure import SIMULATION, Figure
from benchmarks.held_out_push import deviation, read_push
from benchmarks.machine import ROOT
from benchmarks.options import Options
from palpate.pipeline import fit_session
from palpate.records import read_session
from palpate.simulation import FitSource, export_fit

_USED = ("p2", "p3", "p4", "p5", "p6")


def measure(_: Options) -> list[Figure]:
    """Displacement of the contact point of probing p1 of the half ball, off from Palpate's."""
    place = ROOT / "examples" / "half_ball"
    estimate = fit_session(read_session(place, probes=_USED)).estimate
    source = FitSource(read_session(place), estimate, ())
    figures = []
    for name, (form, run) in _SIMULATORS.items():
        with tempfile.TemporaryDirectory() as folder:
            export_fit(Path(folder), source, form)
            reached, note = run(Path(folder))
        figures.append(
            Figure(
                SIMULATION,
                f"push that was left out of the fit, repeated in {name}: off by",
                reached,
                "%",
                note=note,
            )
        )
    return figures


def _in_calculix(folder: Path) -> tuple[float | None, str]:
    if shutil.which("ccx") is None:
        return None, "ccx is not installed"
    subprocess.run(["ccx", "model"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    rows = [line.split() for line in (folder / "model.dat").read_text().splitlines()]
    moved = {int(row[0]) - 1: np.array(row[1:], dtype=float) for row in rows if len(row) == 4}
    push = read_push(folder)
    off = deviation(push, np.stack([moved[node] for node in push["point_nodes"]]))
    return off, "ten-node tetrahedra, linear equilibrium, the whole force"


def _in_mujoco(folder: Path) -> tuple[float | None, str]:
    done = subprocess.run(
        [sys.executable, "replay.py"], cwd=folder, check=False, capture_output=True, text=True
    )
    if done.returncode:
        return None, done.stderr.strip().splitlines()[-1]
    return 100 * float(done.stdout.split()[-1]), "a flex of linear tetrahedra, 2 % of the force"


# What each reads, and what runs it. Genesis fills the surface itself.
_SIMULATORS = {
    "calculix": ("calculix", _in_calculix),
    "mujoco": ("mujoco", _in_mujoco),
    "newton": ("openusd", newton_replay.replay),
    "genesis": ("genesis", genesis_replay.replay),
}

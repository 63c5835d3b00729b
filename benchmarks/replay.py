"""A probing that the estimate has not seen, repeated in simulators: those that are installed."""

import json
import shutil
import subprocess
import sys
import tempfile
import time
from importlib import import_module
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
    example = ROOT / "examples" / "half_ball"
    estimate = fit_session(read_session(example, probes=_USED)).estimate
    source = FitSource(read_session(example), estimate, ())
    figures = [_every_push(source)]
    for name, (form, nodes, run) in _SIMULATORS.items():
        with tempfile.TemporaryDirectory() as folder:
            export_fit(Path(folder), source, form, nodes=nodes)
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


def _every_push(source: FitSource) -> Figure:
    """The farthest off of all pushes, most of them between vertices."""
    reached, note = [], ""
    for probing in source.session.probings:
        with tempfile.TemporaryDirectory() as folder:
            export_fit(Path(folder), source, "calculix", probe=probing.name)
            off, note = _in_calculix(Path(folder))
        if off is not None:
            reached.append(off)
    return Figure(
        SIMULATION, "every push of the half ball, repeated in calculix: farthest off",
        max(reached) if reached else None, "%", note=note,
    )  # fmt: skip


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


def _in_real_time(folder: Path) -> tuple[float | None, str]:
    """The same of few nodes, with the pace of a ball that presses in by 2 mm in half a second."""
    off, note = _in_mujoco(folder)
    if off is None:
        return off, note
    mujoco = import_module("mujoco")
    model = mujoco.MjModel.from_xml_path(str(folder / "model.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    push = json.loads((folder / "palpate.json").read_text())["push"]
    outward = data.mocap_pos[0] - push["point"]
    outward /= np.linalg.norm(outward)
    begin = time.perf_counter()
    for depth in np.linspace(0.0, 2e-3, 50):
        data.mocap_pos[0] = push["point"] + (model.geom_size[0][0] - depth) * outward
        mujoco.mj_step(model, data)
    pace = data.time / (time.perf_counter() - begin)
    return off, f"{note}; under a ball {pace:.1f} times real time"


# What each reads, of how many nodes, and what runs it. Genesis fills the surface itself.
_SIMULATORS = {
    "calculix": ("calculix", None, _in_calculix),
    "mujoco": ("mujoco", None, _in_mujoco),
    "mujoco, 500 nodes": ("mujoco", 500, _in_real_time),
    "newton": ("openusd", None, newton_replay.replay),
    "genesis": ("genesis", None, genesis_replay.replay),
}

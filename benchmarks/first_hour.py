"""From what was recorded to constants, as a page tells it: every command a process, nothing
compiled before the first.

A robot's way is the tutorial "From nothing to constants": boards, a turntable, films of presses and
the log of a gauge. Image correlation's way begins with tables of VIC-3D in a frame of their own,
the mesh and a `session.toml`. What a person types and reads between commands is not in the time.
"""

import shutil
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.figure import DOOR, Figure
from benchmarks.machine import MADE, ROOT
from benchmarks.options import Options
from benchmarks.process_times import seconds
from palpate.records import read_estimate, write_text

# From the frame of the tables to that of the object.
_POSE = 'length_unit = "mm"\nR = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]\nt = [10, -5, 400]\n'
_ROBOT = (
    "calibrate boards --columns 7 --rows 5 --square 16mm --marker 12mm --table 00 --out rig",
    "scan turntable --vertices 1000 --out mesh",
    "init presses --mesh mesh/mesh.ply --rig rig --tool-radius 0.012",
    "record presses --out session",
    "check session",
    "fit session --out result",
)
_TABLES = (
    "import vic3d p1.csv p2.csv p3.csv p4.csv p5.csv p6.csv ball --to-object pose.toml",
    "check ball",
    "fit ball --out result",
)


def measure(_: Options) -> list[Figure]:
    """Minutes of both ways, and what they end with."""
    recorded = MADE / "tutorial"
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        if not recorded.exists():
            seconds(["lab", "tutorial", str(recorded)], root / "made")
        shutil.copytree(recorded, root / "robot", ignore=shutil.ignore_patterns("truth"))
        _write_tables(root / "tables")
        return [
            _way("a robot's films and force log", _ROBOT, root / "robot", "52 kPa and 0.21"),
            _way("tables of image correlation", _TABLES, root / "tables", "60 kPa and 0.3"),
        ]


def _way(what: str, commands: tuple[str, ...], folder: Path, truth: str) -> Figure:
    """Minutes of all commands of a way, with an empty cache of kernels."""
    cache = folder.parent / f"{folder.name} cache"
    took = [seconds(command.split(), cache, folder) for command in commands]
    estimate = read_estimate(folder / "result" / "estimate.json")
    young, ratio = estimate.young_modulus, estimate.poisson_ratio
    stiff, within = 1e-3 * np.array([young.value, *young.ci95]), ratio.ci95
    times = ", ".join(
        f"{command.split()[0]} {time:.0f} s" for command, time in zip(commands, took, strict=True)
    )
    note = (
        f"{times}, kernels compiled on the way; E {stiff[0]:.4g} kPa ({stiff[1]:.4g} to"
        f" {stiff[2]:.4g}), nu {ratio.value:.4g} ({within[0]:.4g} to {within[1]:.4g}); the truth is"
        f" {truth}"
    )
    return Figure(DOOR, f"from {what} to constants, all commands", sum(took) / 60.0, "min", note)


def _write_tables(root: Path) -> None:
    """The half ball of the examples, its displacements as VIC-3D exports them."""
    ball = root / "ball"
    ball.mkdir(parents=True)
    example = ROOT / "examples" / "half_ball"
    shutil.copy(example / "mesh.ply", ball)
    lines = (example / "session.toml").read_text(encoding="utf-8").splitlines(keepends=True)
    remaining = [line for line in lines if not line.startswith("displacement")]
    write_text(ball / "session.toml", "".join(remaining))
    write_text(root / "pose.toml", _POSE)
    turn, shift = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([10.0, -5.0, 400.0])
    for number in range(1, 7):
        rows = np.genfromtxt(example / f"p{number}.csv", delimiter=",", skip_header=1)
        table = np.hstack([(rows[:, :3] - shift) @ turn, rows[:, 3:6] @ turn])
        head = ",".join(f"{name} [mm]" for name in "XYZUVW")
        np.savetxt(root / f"p{number}.csv", table, delimiter=",", header=head, comments="")

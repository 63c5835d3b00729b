"""A result folder of `palpate fit` that was never fitted, for the tests of `palpate export`."""

import json
import shutil
import subprocess

import numpy as np
import pytest
from cube_session import cube_session
from estimate_samples import sample_result

from palpate.pipeline import write_modulus
from palpate.records import (
    read_session,
    record_inputs,
    result_folder,
    session_files,
    write_estimate,
)

# A wide contact, whose tetrahedra are large: simulators take seconds.
RADIUS = 0.014
SIDE = 0.04


def written_result(root, map_of=None):
    """A result folder of a fit of the cube with a second probing that was left out; with the map of
    its modulus, if there is a function that makes one."""
    folder = cube_session.__wrapped__(root)
    text = (folder / "session.toml").read_text().replace("0.006", str(RADIUS))
    again = text[text.index("[[probe]]") :].replace("n01", "n02")
    rows = np.loadtxt(folder / "n01.csv", delimiter=",", skiprows=1)
    rows[:, 3:6] *= 0.97
    head = "x,y,z,ux,uy,uz,sigma"
    np.savetxt(folder / "n02.csv", rows, delimiter=",", header=head, comments="")
    (folder / "session.toml").write_text(text + again)
    session = read_session(folder)
    with result_folder(root / "result", kind="fit") as result:
        write_estimate(result / "estimate.json", sample_result(session).estimate)
        if map_of is not None:
            write_modulus(result / "modulus.npz", map_of(session.mesh))
        record_inputs(result, session_files(folder))
    return root / "result"


def moved_by_calculix(folder):
    """Displacement of the push's point (3,) [m] that CalculiX computes from an export."""
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not installed")
    subprocess.run(["ccx", "model"], cwd=folder, check=True, capture_output=True, timeout=100)
    # Of increments the last.
    rows = [line.split() for line in (folder / "model.dat").read_text().splitlines()]
    moved = {int(row[0]) - 1: np.array(row[1:], dtype=float) for row in rows if len(row) == 4}
    push = json.loads((folder / "replay.json").read_text())
    nodes = zip(push["point_nodes"], push["point_shares"], strict=True)
    return sum(share * moved[node] for node, share in nodes)

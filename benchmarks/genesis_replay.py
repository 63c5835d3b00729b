"""The push of an export to Genesis, repeated there."""

import os
import runpy
from importlib import import_module
from pathlib import Path

import numpy as np

from benchmarks.held_out_push import deviation, read_push

_SHARE, _STEPS = 0.02, 30


def replay(folder: Path) -> tuple[float | None, str]:
    """Displacement of the push's point in Genesis, off from Palpate's.

    Parameters
    ----------
    folder : Path                   of `palpate export --to genesis`

    Returns
    -------
    float or None [%]               None where Genesis is not installed
    str                             what was done, or what is missing
    """
    try:
        import_module("genesis")
    except ModuleNotFoundError:
        return None, "Genesis is not installed (pip install genesis-world torch)"
    before = Path.cwd()
    os.chdir(folder)
    try:
        made = runpy.run_path("scene.py")
    finally:
        os.chdir(before)
    push = read_push(folder)
    moved, count = _pushed(made["scene"], made["body"], push)
    off = deviation(push, moved)
    return off, f"{count} corotational tetrahedra of its own, {100 * _SHARE:g} % of the force"


def _pushed(scene, body, push: dict) -> tuple[np.ndarray, int]:
    """Displacement [m] of the point's nodes at rest under a share of the force, over the share; and
    the number of tetrahedra."""
    solver = scene.sim.fem_solver
    state = body.get_state()
    rest = state.pos[0].cpu().numpy().astype(np.float64)
    mass = solver.elements_v_info.mass.to_numpy()
    gained = np.zeros(rest.shape)
    loaded = push["loaded_nodes"]
    force = _SHARE * np.array(push["nodal_forces"])
    gained[loaded] = scene.sim.dt * force / mass[loaded, None]
    for _ in range(_STEPS):
        velocity = body.get_state().vel
        body.set_velocity(velocity + velocity.new_tensor(gained))
        scene.step()
    moved = body.get_state().pos[0].cpu().numpy().astype(np.float64) - rest
    return moved[push["point_nodes"]] / _SHARE, body.n_elements

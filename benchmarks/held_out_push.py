"""The push that an export is written with, and how far a simulator's answer is off from it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float


def read_push(folder: Path) -> dict[str, Any]:
    """What an export's replay.json holds.

    Parameters
    ----------
    folder : Path                   of `palpate export`
    """
    push: dict[str, Any] = json.loads((folder / "replay.json").read_text())
    return push


def deviation(push: dict[str, Any], moved: Float[np.ndarray, "k 3"]) -> float:
    """Displacement of the push's point, off from Palpate's [%].

    Parameters
    ----------
    push : dict                     `read_push`
    moved : (k, 3) float [m]        displacement of its `point_nodes` under the whole force
    """
    wanted = np.array(push["displacement"])
    displacement = np.array(push["point_shares"]) @ moved
    return 100 * float(np.linalg.norm(displacement - wanted) / np.linalg.norm(wanted))

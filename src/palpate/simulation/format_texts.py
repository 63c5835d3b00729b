"""Text and the replay file that several formats share."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped

from palpate.records import json_text, write_text
from palpate.simulation.solid_model import SolidModel


def number_text(values: Shaped[np.ndarray, "..."]) -> str:
    """Numbers separated by spaces, floating-point ones with nine digits.

    Parameters
    ----------
    values : array

    Returns
    -------
    str
    """
    flat = values.ravel()
    if np.issubdtype(flat.dtype, np.integer):
        return " ".join(map(str, flat.tolist()))
    return " ".join(f"{value:.9g}" for value in flat.tolist())


def numbered_lines(rows: Shaped[np.ndarray, "n k"], *, per_line: int = 16) -> Iterable[str]:
    """Rows, each after its number from 1, separated by commas; nodes are numbered from 1, too.

    Parameters
    ----------
    rows : (n, k) array             floating-point values; or integers, indices of nodes from 0
    per_line : int                  entries after which a line is broken

    Yields
    ------
    str
    """
    whole = np.issubdtype(rows.dtype, np.integer)
    for number, row in enumerate(rows.tolist(), start=1):
        cells = [str(number), *(str(v + 1) if whole else f"{v:.9g}" for v in row)]
        lines = [", ".join(cells[k : k + per_line]) for k in range(0, len(cells), per_line)]
        yield ",\n".join(lines)


def write_replay(folder: Path, model: SolidModel, load: Float[np.ndarray, "n 3"]) -> None:
    """Write replay.json: the push, if any, as nodal forces, with the displacement in the model.

    Parameters
    ----------
    folder : Path
    model : SolidModel
    load : (n, 3) float [N]         nodal forces

    Raises
    ------
    RecordError                     the file cannot be written
    """
    push = model.body.push
    if push is None:
        return
    loaded = np.flatnonzero(load.any(axis=1))
    content = {
        "probing": push.name,
        "force": push.force.tolist(),
        "displacement": push.displacement.tolist(),
        "loaded_nodes": loaded.tolist(),
        "nodal_forces": load[loaded].tolist(),
        "point_nodes": model.node.tolist(),
        "point_shares": model.share.tolist(),
    }
    write_text(folder / "replay.json", json_text(content))

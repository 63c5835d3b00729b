"""Measured against predicted displacements, one CSV per probing."""

from pathlib import Path

import numpy as np

from palpate.estimation import FitResult
from palpate.records import Session

_HEADER = "x,y,z,ux,uy,uz,predicted_ux,predicted_uy,predicted_uz,weight_x,weight_y,weight_z"


def write_residuals(folder: Path, session: Session, result: FitResult) -> None:
    """Write residuals/NAME.csv for every probing, in metres; NaN where nothing was measured.

    Parameters
    ----------
    folder : Path                   result folder
    session : Session
    result : FitResult              of that session; its probings in the same order

    Raises
    ------
    OSError                         a file cannot be written
    """
    below = folder / "residuals"
    below.mkdir()
    by_name = {probing.name: probing for probing in session.probings}
    for number, fit in enumerate(result.probes, start=1):
        field = by_name[fit.name].displacement
        if field is None:
            continue
        rows = np.concatenate([field.points, field.displacement, fit.predicted, fit.weight], axis=1)
        name = _file_name(fit.name, number)
        np.savetxt(below / name, rows, fmt="%.9g", delimiter=",", header=_HEADER, comments="")


def _file_name(name: str, number: int) -> str:
    """A probing's name as a file name; its number stands in where that is impossible."""
    plain = name.replace("_", "").replace("-", "").replace(".", "")
    return f"{name}.csv" if plain.isalnum() and name[0] != "." else f"probing-{number}.csv"

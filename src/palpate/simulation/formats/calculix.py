"""CalculiX and Abaqus: an input deck of ten-node tetrahedra with the push as its load."""

from pathlib import Path

import numpy as np

from palpate.records import write_text
from palpate.simulation.format_texts import numbered_lines, write_replay
from palpate.simulation.solid_model import Format, SolidModel

_POISSON = (-0.999, 0.499)
_RUN = (
    "ccx model (Abaqus: abaqus job=model): equilibrium under the push; model.dat has the"
    " displacement of the nodes around its point, replay.json their shares."
)


def write_calculix(folder: Path, model: SolidModel) -> None:
    """Write model.inp and replay.json.

    Parameters
    ----------
    folder : Path
    model : SolidModel

    Raises
    ------
    RecordError                     a file cannot be written
    """
    material = model.body.material
    lines = [
        "** SI units; made by Palpate, see README.txt",
        "*NODE, NSET=ALL",
        *numbered_lines(model.nodes),
        "*ELEMENT, TYPE=C3D10, ELSET=BODY",
        *numbered_lines(model.solid.elements),
        "*NSET, NSET=HELD",
        *(f"{node + 1}," for node in np.flatnonzero(model.held)),
        "*MATERIAL, NAME=ESTIMATED",
        "*ELASTIC",
        f"{material.young_modulus:.9g}, {material.poisson_ratio:.9g}",
        "*DENSITY",
        f"{model.body.density:.9g}",
        "*SOLID SECTION, ELSET=BODY, MATERIAL=ESTIMATED",
        "*BOUNDARY",
        "HELD, 1, 3, 0.",
    ]
    if model.body.push is not None:
        lines += [
            "*NSET, NSET=POINT",
            *(f"{node + 1}," for node in model.node),
            "*STEP",
            "*STATIC",
            "*CLOAD",
            *(
                f"{node + 1}, {axis + 1}, {model.load[node, axis]:.9g}"
                for node, axis in np.argwhere(model.load != 0.0)
            ),
            "*NODE FILE",
            "U",
            "*NODE PRINT, NSET=POINT",
            "U",
            "*END STEP",
        ]
    write_replay(folder, model, model.load)
    write_text(folder / "model.inp", "\n".join(lines) + "\n")


CALCULIX = Format("CalculiX", _POISSON, _RUN, of_solid=write_calculix)

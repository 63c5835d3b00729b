"""VTU, for ParaView and meshio: ten-node tetrahedra, held nodes, the push's nodal forces.

Source
------
VTK file formats, "XML File Formats", https://docs.vtk.org; a quadratic tetrahedron is cell type 24.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from palpate.records import write_text
from palpate.simulation.format_texts import number_text, write_replay
from palpate.simulation.solid_model import Format, SolidModel

_POISSON = (-0.999, 0.5)
_RUN = "ParaView or meshio open model.vtu; constants are in palpate.json."
_QUADRATIC_TETRAHEDRON = 24


def write_vtu(folder: Path, model: SolidModel) -> None:
    """Write model.vtu and replay.json.

    Parameters
    ----------
    folder : Path
    model : SolidModel

    Raises
    ------
    RecordError                     a file cannot be written
    """
    count, nodes = len(model.solid.elements), len(model.nodes)
    ends = 10 * np.arange(1, count + 1)
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian">',
        "<UnstructuredGrid>",
        f'<Piece NumberOfPoints="{nodes}" NumberOfCells="{count}">',
        '<PointData Vectors="force">',
        *_array("force", "Float64", model.load, 3),
        *_array("held", "UInt8", model.held.astype(np.uint8), 1),
        "</PointData>",
        "<Points>",
        *_array("Points", "Float64", model.nodes, 3),
        "</Points>",
        "<Cells>",
        *_array("connectivity", "Int64", model.solid.elements, 1),
        *_array("offsets", "Int64", ends, 1),
        *_array("types", "UInt8", np.full(count, _QUADRATIC_TETRAHEDRON, dtype=np.uint8), 1),
        "</Cells>",
        "</Piece>",
        "</UnstructuredGrid>",
        "</VTKFile>",
    ]
    write_text(folder / "model.vtu", "\n".join(lines) + "\n")
    write_replay(folder, model, model.load)


def _array(name: str, kind: str, values: np.ndarray, components: int) -> Iterable[str]:
    """One array as text."""
    yield (
        f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="ascii">'
    )
    yield number_text(values)
    yield "</DataArray>"


VTU = Format("VTU", _POISSON, _RUN, of_solid=write_vtu)

"""Displacements of surface points from VTK unstructured grids."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from palpate.errors import RecordError
from palpate.files import read_bytes, read_errors
from palpate.geometry import check_packed_arrays
from palpate.optional_imports import late_import
from palpate.records.program import Program, ProgramPoints, chosen_frame
from palpate.records.text.nearest import nearest_word
from palpate.shapes import Points

_SUFFIXES = (".vtu", ".vtk")
# A million points with all that a program says of them.
_MAX_BYTES = 2**30
_DISPLACEMENT_NAMES = ("displacement", "displacements", "disp", "u")
_COMPONENT_NAMES = (("ux", "uy", "uz"), ("displacement_x", "displacement_y", "displacement_z"))
_STD_NAMES = ("displacement_std", "displacement_sigma", "std", "sigma")
_SURFACE_CELLS = ("vertex", "line", "triangle", "quad", "polygon")


def read_vtu_points(path: Path, frame: int | None = None) -> ProgramPoints:
    """Points of a grid with a displacement at each, through meshio.

    The points are positions at rest. The displacement is the point data `displacement`,
    `Displacement`, `U`, `u` or `disp` with three components, or `ux`, `uy`, `uz`; its standard
    deviation, if any, `displacement_std`, `std` or `sigma` with three components or one. NaN marks
    points that were not measured. The format has no unit of length.

    Parameters
    ----------
    path : Path                     suffix .vtu or .vtk
    frame : int or None             a file holds one state: only 0 or None

    Raises
    ------
    RecordError                     no such data, a 2-D vector, volume cells, unreadable
    InputError                      the optional package meshio is missing

    Source
    ------
    VTK file formats, "XML file formats", https://docs.vtk.org; the names are customary (ParaView,
    FEniCS, pyvista), not a standard.
    """
    chosen_frame(path, frame)
    content = _content(path)
    data = {name.lower(): np.asarray(values) for name, values in content.point_data.items()}
    solid = [block.type for block in content.cells if not block.type.startswith(_SURFACE_CELLS)]
    if solid:
        raise RecordError(
            f"{path}: holds solid cells ({solid[0]}), whose inner points were not observed;"
            " extract the surface first (ParaView: Extract Surface, then Merge to .vtu)"
        )
    moved = _displacement(path, data)
    points = np.zeros((len(moved), 3))
    points[:, : content.points.shape[1]] = content.points
    return ProgramPoints(points, moved, std=_std(path, data))


def _content(path: Path) -> Any:
    """The grid as meshio reads it."""
    if path.suffix.lower() not in _SUFFIXES:
        raise RecordError(
            f"{path}: is no .vtu file; save it as an unstructured grid of VTK (.vtu or .vtk)"
        )
    content = read_bytes(path, max_bytes=_MAX_BYTES)
    meshio = late_import("meshio", extra="mesh", purpose=f"reading {path.name}")
    what = f"cannot be read as {path.suffix[1:].upper()}"
    with read_errors(path, "open it in ParaView and save it again", what=what):
        if path.suffix.lower() == ".vtu":
            check_packed_arrays(content)
        return meshio.read(path)


def _displacement(path: Path, data: Mapping[str, np.ndarray]) -> Points:
    """The displacement, as a vector or as three scalars."""
    for name in _DISPLACEMENT_NAMES:
        if name in data and data[name].ndim == 2:
            if data[name].shape[1] != 3:
                raise RecordError(
                    f"{path}: its point data '{name}' has {data[name].shape[1]} components; depth"
                    " is needed: three"
                )
            return np.array(data[name], dtype=np.float64)
    for parts in _COMPONENT_NAMES:
        if all(name in data and data[name].ndim == 1 for name in parts):
            return np.stack([data[name] for name in parts], axis=1).astype(np.float64)
    near = next(filter(None, (nearest_word(name, _DISPLACEMENT_NAMES) for name in data)), "")
    raise RecordError(
        f"{path}: has no point data 'displacement' (or U, u, disp; or ux, uy, uz){near}; it has:"
        f" {', '.join(data) or 'no point data'}"
    )


def _std(path: Path, data: Mapping[str, np.ndarray]) -> Points | None:
    """The standard deviation of the displacement, of each component or of all three."""
    for name in _STD_NAMES:
        if name in data:
            values = np.array(data[name], dtype=np.float64)
            if values.ndim == 1:
                values = values[:, None]
            if values.shape[1] not in (1, 3):
                raise RecordError(
                    f"{path}: its point data '{name}' has {values.shape[1]} components; must be 1"
                    " or 3, one standard deviation each"
                )
            return np.broadcast_to(values, (len(values), 3)).copy()
    return None


VTU = Program(kinds=("vtu",), results=".vtu, .vtk", read_points=read_vtu_points, correlates=False)

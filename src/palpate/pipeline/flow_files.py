"""Measured motions as files: CSV of the vertices, NPZ and VTP of the range flow."""

import base64
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from palpate.geometry import TriangleMesh
from palpate.pipeline.measure_motion import vertex_field
from palpate.records import Camera, write_displacement
from palpate.shapes import Flags
from palpate.vision import (
    Outcome,
    RangeFlow,
    SurfaceMap,
    VertexDisplacement,
    camera_sigma,
    dense_maps,
    is_valid,
    measured_vertices,
)

RANGE_FLOW_FORMAT = "palpate-range-flow/1"
# What is put behind a stem; another motion's name must not end up there.
_ENDINGS = ("", "_flow", "_quality")


def file_stems(names: Sequence[str]) -> list[str]:
    """File names without their endings, one for each of k motions, all different.

    A motion's own name, or `motion-NUMBER` (from 1) where that is no file name or would meet the
    files of an earlier one.
    """
    stems: list[str] = []
    taken: set[str] = set()
    for number, name in enumerate(names, start=1):
        plain = name.replace("_", "").replace("-", "").replace(".", "")
        usable = plain.isalnum() and name[0] != "." and name.lower() != "contents"
        stem = name if usable else f"motion-{number}"
        # Some file systems do not tell upper from lower case.
        while taken & {(stem + ending).lower() for ending in _ENDINGS}:
            stem = f"motion-{number}" if stem == name else f"{stem}-"
        taken |= {(stem + ending).lower() for ending in _ENDINGS}
        stems.append(stem)
    return stems


def seen_vertices(surface: SurfaceMap, mesh: TriangleMesh) -> Flags:
    """Vertices of triangles that a camera sees anything of.

    Parameters
    ----------
    surface : SurfaceMap            of the camera and the mesh
    mesh : TriangleMesh             of v vertices

    Returns
    -------
    (v,) bool
    """
    triangles = np.unique(surface.triangle)
    flags = np.zeros(len(mesh.vertices), dtype=bool)
    flags[mesh.triangles[triangles[triangles >= 0]]] = True
    return flags


def write_vertices(
    path: Path,
    mesh: TriangleMesh,
    vertices: VertexDisplacement,
    *,
    seen: Flags,
    metres_per_unit: float = 1.0,
) -> None:
    """Displacement of the vertices as CSV, as `palpate fit` takes it.

    Vertices that were neither seen nor measured are left out: nobody looked at them.

    Parameters
    ----------
    path : Path
    mesh : TriangleMesh
    vertices : VertexDisplacement
    seen : (v,) bool                vertices that the reference camera sees: a row each, NaN where
                                    nothing was measured
    metres_per_unit : float         length unit of the session

    Raises
    ------
    RecordError                     the file cannot be written
    """
    rows = np.flatnonzero(seen | measured_vertices(vertices))
    field = vertex_field(mesh, vertices, rows, str(path))
    write_displacement(path, field, metres_per_unit=metres_per_unit)


def write_flow_npz(path: Path, flow: RangeFlow, *, name: str, cameras: Sequence[str]) -> None:
    """Range flow as compressed NPZ; lengths in metres, object frame.

    Keys: the attributes of `RangeFlow`; `format`, `name`, `camera_names` (c,); `outcome_names`, so
    that `outcome_names[outcome]` is the cause in words; and `dense_displacement` (rows, columns, 3)
    and `dense_sigma` (rows, columns), float32, at every pixel, NaN where nothing is known.

    Parameters
    ----------
    path : Path                     ending .npz
    flow : RangeFlow
    name : str                      of the motion
    cameras : sequence of c str

    Raises
    ------
    OSError                         the file cannot be written
    """
    displacement, sigma = dense_maps(flow)
    content: dict[str, Any] = {
        "format": np.array(RANGE_FLOW_FORMAT),
        "name": np.array(name),
        "camera_names": np.array(list(cameras)),
        "outcome_names": np.array([outcome.name.lower() for outcome in Outcome]),
        "dense_displacement": displacement,
        "dense_sigma": sigma,
    }
    content |= {field.name: np.asarray(getattr(flow, field.name)) for field in fields(RangeFlow)}
    np.savez_compressed(path, **content)


def write_flow_vtp(path: Path, flow: RangeFlow, camera: Camera) -> None:
    """Range flow as VTK points with vectors and scalars, for ParaView; metres, object frame.

    Rejected points are there with a displacement of zero, since a NaN in a vector spoils arrows;
    their `magnitude` and sigmas are NaN and their `outcome` is not 0.

    Parameters
    ----------
    path : Path                     ending .vtp
    flow : RangeFlow
    camera : Camera                 the reference camera

    Raises
    ------
    OSError                         the file cannot be written
    """
    valid = is_valid(flow)
    lateral, depth = camera_sigma(flow.covariance, camera)
    moved = np.where(valid[:, None], flow.displacement, 0.0)
    arrays = {
        "displacement": moved.astype(np.float32),
        "magnitude": np.linalg.norm(flow.displacement, axis=1).astype(np.float32),
        "sigma_lateral": lateral.astype(np.float32),
        "sigma_depth": depth.astype(np.float32),
        "score": flow.score.astype(np.float32),
        "reprojection": flow.reprojection.astype(np.float32),
        "cameras": flow.cameras.astype(np.int32),
        "outcome": flow.outcome.astype(np.int32),
        "through_last": flow.through_last.astype(np.int32),
        "pixel": flow.pixel.astype(np.float32),
    }
    path.write_text(_polydata(flow.point, arrays), encoding="ascii")


def _polydata(points: Float[np.ndarray, "n 3"], arrays: Mapping[str, np.ndarray]) -> str:
    """A .vtp document with one vertex cell a point, so that the points are drawn at once.

    Source
    ------
    VTK file formats, "XML File Formats", https://docs.vtk.org
    """
    count = len(points)
    data = "".join(_data_array(name, values) for name, values in arrays.items())
    connectivity = _data_array("connectivity", np.arange(count, dtype=np.int64))
    offsets = _data_array("offsets", np.arange(1, count + 1, dtype=np.int64))
    return (
        '<?xml version="1.0"?>\n'
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
        ' compressor="vtkZLibDataCompressor">\n<PolyData>\n'
        f'<Piece NumberOfPoints="{count}" NumberOfVerts="{count}" NumberOfLines="0"'
        ' NumberOfStrips="0" NumberOfPolys="0">\n'
        f'<PointData Vectors="displacement" Scalars="magnitude">\n{data}</PointData>\n'
        f"<Points>\n{_data_array('Points', points.astype(np.float64))}</Points>\n"
        f"<Verts>\n{connectivity}{offsets}</Verts>\n"
        "</Piece>\n</PolyData>\n</VTKFile>\n"
    )


def _data_array(name: str, values: np.ndarray) -> str:
    """One array in base64, zipped as a single block behind a header of its sizes."""
    kind = {"f": "Float", "i": "Int"}[values.dtype.kind] + str(8 * values.dtype.itemsize)
    components = values.shape[1] if values.ndim == 2 else 1
    raw = np.ascontiguousarray(values.astype(values.dtype.newbyteorder("<"))).tobytes()
    zipped = zlib.compress(raw, 6)
    # Blocks, size of a block, size of a last smaller block (0: there is none), sizes zipped.
    sizes = [1, len(raw), 0, len(zipped)] if raw else [0, 0, 0]
    header = base64.b64encode(np.array(sizes, dtype="<u8").tobytes()).decode()
    body = base64.b64encode(zipped).decode() if raw else ""
    return (
        f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}"'
        f' format="binary">{header}{body}</DataArray>\n'
    )

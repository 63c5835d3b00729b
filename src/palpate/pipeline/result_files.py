"""Files of a result: motions, vertices, residuals; the measured and the predicted surface, which
reports and other programs read."""

import base64
import io
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from palpate.arrays import fix_fields
from palpate.disk import write_bytes
from palpate.errors import InputError, RecordError
from palpate.estimation import FitResult, LikelihoodMap, Prediction
from palpate.files import stored_arrays
from palpate.geometry import TriangleMesh
from palpate.pipeline.motion.displacement import vertex_field
from palpate.pipeline.motion.figures import MotionFigures, motion_figures
from palpate.pipeline.motion.measure_motion import MeasuredMotion
from palpate.records import (
    Camera,
    ModulusMap,
    RelaxationEstimate,
    Rig,
    Session,
    file_stems,
    write_displacement,
    write_text,
)
from palpate.shapes import Flags, Indices, Points, Vector3
from palpate.vision import (
    Outcome,
    RangeFlow,
    SurfaceMap,
    VertexDisplacement,
    camera_sigma,
    dense_maps,
    is_valid,
    measured_vertices,
    surface_map,
)

RANGE_FLOW_FORMAT = "palpate-range-flow/1"
MODULUS_FORMAT = "palpate-modulus/2"
_HELD_OUT = "x,y,z,ux,uy,uz,px,py,pz,sx,sy,sz"
_RESIDUALS = "x,y,z,ux,uy,uz,predicted_ux,predicted_uy,predicted_uz,weight_x,weight_y,weight_z"
SURFACE_FILE = "surface.npz"
SURFACE_FORMAT = "palpate-fitted-surface/1"
# Earlier name of the format, which files of scanned meshes had as well.
_EARLIER_FORMAT = "palpate-surface/1"
_CURE, _WRONG = "fit the session again", "is damaged or of another version"
# Enough for a hundred probings of fifty thousand vertices.
_MOST_BYTES = 2**30


def write_held_out(folder: Path, predictions: Sequence[Prediction]) -> None:
    """Write held_out/NAME.csv for every probing that was predicted, in metres: its measured points,
    their measured and predicted displacement, and the standard deviation of the prediction.

    Parameters
    ----------
    folder : Path                   of the result; `held_out` is made in it where there is one
    predictions : sequence of Prediction

    Raises
    ------
    OSError                         a file cannot be written
    """
    if not predictions:
        return
    below = folder / "held_out"
    below.mkdir()
    stems = file_stems([prediction.name for prediction in predictions], kind="probing")
    for stem, prediction in zip(stems, predictions, strict=True):
        rows = np.hstack(
            [prediction.position, prediction.measured, prediction.predicted, prediction.std]
        )
        rows = rows[np.isfinite(rows).all(axis=1)]
        file = below / f"{stem}.csv"
        np.savetxt(file, rows, fmt="%.9g", delimiter=",", header=_HELD_OUT, comments="")


def write_modulus(path: Path, modulus: ModulusMap) -> None:
    """Write a map of the modulus as NPZ: the attributes of `ModulusMap`, lengths in metres.

    Parameters
    ----------
    path : Path                     ending .npz
    modulus : ModulusMap

    Raises
    ------
    OSError                         the file cannot be written
    """
    content = {field.name: getattr(modulus, field.name) for field in fields(modulus)}
    np.savez_compressed(path, format=np.array(MODULUS_FORMAT), **content)


def write_relaxation(path: Path, relaxation: RelaxationEstimate) -> None:
    """Write the modulus over time as CSV: time [s], modulus and its 95 % interval [Pa].

    Parameters
    ----------
    path : Path                     ending .csv
    relaxation : RelaxationEstimate

    Raises
    ------
    OSError                         the file cannot be written
    """
    rows = [(point.time, point.modulus.value, *point.modulus.ci95) for point in relaxation.curve]
    head = f"t [s],{relaxation.constant} [Pa],low [Pa],high [Pa]"
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", header=head, comments="")


def read_modulus(path: Path) -> ModulusMap | None:
    """Read a map of the modulus back.

    Parameters
    ----------
    path : Path

    Returns
    -------
    ModulusMap or None              None: there is no such file, the modulus is one everywhere

    Raises
    ------
    RecordError                     unreadable, of another version or inconsistent
    """
    if not path.is_file():
        return None
    with stored_arrays(path, _CURE, what=_WRONG) as arrays:
        if str(arrays.pop("format")) != MODULUS_FORMAT:
            raise ValueError(f"format is not '{MODULUS_FORMAT}'")
        return ModulusMap(**arrays)


def write_residuals(folder: Path, session: Session, result: FitResult) -> None:
    """Write residuals/NAME.csv for every probing, in metres; NaN where nothing was measured.

    Weights are the robust weights of the components, 0 to 1.

    Parameters
    ----------
    folder : Path                   of the result; `residuals` is made in it
    session : Session               that was fitted
    result : FitResult

    Raises
    ------
    OSError                         a file cannot be written
    """
    below = folder / "residuals"
    below.mkdir()
    fields_of = {probing.name: probing.displacement for probing in session.probings}
    stems = file_stems([fit.name for fit in result.probes], kind="probing")
    for stem, fit in zip(stems, result.probes, strict=True):
        field = fields_of[fit.name]
        if field is None:
            continue
        rows = np.concatenate([field.points, field.displacement, fit.predicted, fit.weight], axis=1)
        file = below / f"{stem}.csv"
        np.savetxt(file, rows, fmt="%.9g", delimiter=",", header=_RESIDUALS, comments="")


@dataclass(frozen=True, slots=True, eq=False)
class WrittenMotion:
    """What was written of a measured motion: all its files except pictures.

    Attributes
    ----------
    surface : SurfaceMap            surface of the object at rest as the reference camera sees it
    figures : MotionFigures
    files : dict of str to str      kind to file name; empty without a flow
    """

    surface: SurfaceMap
    figures: MotionFigures
    files: dict[str, str]


def write_motion(
    folder: Path,
    session: Session,
    rig: Rig,
    motion: MeasuredMotion,
    *,
    stem: str,
    surface: SurfaceMap | None = None,
) -> WrittenMotion:
    """Write the files of one motion of a session.

    Parameters
    ----------
    folder : Path                   of the result
    session : Session               that is measured
    rig : Rig                       with which it is measured
    motion : MeasuredMotion
    stem : str                      of the files' names
    surface : SurfaceMap or None    that of an earlier motion, to be used again if the pictures have
                                    the same size

    Returns
    -------
    WrittenMotion

    Raises
    ------
    OSError, RecordError            a file cannot be written
    """
    camera, mesh = rig.cameras[rig.reference], session.mesh
    rows, columns = motion.first.shape
    if surface is None or surface.triangle.shape != (rows, columns):
        surface = surface_map(camera, (rows, columns), mesh.vertices, mesh.triangles)
    seen = seen_vertices(surface, mesh)
    files: dict[str, str] = {}
    if motion.flow is not None:
        files = {"range_flow": f"{stem}_flow.npz", "points": f"{stem}_flow.vtp"}
        names = [camera.name for camera in rig.cameras]
        write_flow_npz(folder / files["range_flow"], motion.flow, name=motion.name, cameras=names)
        write_flow_vtp(folder / files["points"], motion.flow, camera)
    if motion.vertices is not None:
        files["vertices"] = f"{stem}.csv"
        unit = session.metres_per_unit
        path = folder / files["vertices"]
        write_vertices(path, mesh, motion.vertices, seen=seen, metres_per_unit=unit)
    return WrittenMotion(surface, motion_figures(motion, rig, seen), files)


def seen_vertices(surface: SurfaceMap, mesh: TriangleMesh) -> Flags:
    """Vertices of triangles that a camera sees at least in part.

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
    """Write the displacement of the vertices as CSV, as `palpate fit` reads it.

    Vertices that were neither seen nor measured are left out.

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
    """Write a range flow as compressed NPZ; lengths in metres, object frame.

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
    """Write a range flow as VTK points with vectors and scalars for ParaView; metres, object frame.

    Rejected points have a displacement of zero, since NaN in a vector breaks the display of arrows;
    their `magnitude` and sigmas are NaN and their `outcome` is not 0.

    Parameters
    ----------
    path : Path                     ending .vtp
    flow : RangeFlow
    camera : Camera                 the reference camera

    Raises
    ------
    RecordError                     the file cannot be written; it is then unchanged
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
    write_text(path, _polydata(flow.point, arrays))


@dataclass(frozen=True, slots=True, eq=False)
class FittedProbing:
    """One probing of a fitted object; rows of points that were not measured hold NaN.

    Attributes
    ----------
    name : str
    contact : (3,) float [m]        centre of the tool's patch
    force : (3,) float [N]
    points : (n, 3) float [m]       at rest
    displacement : (n, 3) float [m] measured
    predicted : (n, 3) float [m]    by the fitted model
    left_out : (n, 3) float [m] or None     by the model fitted to all other probings
    sigma : (n, 3) float [m]        1 sigma of the measured displacement used in the estimate
    weight : (n, 3) float           robust weight, 0 to 1
    surface : (v, 3) float [m] or None      predicted displacement of every vertex

    Raises
    ------
    InputError                      arrays that do not belong together
    """

    name: str
    contact: Vector3
    force: Vector3
    points: Points
    displacement: Points
    predicted: Points
    left_out: Points | None
    sigma: Points
    weight: Points
    surface: Float[np.ndarray, "v 3"] | None

    def __post_init__(self) -> None:
        fix_fields(self, contact=(3,), force=(3,), points=(None, 3))
        shape = (len(self.points), 3)
        fix_fields(
            self, nan_allowed=True, none_allowed=True, displacement=shape, predicted=shape,
            left_out=shape, sigma=shape, weight=shape,
        )  # fmt: skip
        fix_fields(self, none_allowed=True, surface=(None, 3))


@dataclass(frozen=True, slots=True, eq=False)
class FittedSurface:
    """A fitted object, its probings and the likelihood of its constants.

    Attributes
    ----------
    name : str                      of the session
    vertices : (v, 3) float [m]
    triangles : (m, 3) int
    held : (k,) int                 triangles of the supports
    probings : tuple of FittedProbing   one or more
    likelihood : LikelihoodMap

    Raises
    ------
    InputError                      arrays that do not belong together, no probing
    """

    name: str
    vertices: Float[np.ndarray, "v 3"]
    triangles: Int[np.ndarray, "m 3"]
    held: Indices
    probings: tuple[FittedProbing, ...]
    likelihood: LikelihoodMap

    def __post_init__(self) -> None:
        fix_fields(self, vertices=(None, 3))
        fix_fields(self, integer=True, triangles=(None, 3), held=(None,))
        for name, indices, count in (
            ("triangles", self.triangles, len(self.vertices)),
            ("held", self.held, len(self.triangles)),
        ):
            if indices.min(initial=0) < 0 or indices.max(initial=0) >= count:
                raise InputError(f"{name} has numbers outside 0 to {count - 1}")
        if not self.probings:
            raise InputError("there is no probing; must be one or more")
        shapes = (probing.surface.shape for probing in self.probings if probing.surface is not None)
        if any(shape != self.vertices.shape for shape in shapes):
            raise InputError("surfaces of probings are those of another mesh")


def write_fitted_surface(folder: Path, session: Session, result: FitResult) -> None:
    """Write `surface.npz`; lengths in metres, forces in newtons, object frame.

    Parameters
    ----------
    folder : Path                   of the result
    session : Session               that was fitted
    result : FitResult

    Raises
    ------
    RecordError                     the file cannot be written
    """
    content: dict[str, Any] = {
        "format": np.array(SURFACE_FORMAT),
        "name": np.array(session.name),
        "probings": np.array([probe.name for probe in result.probes], dtype=str),
        "vertices": session.mesh.vertices,
        "triangles": session.mesh.triangles.astype(np.int32),
        "held": session.held_triangles.astype(np.int32),
        "likelihood/poisson_ratio": result.likelihood.poisson_ratio,
        "likelihood/shear_modulus": result.likelihood.shear_modulus,
        "likelihood/deviance": result.likelihood.deviance,
    }
    by_name = {probing.name: probing for probing in session.probings}
    for number, fit in enumerate(result.probes, start=1):
        probing = by_name[fit.name]
        field = probing.displacement
        if field is None:
            continue
        arrays = {
            "contact": probing.contact.point,
            "force": probing.force,
            "points": field.points,
            "displacement": field.displacement,
            "predicted": fit.predicted,
            "left_out": fit.left_out_predicted,
            "sigma": field.displacement * np.nan if fit.sigma is None else fit.sigma,
            "weight": fit.weight,
            "surface": fit.surface,
        }
        content |= {f"{number}/{name}": x for name, x in arrays.items() if x is not None}
    packed = io.BytesIO()
    np.savez_compressed(packed, **content)
    write_bytes(folder / SURFACE_FILE, packed.getvalue())


def read_fitted_surface(folder: Path) -> FittedSurface:
    """Read `surface.npz` back.

    Parameters
    ----------
    folder : Path                   of a result

    Returns
    -------
    FittedSurface

    Raises
    ------
    RecordError                     the file is missing, unreadable, of another version or
                                    inconsistent
    """
    path = folder / SURFACE_FILE
    if not path.is_file():
        raise RecordError(
            f"{path}: is not there; was {folder} written by `palpate fit` of an earlier version?"
            f" {_CURE}"
        )
    with stored_arrays(path, _CURE, what=_WRONG, max_bytes=_MOST_BYTES) as arrays:
        return _surface(arrays)


def _polydata(points: Float[np.ndarray, "n 3"], arrays: Mapping[str, np.ndarray]) -> str:
    """A .vtp document with one vertex cell for each point, so that points are shown by default.

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
    """One array in base64, compressed as a single block after a header of its sizes."""
    kind = {"f": "Float", "i": "Int"}[values.dtype.kind] + str(8 * values.dtype.itemsize)
    components = values.shape[1] if values.ndim == 2 else 1
    raw = np.ascontiguousarray(values.astype(values.dtype.newbyteorder("<"))).tobytes()
    zipped = zlib.compress(raw, 6)
    # Number of blocks, block size, size of a last partial block (0: none), compressed sizes.
    sizes = [1, len(raw), 0, len(zipped)] if raw else [0, 0, 0]
    header = base64.b64encode(np.array(sizes, dtype="<u8").tobytes()).decode()
    body = base64.b64encode(zipped).decode() if raw else ""
    return (
        f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}"'
        f' format="binary">{header}{body}</DataArray>\n'
    )


def _surface(arrays: dict[str, np.ndarray]) -> FittedSurface:
    if str(arrays["format"]) not in (SURFACE_FORMAT, _EARLIER_FORMAT):
        raise ValueError(f"format is '{arrays['format']}', not '{SURFACE_FORMAT}'")
    probings = [
        _probing(
            str(name),
            {
                key[len(f"{number}/") :]: arrays[key]
                for key in arrays
                if key.startswith(f"{number}/")
            },
        )
        for number, name in enumerate(arrays["probings"], start=1)
        if f"{number}/points" in arrays
    ]
    likelihood = LikelihoodMap(
        *(arrays[f"likelihood/{key}"] for key in ("poisson_ratio", "shear_modulus", "deviance"))
    )
    return FittedSurface(
        str(arrays["name"]), arrays["vertices"], arrays["triangles"], arrays["held"],
        tuple(probings), likelihood,
    )  # fmt: skip


def _probing(name: str, arrays: dict[str, np.ndarray]) -> FittedProbing:
    return FittedProbing(
        name=name,
        left_out=arrays.get("left_out"),
        surface=arrays.get("surface"),
        **{key: arrays[key] for key in arrays if key not in ("left_out", "surface")},
    )

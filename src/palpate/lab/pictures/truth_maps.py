"""Ground truth of the pictures, pixel by pixel: the true motion, to compare estimates with."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.records import Rig, picture_size
from palpate.shapes import PointIndices, Points
from palpate.vision import SurfaceMap, surface_map, visible

# A point counts as hidden by its own body if it lies this far behind it, in pixel widths there: the
# tolerance covers the interpolation of depth between pixel centres near the silhouette.
_BEHIND = 0.1
# One bit of a byte for each camera.
_MAX_CAMERAS = 8


@dataclass(frozen=True, slots=True, eq=False)
class TruthMap:
    """True motion of what the reference camera sees at rest.

    Attributes
    ----------
    shape : (rows, columns)         of the reference camera
    pixel : (n,) int                row * columns + column of the pixels that show the body at rest
    point : (n, 3) float [m]        surface points at their centres, at rest, object frame
    displacement : (n, 3) float [m] of these points
    hidden_rest, hidden_loaded : (n,) int   bit i is set if camera i does not see the point, because
                                    it is outside the picture or occluded
    """

    shape: tuple[int, int]
    pixel: PointIndices
    point: Points
    displacement: Points
    hidden_rest: PointIndices
    hidden_loaded: PointIndices


def truth_map(
    rig: Rig,
    mesh: TriangleMesh,
    loaded: Float[np.ndarray, "w 3"],
    *,
    tool: TriangleMesh | None = None,
) -> TruthMap:
    """Truth map of one pair of rest and loaded pictures.

    Parameters
    ----------
    rig : Rig                       cameras with picture sizes, at most eight
    mesh : TriangleMesh             rendered mesh, at rest
    loaded : (v, 3) float [m]       its vertices in the loaded pictures
    tool : TriangleMesh or None     visible in the loaded pictures only

    Returns
    -------
    TruthMap

    Raises
    ------
    InputError                      too many cameras, one without a size, meshes that do not match,
                                    a reference camera that sees nothing of the body
    CalibrationError                a body that is not in front of a camera
    """
    if len(rig.cameras) > _MAX_CAMERAS:
        raise InputError(
            f"truth maps hold {_MAX_CAMERAS} cameras, a bit each; the rig has {len(rig.cameras)}"
        )
    if len(mesh.vertices) != len(loaded):
        raise InputError(
            f"the mesh has {len(mesh.vertices)} vertices at rest and {len(loaded)} loaded; must be"
            " the same"
        )
    seen = _surface_maps(rig, mesh)
    shown = seen[rig.reference]
    pixel = np.flatnonzero(shown.triangle.ravel() >= 0)
    if len(pixel) == 0:
        raise InputError(
            f"camera '{rig.cameras[rig.reference].name}' sees nothing of the body; turn it towards"
            " the object"
        )
    point = shown.point.reshape(-1, 3)[pixel]
    corner = mesh.triangles[shown.triangle.ravel()[pixel]]
    weight = _barycentric(mesh.vertices[corner], point)
    displacement = np.einsum("nc,nca->na", weight, (loaded - mesh.vertices)[corner])
    moved = point + displacement
    hidden_loaded = _hidden(
        rig, _surface_maps(rig, replace(mesh, vertices=loaded)), moved, behind=_BEHIND
    )
    if tool is not None:
        # Without tolerance: where the tool touches the body both surfaces coincide, but the tool's
        # near side is well in front.
        hidden_loaded |= _hidden(rig, _surface_maps(rig, tool), moved, behind=0.0)
    return TruthMap(
        shown.triangle.shape,
        pixel,
        point,
        displacement,
        _hidden(rig, seen, point, behind=_BEHIND),
        hidden_loaded,
    )


def write_truth_map(path: Path | io.BytesIO, truth: TruthMap) -> None:
    """Write a truth map as a compressed NPZ file; the same map gives the same bytes.

    Entries: `shape`, `pixel` (int32), `X` (point) and `U` (displacement; both float32, metres),
    `hidden_rest` and `hidden_loaded` (uint8).

    Parameters
    ----------
    path : Path or BytesIO
    truth : TruthMap
    """
    np.savez_compressed(
        path,
        shape=np.array(truth.shape),
        pixel=truth.pixel.astype(np.int32),
        X=truth.point.astype(np.float32),
        U=truth.displacement.astype(np.float32),
        hidden_rest=truth.hidden_rest.astype(np.uint8),
        hidden_loaded=truth.hidden_loaded.astype(np.uint8),
    )


def _surface_maps(rig: Rig, mesh: TriangleMesh) -> tuple[SurfaceMap, ...]:
    """What every camera of a rig sees of a surface."""
    return tuple(
        surface_map(camera, picture_size(camera)[::-1], mesh.vertices, mesh.triangles)
        for camera in rig.cameras
    )


def _hidden(rig: Rig, maps: Sequence[SurfaceMap], points: Points, *, behind: float) -> PointIndices:
    """Bits of the cameras that do not see points; `behind` is the tolerance in pixel widths."""
    bits = np.zeros(len(points), dtype=np.int64)
    for k, (camera, surface) in enumerate(zip(rig.cameras, maps, strict=True)):
        pose = camera.T_camera_object
        width = float((points @ pose[2, :3] + pose[2, 3]).min() / camera.matrix[0, 0])
        seen = visible(surface, camera, points, tolerance=behind * width)
        bits |= np.where(seen, 0, 1 << k)
    return bits


def _barycentric(corner: Float[np.ndarray, "n 3 3"], point: Points) -> Float[np.ndarray, "n 3"]:
    """Barycentric coordinates of points in their triangles' planes."""
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    normal = np.cross(a, b)
    away = point - corner[:, 0]
    area2 = np.einsum("na,na->n", normal, normal)
    beside_b = np.einsum("na,na->n", np.cross(away, b), normal) / area2
    beside_c = np.einsum("na,na->n", np.cross(a, away), normal) / area2
    return np.stack([1.0 - beside_b - beside_c, beside_b, beside_c], axis=1)

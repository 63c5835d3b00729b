"""The first instant: what each camera sees of the surface, and the points to be followed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.records import Camera, Rig
from palpate.shapes import Points, PointScalars, Triangles, Vertices
from palpate.vision.cameras import (
    SurfaceMap,
    packed_rig,
    project,
    project_jacobian,
    surface_map,
    visible,
)
from palpate.vision.images import SplinePicture, spline_pictures
from palpate.vision.joint.settings import JointSettings

# A pixel this close to an outline mixes object and ground: its response, and the spline's, reach so
# far.
_RIM = 2
# Neighbouring pixels whose depths differ by more than this many pixel sides lie on two parts of the
# object, one before the other, or on one seen at less than 12 degrees.
_JUMP = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Pictures, surface and points of one instant.

    Attributes
    ----------
    rig : Rig
    packed : (c, 25) float              the cameras for the kernels
    grey : tuple of c (rows, columns) float [grey levels]   the pictures as they are
    pictures : tuple of c SplinePicture     the same, smoothed, ready to be matched
    surface : tuple of c (rows, columns, 3) float32 [m]     point behind each pixel, NaN where none
    inner : tuple of c (rows, columns) float32      1 where a pixel surely shows the surface, else 0
    pixel : (n, 2) float [px]           of the points, in the reference camera
    point : (n, 3) float [m]            on the surface
    tangent : (n, 2, 3) float           two orthonormal tangents there
    extent : (n,) float [m]             half side of a window on the surface
    seen : (n, c) bool                  which cameras see the point
    """

    rig: Rig
    packed: Float[np.ndarray, "c 25"]
    grey: tuple[Float[np.ndarray, "_ _"], ...]
    pictures: tuple[SplinePicture, ...]
    surface: tuple[Float[np.ndarray, "_ _ 3"], ...]
    inner: tuple[Float[np.ndarray, "_ _"], ...]
    pixel: Float[np.ndarray, "n 2"]
    point: Points
    tangent: Float[np.ndarray, "n 2 3"]
    extent: PointScalars
    seen: Bool[np.ndarray, "n c"]


def make_scene(
    rig: Rig,
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    vertices: Vertices,
    triangles: Triangles,
    *,
    settings: JointSettings = JointSettings(),
) -> Scene:
    """Cut a surface into points on the reference camera's grid.

    Parameters
    ----------
    rig : Rig
    pictures : sequence of c (rows, columns) float [grey levels]
    vertices, triangles : (v, 3) float [m], (m, 3) int      the surface, open or closed
    settings : JointSettings

    Returns
    -------
    Scene                           without points where the reference camera sees none
    """
    maps = tuple(
        surface_map(camera, picture.shape, vertices, triangles)
        for camera, picture in zip(rig.cameras, pictures, strict=True)
    )
    inner = tuple(inner_pixels(one, camera) for one, camera in zip(maps, rig.cameras, strict=True))
    first = maps[rig.reference]
    start = settings.step // 2
    row, column = np.nonzero(inner[rig.reference][start :: settings.step, start :: settings.step])
    row, column = start + settings.step * row, start + settings.step * column
    point = np.ascontiguousarray(first.point[row, column], dtype=np.float64)
    corner = vertices[triangles[first.triangle[row, column]]]
    tangent = _tangents(corner)
    extent = window_extent(rig, point, settings.subset)
    # Behind the surface by more than half a window means behind another part of it.
    tolerance = float(np.median(extent)) if len(extent) else 0.0
    seen = np.stack(
        [
            visible(one, camera, point, tolerance=tolerance)
            for one, camera in zip(maps, rig.cameras, strict=True)
        ],
        axis=1,
    )
    return Scene(
        rig=rig,
        packed=packed_rig(rig),
        grey=tuple(pictures),
        pictures=spline_pictures(pictures, settings.smoothing),
        surface=tuple(np.ascontiguousarray(one.point, dtype=np.float32) for one in maps),
        inner=inner,
        pixel=np.stack([column, row], axis=1).astype(np.float64),
        point=point,
        tangent=tangent,
        extent=extent,
        seen=seen,
    )


def window_extent(rig: Rig, point: Points, subset: int) -> PointScalars:
    """Half side of a window at points of the surface, seen face on by the reference camera [m]."""
    camera = rig.cameras[rig.reference]
    pose = camera.T_camera_object
    depth = point @ pose[2, :3] + pose[2, 3]
    return (subset // 2) * depth / camera.matrix[0, 0]


def pixel_size(scene: Scene) -> Float[np.ndarray, " n"]:
    """Side of a pixel of the reference camera on the surface [m]."""
    camera = scene.rig.cameras[scene.rig.reference]
    pose = camera.T_camera_object
    return (scene.point @ pose[2, :3] + pose[2, 3]) / camera.matrix[0, 0]


def scene_rows(scene: Scene, rows: Int[np.ndarray, " k"]) -> Scene:
    """The scene with some of its points."""
    return replace(
        scene,
        pixel=scene.pixel[rows],
        point=scene.point[rows],
        tangent=scene.tangent[rows],
        extent=scene.extent[rows],
        seen=scene.seen[rows],
    )


def jacobians(rig: Rig, point: Points) -> Float[np.ndarray, "c n 2 3"]:
    """Derivative of every camera's pixel by the point [px/m]."""
    return np.stack([project_jacobian(camera, point)[1] for camera in rig.cameras])


def pixels(rig: Rig, point: Points) -> Float[np.ndarray, "c n 2"]:
    """Where every camera sees points [px]."""
    return np.stack([project(camera, point) for camera in rig.cameras])


def inner_pixels(surface: SurfaceMap, camera: Camera) -> Float[np.ndarray, "rows columns"]:
    """1 where one unbroken part of the surface is seen at a pixel and all around it, else 0."""
    pose = camera.T_camera_object
    depth = surface.point @ pose[2, :3] + pose[2, 3]
    allowed = _JUMP * depth / camera.matrix[0, 0]
    there = (surface.triangle >= 0).astype(np.uint8)
    for axis in (0, 1):
        with np.errstate(invalid="ignore"):
            apart = np.abs(np.diff(depth, axis=axis)) > np.delete(allowed, 0, axis=axis)
        near, far = [slice(None)] * 2, [slice(None)] * 2
        near[axis], far[axis] = slice(None, -1), slice(1, None)
        there[tuple(near)][apart] = 0
        there[tuple(far)][apart] = 0
    around = np.ones((2 * _RIM + 1, 2 * _RIM + 1), dtype=np.uint8)
    kept = cv2.erode(there, around, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return kept.astype(np.float32)


def _tangents(corner: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 2 3"]:
    """Two orthonormal tangents of triangles given by their corners."""
    first = corner[:, 1] - corner[:, 0]
    first = first / np.linalg.norm(first, axis=1)[:, None]
    normal = np.cross(first, corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    return np.stack([first, np.cross(normal, first)], axis=1)

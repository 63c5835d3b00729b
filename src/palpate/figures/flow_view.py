"""The reference camera's view of the object, and values drawn on its picture."""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, ListedColormap, Normalize
from matplotlib.tri import Triangulation

from palpate.figures.style import INK, LIGHT
from palpate.geometry import TriangleMesh, unit_normals
from palpate.records import Camera
from palpate.shapes import Indices, PointScalars
from palpate.vision import RangeFlow, SurfaceMap, VertexDisplacement, measured_vertices, project

MARGIN = 0.05  # around the object, as a fraction of its size in the picture
MAX_PIXELS = 700  # along a side of a panel; a page shows no more
GREYS = (-0.16, 1.14)  # levels of black and white, for a slightly paler picture
OPACITY = 0.85  # of colours, so that the texture shows through faintly
CLAY = LinearSegmentedColormap.from_list("clay", ["#6f7379", "#d4d7db"])

Image = Float[np.ndarray, "rows columns"]


@dataclass(frozen=True, slots=True, eq=False)
class FlowView:
    """The part of the reference picture that shows the object.

    Attributes
    ----------
    camera : Camera                 the reference camera
    mesh : TriangleMesh
    low, high : (2,) int [px]       first and last + 1 column and row
    stride : int [px]               spacing of the pixels that are shown
    grey : (rows, columns) float    grey level of these pixels, 0 black to 1 white
    triangles : (k,) int            visible triangles, from the farthest to the nearest
    """

    camera: Camera
    mesh: TriangleMesh
    low: Int[np.ndarray, "2"]
    high: Int[np.ndarray, "2"]
    stride: int
    grey: Image
    triangles: Indices


def make_flow_view(
    picture: Image, camera: Camera, surface: SurfaceMap, mesh: TriangleMesh
) -> FlowView:
    """Crop a picture to the object; the whole picture is kept if the object is not in view.

    Parameters
    ----------
    picture : (rows, columns) float [grey levels]   first instant, reference camera
    camera : Camera                 the reference camera
    surface : SurfaceMap            surface as seen by that camera
    mesh : TriangleMesh

    Returns
    -------
    FlowView
    """
    size = np.array(picture.shape[::-1])
    rows, columns = np.nonzero(surface.triangle >= 0)
    low, high = np.zeros(2, dtype=np.int64), size
    if len(rows):
        first = np.array([columns.min(), rows.min()])
        last = np.array([columns.max(), rows.max()])
        more = int(np.ceil(MARGIN * (last - first).max())) + 2
        low, high = np.maximum(first - more, 0), np.minimum(last + more + 1, size)
    stride = int(np.ceil((high - low).max() / MAX_PIXELS))
    part = (slice(low[1], high[1], stride), slice(low[0], high[0], stride))
    shown, seen = picture[part].astype(np.float64), surface.triangle[part] >= 0
    black, white = np.quantile(shown[seen] if seen.any() else shown, [0.01, 0.99])
    grey = np.clip((shown - black) / max(white - black, 1.0), 0.0, 1.0)
    triangles = np.unique(surface.triangle[surface.triangle >= 0])
    centre = mesh.vertices[mesh.triangles[triangles]].mean(axis=1)
    order = np.argsort(-(centre @ camera.T_camera_object[2, :3]), kind="stable")
    return FlowView(camera, mesh, low, high, stride, grey, triangles[order])


def seen_corners(view: FlowView) -> Indices:
    """Vertices of the visible triangles.

    Parameters
    ----------
    view : FlowView

    Returns
    -------
    (k,) int                        indices of the mesh's vertices, ascending
    """
    return np.unique(view.mesh.triangles[view.triangles])


def draw_picture(axes: Axes, view: FlowView) -> None:
    """Draw the grey picture and set the limits of a panel, in pixels of the uncropped picture.

    Parameters
    ----------
    axes : Axes
    view : FlowView
    """
    left, top = view.low - 0.5
    below, right = np.array(view.grey.shape) * view.stride + (top, left)
    axes.imshow(
        view.grey, cmap="gray", vmin=GREYS[0], vmax=GREYS[1], extent=(left, right, below, top),
        interpolation="antialiased",
    )  # fmt: skip
    axes.set(xlim=(left, view.high[0] - 0.5), ylim=(view.high[1] - 0.5, top))


def draw_points(
    axes: Axes, flow: RangeFlow, values: PointScalars, cmap: str | ListedColormap, norm: Normalize
) -> None:
    """Draw values at the points of a flow, each as a square around its point.

    Parameters
    ----------
    axes : Axes
    flow : RangeFlow                n points
    values : (n,) float             NaN: not drawn
    cmap, norm                      colour map and scale
    """
    if len(flow.pixel) == 0:
        return
    first = flow.pixel.min(axis=0)
    column, row = np.rint((flow.pixel - first) / flow.step).astype(np.int64).T
    grid = np.full((row.max() + 1, column.max() + 1), np.nan)
    grid[row, column] = values
    left, top = first - 0.5 * flow.step
    below, right = np.array(grid.shape) * flow.step + (top, left)
    axes.imshow(
        grid, cmap=cmap, norm=norm, alpha=OPACITY, extent=(left, right, below, top),
        interpolation="nearest",
    )  # fmt: skip


def draw_vertices(
    axes: Axes, vertices: VertexDisplacement | None, view: FlowView, cmap: str, norm: Normalize
) -> None:
    """Draw the mesh as seen by the camera: grey, and coloured by displacement where measured.

    Triangles with three measured vertices are coloured; measured vertices are also drawn as dots.

    Parameters
    ----------
    axes : Axes
    vertices : VertexDisplacement or None
    view : FlowView
    cmap, norm                      colour map and scale of the lengths
    """
    rows, mesh = seen_corners(view), view.mesh
    place, corners = project(view.camera, mesh.vertices[rows]), mesh.triangles[view.triangles]
    right, below, into = view.camera.T_camera_object[:3, :3]
    toward = LIGHT[0] * right - LIGHT[1] * below - LIGHT[2] * into
    light = unit_normals(mesh)[view.triangles] @ (toward / np.linalg.norm(toward))
    colours = CLAY(np.clip(light, 0.0, 1.0))
    local = np.searchsorted(rows, corners)
    polygons = cast(Any, place[local])
    axes.add_collection(
        PolyCollection(polygons, facecolors=colours, edgecolors=colours, linewidths=0.8),
        autolim=False,
    )
    if vertices is None:
        return
    across, down = place.T
    known = measured_vertices(vertices)[rows]
    length = np.linalg.norm(vertices.displacement[rows], axis=1)
    whole = known[local].all(axis=1)
    if whole.any():
        shape = Triangulation(across, down, local[whole])
        values = np.nan_to_num(length)
        axes.tripcolor(shape, values, cmap=cmap, norm=norm, shading="gouraud")
    size = float(np.clip(1500.0 / max(known.sum(), 1), 2.0, 9.0))
    axes.scatter(
        across[known], down[known], c=length[known], s=size, cmap=cmap, norm=norm, linewidths=0.3,
        edgecolors=INK, zorder=2,
    )  # fmt: skip

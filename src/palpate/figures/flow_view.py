"""What the reference camera sees of the object, as coloured pixels under a plot."""

from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgb
from scipy.ndimage import map_coordinates

from palpate.figures.style import LIGHT
from palpate.geometry import TriangleMesh, unit_normals
from palpate.records import Camera
from palpate.shapes import Indices, PointScalars
from palpate.vision import RangeFlow, SurfaceMap, VertexDisplacement, measured_vertices

MARGIN = 0.05  # of the object's size in the picture
MAX_PIXELS = 700  # along a side of a panel; a page shows no more
# Grey level of an uncoloured pixel, and share of a colour, from black to white texture.
UNCOLOURED = (0.12, 0.88)
COLOURED = (0.80, 1.0)
CLAY = LinearSegmentedColormap.from_list("clay", ["#6f7379", "#d4d7db"])

Image = Float[np.ndarray, "rows columns"]
Colours = UInt8[np.ndarray, "rows columns 3"]


@dataclass(frozen=True, slots=True, eq=False)
class FlowView:
    """The part of the reference picture that shows the object, and the surface behind it.

    Attributes
    ----------
    camera : Camera                 the reference camera
    mesh : TriangleMesh
    low, high : (2,) int [px]       first and last + 1 column and row
    stride : int [px]               spacing of the pixels that are shown
    grey : (rows, columns) float    of these pixels, 0 black to 1 white
    point : (rows, columns, 3) float [m]    surface behind each of them, NaN: none
    triangle : (rows, columns) int  -1: none
    """

    camera: Camera
    mesh: TriangleMesh
    low: Int[np.ndarray, "2"]
    high: Int[np.ndarray, "2"]
    stride: int
    grey: Image
    point: Float[np.ndarray, "rows columns 3"]
    triangle: Int[np.ndarray, "rows columns"]


def make_flow_view(
    picture: Image, camera: Camera, surface: SurfaceMap, mesh: TriangleMesh
) -> FlowView:
    """Cut the object out of a picture; all of it is kept where the object is not in view.

    Parameters
    ----------
    picture : (rows, columns) float [grey levels]   first instant, reference camera
    camera : Camera                 the reference camera
    surface : SurfaceMap            of that camera
    mesh : TriangleMesh
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
    shown, triangle = picture[part].astype(np.float64), surface.triangle[part]
    seen = triangle >= 0
    black, white = np.quantile(shown[seen] if seen.any() else shown, [0.01, 0.99])
    grey = np.clip((shown - black) / max(white - black, 1.0), 0.0, 1.0)
    point = surface.point[part].astype(np.float64)
    return FlowView(camera, mesh, low, high, stride, grey, point, triangle)


def in_view(view: FlowView) -> Indices:
    """Vertices of the triangles that are seen, (k,) int."""
    return np.unique(view.mesh.triangles[view.triangle[view.triangle >= 0]])


def interpolated(flow: RangeFlow, values: PointScalars, view: FlowView) -> Image:
    """Values of the points of a range flow, linear between them, at the pixels of a view.

    Only pixels of the surface within half a step of a point with a value get one: gaps stay.

    Parameters
    ----------
    flow : RangeFlow                points on a grid of its step
    values : (n,) float             NaN: not shown
    view : FlowView
    """
    known = np.isfinite(values)
    node, size = _grid_nodes(flow)
    weight, total = np.zeros(size), np.zeros(size)
    np.add.at(weight, tuple(node[known].T), 1.0)
    np.add.at(total, tuple(node[known].T), values[known])
    shown, place = _places(flow, view)
    share = map_coordinates(weight, place, order=1, mode="grid-constant")
    sums = map_coordinates(total, place, order=1, mode="grid-constant")
    near = map_coordinates(weight, np.rint(place), order=0, mode="constant") > 0.0
    image = np.full(shown.shape, np.nan)
    image[shown] = np.where(near, sums / np.where(near, share, 1.0), np.nan)
    return image


def _grid_nodes(flow: RangeFlow) -> tuple[Int[np.ndarray, "n 2"], tuple[int, int]]:
    """Row and column of each point in the grid of all points, and the size of that grid."""
    if len(flow.pixel) == 0:
        return np.zeros((0, 2), dtype=np.int64), (1, 1)
    from_first = flow.pixel[:, ::-1] - flow.pixel[:, ::-1].min(axis=0)
    node = np.rint(from_first / flow.step).astype(np.int64)
    return node, (int(node[:, 0].max()) + 1, int(node[:, 1].max()) + 1)


def _places(
    flow: RangeFlow, view: FlowView
) -> tuple[Bool[np.ndarray, "rows columns"], Float[np.ndarray, "2 k"]]:
    """Pixels of a view that show the surface, and where they are in the grid of the points."""
    shown = view.triangle >= 0
    first = flow.pixel.min(axis=0) if len(flow.pixel) else np.zeros(2)
    pixel = view.low + view.stride * np.argwhere(shown)[:, ::-1]
    return shown, ((pixel - first) / flow.step).T[::-1]


def tinted(values: Image, view: FlowView, cmap: str, norm: Normalize) -> Colours:
    """Values as colours shaded by the picture's texture; the grey picture where there is none."""
    colours = mpl.colormaps[cmap](norm(np.nan_to_num(values)))[..., :3]
    return _over_picture(colours, np.isfinite(values), view)


def cause_layer(flow: RangeFlow, view: FlowView, colours: dict[int, str]) -> Colours:
    """Squares in the colour of an outcome around points; the grey picture elsewhere."""
    node, size = _grid_nodes(flow)
    outcome = np.full(size, -1)
    outcome[tuple(node.T)] = flow.outcome
    shown, place = _places(flow, view)
    found = np.full(shown.shape, -1)
    found[shown] = map_coordinates(outcome, np.rint(place), order=0, mode="constant", cval=-1)
    image = np.zeros((*shown.shape, 3))
    for cause, colour in colours.items():
        image[found == cause] = to_rgb(colour)
    return _over_picture(image, np.isin(found, list(colours)), view)


def vertex_layer(
    vertices: VertexDisplacement | None, view: FlowView, cmap: str, norm: Normalize
) -> Colours:
    """The mesh as the camera sees it, coloured by the displacement's length; unmeasured grey."""
    seen = view.triangle >= 0
    triangle = view.triangle[seen]
    length = np.full(len(view.mesh.vertices), np.nan)
    if vertices is not None:
        known = measured_vertices(vertices)
        length[known] = np.linalg.norm(vertices.displacement[known], axis=1)
    weight = _barycentric(view.mesh, triangle, view.point[seen])
    value = np.einsum("pa,pa->p", weight, length[view.mesh.triangles[triangle]])
    right, down, into = view.camera.T_camera_object[:3, :3]
    toward = LIGHT[0] * right - LIGHT[1] * down - LIGHT[2] * into
    light = unit_normals(view.mesh)[triangle] @ (toward / np.linalg.norm(toward))
    light = np.clip(light, 0.0, 1.0)[:, None]
    coloured = mpl.colormaps[cmap](norm(np.nan_to_num(value)))[:, :3] * (0.78 + 0.22 * light)
    image = _over_picture(np.zeros((*seen.shape, 3)), np.zeros_like(seen), view)
    clay = CLAY(light[:, 0])[:, :3]
    image[seen] = _bytes(np.where(np.isfinite(value)[:, None], coloured, clay))
    return image


def _barycentric(
    mesh: TriangleMesh, triangle: Int[np.ndarray, " n"], point: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Weights of the corners of a triangle each at points in its plane."""
    a, b, c = mesh.vertices[mesh.triangles[triangle]].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    size = np.einsum("na,na->n", normal, normal)
    first = np.einsum("na,na->n", np.cross(c - b, point - b), normal) / size
    second = np.einsum("na,na->n", np.cross(a - c, point - c), normal) / size
    return np.stack([first, second, 1.0 - first - second], axis=1)


def _over_picture(
    colours: Float[np.ndarray, "rows columns 3"],
    coloured: Bool[np.ndarray, "rows columns"],
    view: FlowView,
) -> Colours:
    """Colours with the texture showing faintly; the grey picture in full contrast elsewhere."""
    grey = view.grey[..., None]
    shaded = colours * (COLOURED[0] + (COLOURED[1] - COLOURED[0]) * grey)
    plain = UNCOLOURED[0] + (UNCOLOURED[1] - UNCOLOURED[0]) * grey
    return _bytes(np.where(coloured[..., None], shaded, plain))


def _bytes(colours: Float[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape"]:
    return np.rint(255.0 * np.clip(colours, 0.0, 1.0)).astype(np.uint8)

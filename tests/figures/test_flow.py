"""Pictures of measured motions: what is coloured, how, where, and what the texts say."""

import struct
from dataclasses import fields, replace

import numpy as np
import pytest
from flow_samples import SHAPE, SIDE, STEP, camera, motion, sample
from matplotlib.colors import Normalize, to_hex
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

from palpate.figures.flow import (
    CAUSE_COLOURS,
    CLAY,
    draw_picture,
    draw_points,
    draw_vertices,
    flow_figure,
    make_flow_view,
    quality_figure,
    seen_corners,
    write_flow_pictures,
)
from palpate.geometry import TriangleMesh
from palpate.pipeline import MeasuredMotion
from palpate.vision import Outcome, SurfaceMap

REJECT = {Outcome.SCORE: [100, 101, 102], Outcome.TEXTURE: [7]}


@pytest.fixture(scope="module")
def cube():
    return sample(reject=REJECT)


@pytest.fixture(scope="module")
def view(cube):
    return make_flow_view(cube.picture, cube.camera, cube.surface, cube.mesh)


def png_size(path):
    """Width and height [pixel] from the file's head."""
    data = path.read_bytes()
    assert data.startswith(b"\x89PNG")
    return struct.unpack(">II", data[16:24])


def texts(figure):
    """Everything that is written in a figure."""
    inside = [text.get_text() for text in figure.texts]
    for axes in figure.axes:
        inside += [axes.get_xlabel(), *(text.get_text() for text in axes.texts)]
    for legend in figure.legends:
        inside += [text.get_text() for text in legend.get_texts()]
    return inside


def arrows(axes):
    """The arrows of a panel: places and components in pixels."""
    (quiver,) = (item for item in axes.collections if isinstance(item, Quiver))
    return np.asarray(quiver.XY), np.stack([quiver.U, quiver.V], axis=1)


# What is shown


def test_the_view_is_the_object_with_a_margin(view, cube):
    rows, columns = np.nonzero(cube.surface.triangle >= 0)
    assert (view.low < [columns.min(), rows.min()]).all()
    assert (view.high > [columns.max() + 1, rows.max() + 1]).all()
    # A margin of 5 per cent and two pixels, each side.
    assert (view.high - view.low <= 1.1 * np.ptp(columns) + 7).all()
    assert view.stride == 1
    seen = np.unique(cube.surface.triangle[cube.surface.triangle >= 0])
    np.testing.assert_array_equal(np.sort(view.triangles), seen)
    assert view.grey.min() == 0.0
    assert view.grey.max() == 1.0


def test_a_large_picture_is_thinned(cube):
    times = 10
    large = SurfaceMap(
        *(np.repeat(np.repeat(part, times, 0), times, 1) for part in
          (cube.surface.point, cube.surface.triangle))
    )  # fmt: skip
    picture = np.repeat(np.repeat(cube.picture, times, 0), times, 1)
    view = make_flow_view(picture, cube.camera, large, cube.mesh)
    assert view.stride == 2
    assert max(view.grey.shape) <= 700


def test_an_object_out_of_view_leaves_the_whole_picture(cube):
    nothing = SurfaceMap(np.full((*SHAPE, 3), np.nan), np.full(SHAPE, -1))
    view = make_flow_view(cube.picture, cube.camera, nothing, cube.mesh)
    assert view.grey.shape == SHAPE
    assert len(view.triangles) == len(seen_corners(view)) == 0


def test_the_nearest_triangle_is_drawn_last():
    """Two triangles one behind the other, both seen in some pixel."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0.01], [1, 0, 0.01], [0, 1, 0.01]])
    mesh = TriangleMesh(0.04 * vertices, np.array([[3, 4, 5], [0, 1, 2]]))
    triangle = np.full(SHAPE, -1)
    triangle[10, 10], triangle[20, 20] = 0, 1
    surface = SurfaceMap(np.full((*SHAPE, 3), np.nan), triangle)
    view = make_flow_view(np.zeros(SHAPE), camera(), surface, mesh)
    # The camera looks down: the one with the greater z is nearer.
    assert view.triangles.tolist() == [1, 0]


@pytest.fixture
def axes():
    return Figure().subplots()


@pytest.mark.parametrize("stride", [1, 3])
def test_pixels_are_drawn_at_their_places(view, axes, stride):
    draw_picture(axes, replace(view, stride=stride, grey=view.grey[::stride, ::stride]))
    (left, right, below, top), size = axes.images[0].get_extent(), axes.images[0].get_size()
    # The first pixel's centre is its place in the whole picture, and so is the last one's.
    assert (left + 0.5, top + 0.5) == tuple(view.low)
    assert (right - left, below - top) == (stride * size[1], stride * size[0])
    # Rows count downwards.
    assert axes.get_ylim()[0] > axes.get_ylim()[1]
    assert axes.get_xlim() == (view.low[0] - 0.5, view.high[0] - 0.5)


def test_a_value_is_a_square_around_its_point(cube, axes):
    values = np.arange(len(cube.flow.pixel), dtype=float)
    values[101] = np.nan
    draw_points(axes, cube.flow, values, "viridis", Normalize(0.0, 1.0))
    (image,) = axes.images
    left, _, _, top = image.get_extent()
    grid = np.asarray(image.get_array().filled(np.nan))
    for k in (0, 100, 101, 300, 624):
        column, row = ((cube.flow.pixel[k] - (left, top)) / STEP - 0.5).astype(int)
        np.testing.assert_array_equal(grid[row, column], values[k])
    assert np.isfinite(grid).sum() == len(values) - 1
    right, below = cube.flow.pixel.max(axis=0) + 0.5 * STEP
    assert image.get_extent()[1:3] == [right, below]


def test_a_flow_without_points_leaves_the_picture_alone(cube, axes):
    count = len(cube.flow.pixel)
    values = {field.name: getattr(cube.flow, field.name) for field in fields(cube.flow)}
    nothing = replace(
        cube.flow,
        **{name: v[:0] for name, v in values.items() if np.ndim(v) and len(v) == count},
    )
    draw_points(axes, nothing, np.zeros(0), "viridis", Normalize(0.0, 1.0))
    assert not axes.images


def test_triangles_are_coloured_where_all_their_vertices_were_measured(view, cube, axes):
    norm = Normalize(0.0, 3e-4)
    draw_vertices(axes, cube.vertices, view, "viridis", norm)
    clay, coloured, dots = axes.collections
    known = np.isfinite(cube.vertices.displacement[:, 0])
    whole = known[cube.mesh.triangles[view.triangles]].all(axis=1)
    assert 0 < whole.sum() < len(view.triangles)
    assert len(clay.get_paths()) == len(view.triangles)
    assert len(coloured._triangulation.triangles) == whole.sum()
    # Dots: every measured vertex that is seen, at its place and in the colour of its length.
    rows = seen_corners(view)
    rows = rows[known[rows]]
    column = 79.5 + (cube.mesh.vertices[rows, 0] - 0.5 * SIDE) * 1000.0 / 0.4
    np.testing.assert_allclose(np.asarray(dots.get_offsets())[:, 0], column, atol=1e-9)
    length = motion(cube.mesh.vertices[rows])[:, 0]
    np.testing.assert_allclose(dots.get_array(), length, rtol=1e-12)
    np.testing.assert_allclose(np.sort(coloured.get_array()[coloured.get_array() > 0]),
                               np.sort(length), rtol=1e-12)  # fmt: skip


def test_without_vertices_the_mesh_is_grey(view, axes):
    draw_vertices(axes, None, view, "viridis", Normalize(0.0, 1.0))
    (clay,) = axes.collections
    colours = clay.get_facecolor()[:, :3]
    assert np.ptp(colours, axis=1).max() < 15.0 / 255.0
    # The face is flat: one brightness all over, from the light's cosine of 0.7 / 0.9975.
    np.testing.assert_allclose(colours, CLAY([0.7 / 0.9975])[:, :3].repeat(len(colours), 0))


# Figures


@pytest.mark.parametrize(
    ("along", "expected"), [((1.0, 0.0, 0.0), (1.0, 0.0)), ((0.0, 1.0, 0.0), (0.0, -1.0))]
)
def test_arrows_are_the_optical_flow_times_the_factor_that_is_told(along, expected):
    sampled = sample(along=along)
    view = make_flow_view(sampled.picture, sampled.camera, sampled.surface, sampled.mesh)
    figure = flow_figure("n01", sampled.flow, sampled.vertices, view)
    pixel, vector = arrows(figure.axes[0])
    at = 0.5 * SIDE + (pixel[:, :1] - 79.5) * 0.4e-3
    # 2.5 pixels a millimetre; y of the object is up in the picture, rows count down.
    true = 2500.0 * motion(at)[:, :1] * expected
    ratio = (vector * true).sum(axis=1) / (true * true).sum(axis=1)
    np.testing.assert_allclose(ratio, ratio[0])
    np.testing.assert_allclose(vector, ratio[0] * true, atol=1e-9)
    said = next(text for text in texts(figure) if "arrows" in text)
    # Two digits are told.
    assert float(said.split("arrows: ")[1].split(" times")[0]) == pytest.approx(ratio[0], rel=0.05)
    assert figure.axes[0].get_ylim()[0] > figure.axes[0].get_ylim()[1]


def test_arrows_in_space_are_seen_in_perspective():
    sampled = sample(along=(0.3, 0.0, 0.95))
    view = make_flow_view(sampled.picture, sampled.camera, sampled.surface, sampled.mesh)
    figure = flow_figure("n01", sampled.flow, None, view)
    pixel, vector = arrows(figure.axes[1])
    said = next(text for text in texts(figure) if "arrows" in text)
    times = float(said.split(", ")[1].split(" times")[0])
    point = np.column_stack([0.5 * SIDE + (pixel - [79.5, 59.5]) * [0.4e-3, -0.4e-3], 0 * pixel])
    moved = times * motion(point[:, :3], (0.3, 0.0, 0.95))
    # Nearer to the camera by `moved`, farther from the middle of the picture by similar triangles.
    offset = point[:, :2] - 0.5 * SIDE + moved[:, :2]
    tip = 1000.0 * offset / (0.4 - moved[:, 2:]) * [1.0, -1.0] + [79.5, 59.5]
    assert len(pixel) > 10
    # Two digits of the factor are told.
    np.testing.assert_allclose(vector, tip - pixel, rtol=0.06, atol=0.06)


def test_arrows_of_the_optical_flow_have_their_own_factor():
    sampled = sample(along=(0.3, 0.0, 0.95))
    view = make_flow_view(sampled.picture, sampled.camera, sampled.surface, sampled.mesh)
    figure = flow_figure("n01", sampled.flow, None, view)
    pixel, vector = arrows(figure.axes[0])
    said = next(text for text in texts(figure) if "arrows" in text)
    times = float(said.split("arrows: ")[1].split(" times")[0])
    point = np.column_stack([0.5 * SIDE + (pixel - [79.5, 59.5]) * [0.4e-3, -0.4e-3], 0 * pixel])
    moved = motion(point[:, :3], (0.3, 0.0, 0.95))
    offset = point[:, :2] - 0.5 * SIDE + moved[:, :2]
    tip = 1000.0 * offset / (0.4 - moved[:, 2:]) * [1.0, -1.0] + [79.5, 59.5]
    # Two digits of the factor are told.
    np.testing.assert_allclose(vector, times * (tip - pixel), rtol=0.06, atol=0.06)


def test_an_arrow_is_as_long_as_an_eighth_of_the_panel(cube, view):
    _, vector = arrows(flow_figure("n01", cube.flow, None, view).axes[0])
    longest = np.linalg.norm(vector, axis=1).max() / (view.high - view.low).max()
    # One in twenty is longer than 0.12; this field grows evenly, so not by much.
    assert 0.11 < longest < 0.13


def test_few_long_motions_do_not_cross_the_panel(view):
    sampled = sample()
    moved = sampled.flow.displacement.copy()
    # One in forty moves thirty times as far: some of those that have an arrow.
    drawn, _ = arrows(flow_figure("n01", sampled.flow, None, view).axes[0])
    nearest = np.linalg.norm(sampled.flow.pixel[:, None] - drawn, axis=2).argmin(axis=0)
    moved[nearest[: len(moved) // 40]] *= 30.0
    _, vector = arrows(
        flow_figure("n01", replace(sampled.flow, displacement=moved), None, view).axes[0]
    )
    longest = np.linalg.norm(vector, axis=1).max() / (view.high - view.low).max()
    # All but one in two hundred are shorter than 0.2.
    assert 0.12 < longest < 0.25


def test_colours_are_on_a_square_root_scale(cube, view):
    figure = flow_figure("n01", cube.flow, None, view)
    image = figure.axes[1].images[1]
    top = np.nanquantile(np.linalg.norm(cube.flow.displacement, axis=1), 0.99)
    length = motion(cube.flow.point[300:301])[0, 0]
    assert float(image.norm(length)) == pytest.approx(np.sqrt(length / top), rel=1e-9)
    assert length in np.asarray(image.get_array())


def test_causes_have_their_colours(cube, view):
    image = quality_figure("n01", cube.flow, view).axes[0].images[1]
    grid = image.get_array()
    numbers = np.asarray(grid[~grid.mask])
    # One point without texture, three that look different.
    colours = [to_hex(image.cmap(image.norm(number))) for number in np.sort(numbers)]
    score, texture = CAUSE_COLOURS[Outcome.SCORE], CAUSE_COLOURS[Outcome.TEXTURE]
    assert colours == [texture.lower(), *[score.lower()] * 3]


def test_the_figure_says_what_it_shows_and_in_which_unit(cube, view):
    said = texts(flow_figure("n01", cube.flow, cube.vertices, view))
    count = len(cube.flow.outcome)
    assert f"n01: {count - 4} of {count} points valid, 25 of 49 vertices measured" in said
    assert {"2-D optical flow in c0", "range flow", "displacement of the vertices"} <= set(said)
    assert {"motion in the picture (px)", "displacement $|u|$ (mm)"} <= set(said)
    assert "grey: 4 points rejected, or nothing measured" in said


def test_the_quality_figure_says_causes_and_sigmas(cube, view):
    said = texts(quality_figure("n01", cube.flow, view))
    assert {"texture 1", "score 3"} <= set(said)
    assert not any("hidden" in text for text in said)
    assert {"of one point (µm), median 3.54", "of one point (µm), median 20"} <= set(said)
    assert "window of 13 px, a point every 4 px" in said


def test_the_colour_bar_ends_where_all_but_one_in_hundred_are(cube, view):
    figure = flow_figure("n01", cube.flow, cube.vertices, view)
    length = np.linalg.norm(cube.flow.displacement, axis=1)
    top = np.quantile(length[np.isfinite(length)], 0.99)
    assert figure.axes[-1].get_xlim() == pytest.approx((0.0, 1e3 * top))


def measured(name, flow, vertices=None):
    return MeasuredMotion(name, "n01", True, np.zeros((1, 1)), flow, vertices, None)


def test_nothing_is_drawn_where_nothing_was_measured(view, tmp_path):
    assert write_flow_pictures(tmp_path, "a", measured("a", None), view) == {}
    assert list(tmp_path.iterdir()) == []


def test_both_pictures_are_written(cube, view, tmp_path):
    names = write_flow_pictures(tmp_path, "n01", measured("n01", cube.flow, cube.vertices), view)
    assert names == {"picture": "n01.png", "quality": "n01_quality.png"}
    for name in names.values():
        width, height = png_size(tmp_path / name)
        # Wide enough to read, small enough for a page.
        assert 1000 <= width <= 1600
        assert 250 <= height <= 900


def test_nothing_valid_is_said_and_can_be_drawn(view, tmp_path):
    count = len(sample().flow.point)
    blind = sample(reject={Outcome.TEXTURE: np.arange(count)})
    said = texts(flow_figure("n01", blind.flow, None, view))
    assert said.count("nothing was measured") == 2
    assert not any("arrows" in text for text in said)
    assert write_flow_pictures(tmp_path, "a", measured("a", blind.flow), view)


def test_an_object_that_did_not_move_can_be_drawn(view, tmp_path):
    still = sample()
    flow = replace(still.flow, displacement=np.zeros_like(still.flow.displacement))
    assert write_flow_pictures(tmp_path, "a", measured("a", flow), view)


def test_a_name_with_dollars_is_not_mathematics(cube, view, tmp_path):
    assert write_flow_pictures(tmp_path, "a", measured("cost $x^ and_$", cube.flow), view)


def test_a_folder_that_is_not_there_is_an_error(cube, view, tmp_path):
    with pytest.raises(OSError, match="none"):
        write_flow_pictures(tmp_path / "none", "a", measured("a", cube.flow), view)


def test_the_camera_of_the_samples_is_the_one_that_is_drawn(cube):
    assert cube.camera.name == camera().name == "c0"

"""Pictures of measured motions: what is coloured, how, where, and what the texts say."""

import struct
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from flow_samples import SHAPE, SIDE, STEP, camera, motion, sample
from matplotlib.colors import Normalize
from matplotlib.quiver import Quiver

from palpate.figures.flow import flow_figure, quality_figure, write_flow_pictures
from palpate.figures.flow_view import (
    COLOURED,
    UNCOLOURED,
    cause_layer,
    interpolated,
    make_flow_view,
    tinted,
    vertex_layer,
)
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
    (found,) = (item for item in axes.collections if isinstance(item, Quiver))
    return np.asarray(found.XY), np.stack([found.U, found.V], axis=1)


# What is shown


def test_the_view_is_the_object_with_a_margin(view, cube):
    rows, columns = np.nonzero(cube.surface.triangle >= 0)
    assert (view.low < [columns.min(), rows.min()]).all()
    assert (view.high > [columns.max() + 1, rows.max() + 1]).all()
    # A margin of 5 per cent and two pixels, each side.
    assert (view.high - view.low <= 1.1 * np.ptp(columns) + 7).all()
    assert view.stride == 1
    assert (view.triangle >= 0).sum() == len(rows)
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
    assert np.isnan(interpolated(cube.flow, cube.flow.score, view)).all()


@pytest.mark.parametrize("stride", [1, 3])
def test_values_are_linear_between_points(view, cube, stride):
    thinned = replace(
        view, stride=stride, grey=view.grey[::stride, ::stride],
        point=view.point[::stride, ::stride], triangle=view.triangle[::stride, ::stride],
    )  # fmt: skip
    values = 0.3 + 0.02 * cube.flow.pixel[:, 0] - 0.05 * cube.flow.pixel[:, 1]
    image = interpolated(cube.flow, values, thinned)
    row, column = np.indices(image.shape) * stride
    place = np.stack([column, row], axis=2) + view.low
    inner = ((place >= cube.flow.pixel.min(axis=0)) & (place <= cube.flow.pixel.max(axis=0))).all(2)
    assert inner.sum() > 5000 / stride**2
    expected = 0.3 + 0.02 * place[..., 0] - 0.05 * place[..., 1]
    # Rounding of sums of four terms.
    np.testing.assert_allclose(image[inner], expected[inner], rtol=0, atol=1e-12)


def test_nothing_is_shown_around_a_point_without_a_value(view, cube):
    image = interpolated(cube.flow, cube.flow.displacement[:, 0], view)
    column, row = (cube.flow.pixel[101] - view.low).astype(int)
    assert np.isnan(image[row - 1 : row + 2, column - 1 : column + 2]).all()
    assert np.isfinite(image[row + STEP, column])
    assert np.isnan(image[view.triangle < 0]).all()


def test_colours_are_the_maps_with_the_texture_over_them(view):
    values = np.where(view.triangle >= 0, 0.25, np.nan)
    image = tinted(values, view, "viridis", Normalize(0.0, 1.0)).astype(float) / 255.0
    there = view.triangle >= 0
    share = COLOURED[0] + (COLOURED[1] - COLOURED[0]) * view.grey[there]
    pure = np.array(mpl.colormaps["viridis"](0.25)[:3])
    # A byte has 1/255, half of it is lost in rounding.
    np.testing.assert_allclose(image[there], share[:, None] * pure, rtol=0, atol=0.5 / 255 + 1e-9)
    outside = image[~there]
    assert np.ptp(outside, axis=1).max() == 0.0
    assert outside.min() >= UNCOLOURED[0] - 0.5 / 255


def test_vertices_are_coloured_by_their_length_between_them(view, cube):
    norm = Normalize(0.0, 3e-4)
    image = vertex_layer(cube.vertices, view, "viridis", norm).astype(float)
    # Triangles with three measured vertices: the face less two of its six strips on every side.
    known = np.isfinite(cube.vertices.displacement[:, 0])
    whole = known[cube.mesh.triangles].all(axis=1)
    there = (view.triangle >= 0) & whole[view.triangle]
    assert 3000 < there.sum() < (view.triangle >= 0).sum()
    length = motion(view.point[there])[:, 0]
    expected = 255.0 * mpl.colormaps["viridis"](norm(length))[:, :3]
    light = image[there] / expected
    # The face is flat: one brightness all over, and two half bytes of rounding a channel.
    brightness = np.median(light)
    # It faces the camera, the light comes from (-0.45, 0.55, 0.7): a fifth of shade, times cosine.
    assert brightness == pytest.approx(0.78 + 0.22 * 0.7 / 0.9975, abs=0.01)
    np.testing.assert_allclose(image[there], brightness * expected, rtol=0, atol=2.0)
    clay = image[(view.triangle >= 0) & ~there]
    assert np.ptp(clay, axis=1).max() < 15.0


def test_causes_have_their_colours(view, cube):
    image = cause_layer(cube.flow, view, {int(Outcome.SCORE): "#ff0000"})
    column, row = (cube.flow.pixel[[101, 7, 300]] - view.low).astype(int).T
    score, texture, valid = image[row, column].astype(int)
    assert score[0] > 200
    assert score[1] == score[2] == 0
    assert np.ptp(texture) == np.ptp(valid) == 0


# Figures


@pytest.mark.parametrize(
    ("along", "expected"), [((1.0, 0.0, 0.0), (1.0, 0.0)), ((0.0, 1.0, 0.0), (0.0, -1.0))]
)
def test_arrows_are_the_optical_flow_times_the_factor_that_is_told(along, expected):
    one = sample(along=along)
    view = make_flow_view(one.picture, one.camera, one.surface, one.mesh)
    figure = flow_figure("n01", one.flow, one.vertices, view)
    place, vector = arrows(figure.axes[0])
    at = 0.5 * SIDE + (place[:, :1] - 79.5) * 0.4e-3
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
    one = sample(along=(0.3, 0.0, 0.95))
    view = make_flow_view(one.picture, one.camera, one.surface, one.mesh)
    figure = flow_figure("n01", one.flow, None, view)
    place, vector = arrows(figure.axes[1])
    said = next(text for text in texts(figure) if "arrows" in text)
    times = float(said.split(", ")[1].split(" times")[0])
    point = np.column_stack([0.5 * SIDE + (place - [79.5, 59.5]) * [0.4e-3, -0.4e-3], 0 * place])
    moved = times * motion(point[:, :3], (0.3, 0.0, 0.95))
    # Nearer to the camera by `moved`, farther from the middle of the picture by similar triangles.
    offset = point[:, :2] - 0.5 * SIDE + moved[:, :2]
    tip = 1000.0 * offset / (0.4 - moved[:, 2:]) * [1.0, -1.0] + [79.5, 59.5]
    assert len(place) > 10
    # Two digits of the factor are told.
    np.testing.assert_allclose(vector, tip - place, rtol=0.06, atol=0.06)


def test_arrows_of_the_optical_flow_have_their_own_factor():
    one = sample(along=(0.3, 0.0, 0.95))
    view = make_flow_view(one.picture, one.camera, one.surface, one.mesh)
    figure = flow_figure("n01", one.flow, None, view)
    place, vector = arrows(figure.axes[0])
    said = next(text for text in texts(figure) if "arrows" in text)
    times = float(said.split("arrows: ")[1].split(" times")[0])
    point = np.column_stack([0.5 * SIDE + (place - [79.5, 59.5]) * [0.4e-3, -0.4e-3], 0 * place])
    moved = motion(point[:, :3], (0.3, 0.0, 0.95))
    offset = point[:, :2] - 0.5 * SIDE + moved[:, :2]
    tip = 1000.0 * offset / (0.4 - moved[:, 2:]) * [1.0, -1.0] + [79.5, 59.5]
    # Two digits of the factor are told.
    np.testing.assert_allclose(vector, times * (tip - place), rtol=0.06, atol=0.06)


def test_an_arrow_is_as_long_as_an_eighth_of_the_panel(cube, view):
    _, vector = arrows(flow_figure("n01", cube.flow, None, view).axes[0])
    longest = np.linalg.norm(vector, axis=1).max() / (view.high - view.low).max()
    # One in twenty is longer than 0.12; this field grows evenly, so not by much.
    assert 0.11 < longest < 0.13


def test_few_long_motions_do_not_cross_the_panel(view):
    one = sample()
    moved = one.flow.displacement.copy()
    # One in forty, spread over the face, moves thirty times as far.
    moved[::40] *= 30.0
    _, vector = arrows(
        flow_figure("n01", replace(one.flow, displacement=moved), None, view).axes[0]
    )
    longest = np.linalg.norm(vector, axis=1).max() / (view.high - view.low).max()
    # All but one in two hundred are shorter than 0.2.
    assert 0.12 < longest < 0.25


def test_colours_are_on_a_square_root_scale(cube, view):
    figure = flow_figure("n01", cube.flow, None, view)
    colours = np.asarray(figure.axes[1].images[0].get_array()).astype(float)
    top = np.nanquantile(np.linalg.norm(cube.flow.displacement, axis=1), 0.99)
    column, row = (cube.flow.pixel[300] - view.low).astype(int)
    share = np.sqrt(motion(cube.flow.point[300:301])[0, 0] / top)
    texture = COLOURED[0] + (COLOURED[1] - COLOURED[0]) * view.grey[row, column]
    expected = 255.0 * texture * np.array(mpl.colormaps["viridis"](share)[:3])
    # One of 256 colours of the map, and rounding to a byte.
    np.testing.assert_allclose(colours[row, column], expected, rtol=0, atol=3.0)


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


def test_both_pictures_are_written(cube, view, tmp_path):
    names = write_flow_pictures(tmp_path, "n01", "n01", cube.flow, cube.vertices, view)
    assert names == ("n01.png", "n01_quality.png")
    for name in names:
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
    assert write_flow_pictures(tmp_path, "a", "a", blind.flow, None, view)


def test_an_object_that_did_not_move_can_be_drawn(view, tmp_path):
    still = sample()
    flow = replace(still.flow, displacement=np.zeros_like(still.flow.displacement))
    assert write_flow_pictures(tmp_path, "a", "a", flow, None, view)


def test_a_name_with_dollars_is_not_mathematics(cube, view, tmp_path):
    assert write_flow_pictures(tmp_path, "a", "cost $x^ and_$", cube.flow, None, view)


def test_a_folder_that_is_not_there_is_an_error(cube, view, tmp_path):
    with pytest.raises(OSError, match="none"):
        write_flow_pictures(tmp_path / "none", "a", "a", cube.flow, None, view)


def test_the_camera_of_the_samples_is_the_one_that_is_drawn(cube):
    assert cube.camera.name == camera().name == "c0"

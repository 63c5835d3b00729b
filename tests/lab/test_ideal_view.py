"""From a pinhole picture to a camera's, and its truth maps: closed forms, optical flow."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree
from surfaces import box, sphere
from vision_cameras import BARREL, RATIONAL, make_camera

from palpate.errors import CalibrationError, InputError
from palpate.geometry import TriangleMesh, read_mesh
from palpate.lab import Pictures
from palpate.lab.ideal_view import (
    FINE,
    IdealView,
    camera_picture,
    ideal_view,
    truth_map,
    write_truth_map,
)
from palpate.lab.render_mesh import make_render_mesh, speckle
from palpate.lab.scene import DrawnBody, Lamp, Light, choose_variant, render
from palpate.lab.studio import exposure_gain, grey_picture
from palpate.records import Camera, Rig, read_rig
from palpate.vision import normalised, project
from palpate.vision.projection import rays

SIZE = (120, 90)
RADIUS = 0.04
DISTANCE = 0.4
# A pixel is 0.4 mm wide at the middle of the object.
FOCAL = 1000.0
MAP_SIZE = (260, 240)


def _camera(lens=(), *, square=False):
    camera = make_camera(lens=lens, focal=130.0, size=SIZE, skew=0.0 if square else 0.4)
    matrix = camera.matrix.copy()
    matrix[:2, 2] = 58.7, 46.2
    if square:
        matrix[1, 1] = matrix[0, 0]
    return replace(camera, matrix=matrix)


def _points(camera, pixels):
    """Points 0.5 m behind pixels."""
    origin, direction = rays(camera, np.array(pixels, dtype=float))
    return origin + 0.5 * direction


def _whole(camera):
    """Points behind the corners of the picture and beyond."""
    columns, rows = camera.size
    return _points(camera, [[0, 0], [columns - 1, 0], [0, rows - 1], [columns - 1, rows - 1]])


def _waves(view):
    """A smooth pattern over the plane z = 1, as the pixels of a view average it."""
    row, column = np.mgrid[: view.shape[0], : view.shape[1]]
    x, y = (column - view.centre[0]) / view.focal, (row - view.centre[1]) / view.focal
    return _pattern(x, y, 1.0 / view.focal)


def _pattern(x, y, width):
    """0.5 + 0.4 sin(a x) sin(b y), averaged over squares: six pixels are a wave."""
    a, b = 2.0 * np.pi * 130.0 / 6.0 * np.array([1.0, 0.8])
    damping = np.sinc(a * width / (2 * np.pi)) * np.sinc(b * width / (2 * np.pi))
    return 0.5 + 0.4 * damping * np.sin(a * x) * np.sin(b * y)


@pytest.mark.parametrize("lens", [(), BARREL, RATIONAL])
def test_each_pixel_is_the_mean_over_its_own_area(lens):
    camera = _camera(lens)
    view = ideal_view(camera, _whole(camera))
    assert view.fine == FINE
    picture = camera_picture(camera, view, _waves(view).astype(np.float32))
    parts = 8
    offsets = (np.arange(parts) + 0.5) / parts - 0.5
    expected = np.zeros(picture.shape)
    row, column = np.mgrid[: SIZE[1], : SIZE[0]]
    for down in offsets:
        for right in offsets:
            pixels = np.stack([column.ravel() + right, row.ravel() + down], axis=1)
            x, y = normalised(camera, pixels).T
            expected += _pattern(x, y, 0.0).reshape(picture.shape)
    expected /= parts**2
    inner = (slice(6, -6), slice(6, -6))
    # Twelve fine pixels a wave: the cubic's error is (2 pi / 12)^3 / 20 of 0.4; where the lens
    # makes the fine pixels smaller or larger than half a pixel the blur differs by less.
    assert np.abs(picture - expected)[inner].max() < 5e-3
    slope = np.stack([np.gradient(expected, axis=1)[inner], np.gradient(expected, axis=0)[inner]])
    error = (picture - expected)[inner]
    shift = np.linalg.lstsq(slope.reshape(2, -1).T, error.ravel(), rcond=None)[0]
    assert np.abs(shift).max() < 2e-4


def test_a_pinhole_with_square_pixels_keeps_its_own_pixels():
    camera = _camera(square=True)
    points = _points(camera, [[30.2, 40.7], [61.0, 70.9]])
    view = ideal_view(camera, points)
    assert view.fine == 1
    assert view.focal == camera.matrix[0, 0]
    row, column = np.mgrid[: view.shape[0], : view.shape[1]]
    picture = camera_picture(camera, view, (100 * row + column + 1.0).astype(np.float32))
    assert picture.shape == SIZE[::-1]
    shown_row, shown_column = np.nonzero(picture)
    left, top = shown_column.min(), shown_row.min()
    assert view.centre == pytest.approx((58.7 - left, 46.2 - top), abs=1e-12)
    assert picture[top, left] == 1.0
    # The points and the pixels next to them are there, and not much more.
    assert left <= 29 <= 62 <= shown_column.max()
    assert top <= 39 <= 71 <= shown_row.max()
    assert view.shape[0] < 45
    assert view.shape[1] < 45


@pytest.mark.parametrize("square", [True, False])
def test_what_lies_beside_the_picture_is_not_rendered(square):
    camera = _camera((), square=square)
    columns, rows = SIZE
    far = _points(camera, [[-300.0, -200.0], [500.0, 600.0]])
    view = ideal_view(camera, far)
    assert view.shape[0] <= view.fine * 1.05 * rows + 8
    assert view.shape[1] <= view.fine * 1.05 * columns + 8
    whole = camera_picture(camera, view, np.ones(view.shape, dtype=np.float32))
    assert np.abs(whole - 1.0).max() < 1e-6


def test_beyond_the_view_and_the_lens_it_is_dark():
    camera = replace(_camera(), distortion=np.array([-2.0]))
    # This lens folds over 0.4 off the axis, 37 pixels from its middle.
    view = ideal_view(camera, _points(camera, [[50.0, 40.0], [60.0, 50.0]]))
    picture = camera_picture(camera, view, np.ones(view.shape, dtype=np.float32))
    assert picture[45, 55] == pytest.approx(1.0, abs=1e-6)
    assert picture[2, 2] == 0.0
    assert picture[80, 100] == 0.0


def test_projection_of_the_view_agrees_with_the_cameras():
    camera = _camera(square=True)
    points = _points(camera, [[30.0, 40.0], [60.0, 70.0]])
    view = ideal_view(camera, points)
    assert isinstance(view, IdealView)
    pose = camera.T_camera_object
    x, y, z = (points @ pose[:3, :3].T + pose[:3, 3]).T
    pixel = np.stack([x, y], 1) / z[:, None] * view.focal + view.centre
    offset = project(camera, points) - pixel
    assert np.abs(offset - np.rint(offset)).max() < 1e-9


def test_refusals():
    camera = _camera()
    with pytest.raises(InputError, match="has no size"):
        ideal_view(replace(camera, size=None), _whole(camera))
    with pytest.raises(InputError, match="sees nothing of the bodies"):
        ideal_view(camera, _points(camera, [[-100.0, 10.0], [-50.0, 20.0]]))
    origin, direction = rays(camera, np.array([[50.0, 50.0], [60.0, 60.0]]))
    with pytest.raises(CalibrationError, match="1 of 2 points of the bodies"):
        ideal_view(camera, origin + np.array([[0.5], [-0.5]]) * direction)


def _rig(*, size=MAP_SIZE, lens=(-0.2, 0.1)):
    """Three cameras in an L that look at the origin from about the z axis."""
    cameras = []
    for k, (right, up) in enumerate([(0.0, 0.0), (-12.0, 0.0), (0.0, -12.0)]):
        half = np.diag([1.0, -1.0, -1.0])
        about = cv2.Rodrigues(np.deg2rad(np.array([up, right, 0.0])))[0]
        pose = np.eye(4)
        pose[:3, :3], pose[2, 3] = about @ half, DISTANCE
        matrix = np.array([[FOCAL, 0.0, 131.2], [0.0, FOCAL, 118.7], [0.0, 0.0, 1.0]])
        cameras.append(Camera(f"c{k}", size, matrix, np.array(lens), pose))
    return Rig(tuple(cameras), 0, "test")


def _push(points):
    """A dent of 0.6 mm, with some shift along the surface, that fades below the equator."""
    away = (points[:, :2] - [0.006, 0.004]) ** 2
    share = np.exp(-0.5 * away.sum(axis=1) / 0.012**2) * np.clip(points[:, 2] / RADIUS, 0.0, 1.0)
    return share[:, None] * np.array([6e-4, -4e-4, -6e-4])


@pytest.fixture(scope="module")
def ball():
    return make_render_mesh(sphere(3, RADIUS), _rig().cameras, edge=2.0)


@pytest.fixture(scope="module")
def rod():
    """A rod in front of the ball, along the axis of the first camera's picture to the right."""
    mesh = box((0.1, 0.012, 0.012), 1, origin=(0.01, -0.006, RADIUS + 0.01))
    return mesh


def test_points_lie_on_the_rays_and_move_as_the_material_does(ball):
    rig = _rig()
    truth = truth_map(rig, ball, ball.vertices + _push(ball.vertices))
    assert truth.shape == MAP_SIZE[::-1]
    row, column = np.divmod(truth.pixel, MAP_SIZE[0])
    assert np.abs(project(rig.cameras[0], truth.point) - np.stack([column, row], 1)).max() < 1e-6
    # The quadratic pieces of a ball of 258 vertices leave it by 2.5e-5 m.
    assert np.abs(np.linalg.norm(truth.point, axis=1) - RADIUS).max() < 3e-5
    # And the motion linear: its second derivative times the edge squared over 8.
    assert np.abs(truth.displacement - _push(truth.point)).max() < 1e-6
    # The whole disc of the ball is there: sin of its half angle is R / distance.
    ratio = np.tan(np.arcsin(RADIUS / DISTANCE))
    undistorted = FOCAL * ratio * (1.0 - 0.2 * ratio**2 + 0.1 * ratio**4)
    assert len(truth.pixel) == pytest.approx(np.pi * undistorted**2, rel=2e-3)


def test_a_ball_hides_what_lies_past_its_horizon(ball):
    """A point is seen where the ray to the camera leaves the ball: normal . toward > 0."""
    rig = _rig()
    truth = truth_map(rig, ball, ball.vertices)
    normal = truth.point / RADIUS
    for k, camera in enumerate(rig.cameras):
        pose = camera.T_camera_object
        toward = -pose[:3, :3].T @ pose[:3, 3] - truth.point
        rise = np.einsum("na,na->n", normal, toward) / np.linalg.norm(toward, axis=1)
        hidden = (truth.hidden_rest >> k & 1).astype(bool)
        # The ball's surface waves by three degrees, 0.05; nearer to the horizon than a fifth it
        # bends by a tenth of a pixel between pixel centres; and the last pixel is a guess.
        assert not hidden[rise > 0.25].any()
        edge = 1.0 / (FOCAL * RADIUS / DISTANCE)
        assert hidden[rise < -0.05 - np.sqrt(2.0 * edge)].all()
    assert np.array_equal(truth.hidden_rest, truth.hidden_loaded)


def test_the_tool_hides_what_lies_behind_it_in_the_loaded_pictures_only(ball, rod):
    rig = _rig()
    truth = truth_map(rig, ball, ball.vertices, tool=rod)
    assert (truth.hidden_rest & 1).sum() == 0
    camera = rig.cameras[0]
    # Nearest the camera is the rod's upper face; it hides the pixels within its outline.
    pixel = np.stack(np.divmod(truth.pixel, MAP_SIZE[0])[::-1], axis=1).astype(np.float64)
    corner = project(camera, rod.vertices)
    outline = cv2.convexHull(corner.astype(np.float32))
    away = np.array([cv2.pointPolygonTest(outline, tuple(p), True) for p in pixel])
    hidden = (truth.hidden_loaded & 1).astype(bool)
    # A pixel either side for what is between pixel centres; the lens bends edges by 0.1 px.
    assert hidden[away > 1.2].all()
    assert not hidden[away < -1.2].any()
    assert hidden.sum() > 500


def test_points_that_leave_the_picture_are_hidden(ball):
    shift = np.array([0.02, 0.0, 0.0])
    truth = truth_map(_rig(), ball, ball.vertices + shift)
    camera = _rig().cameras[0]
    outside = project(camera, truth.point + shift)[:, 0] > MAP_SIZE[0] - 1
    assert outside.sum() > 1000
    # Near the horizon the ball, seen from another side, hides some of the others.
    high = truth.point[:, 2] > 0.3 * RADIUS
    assert np.array_equal((truth.hidden_loaded & 1).astype(bool)[high], outside[high])
    assert (truth.hidden_loaded & 1)[outside].all()


def test_pictures_move_as_the_map_says(ball, rod):
    """OpenCV's dense flow between rendered pictures, in every camera, away from what hides."""
    rig = _rig()
    texture = speckle(ball.vertices, sphere(3, RADIUS), size=2e-3, rng=np.random.default_rng(1))
    loaded = ball.vertices + _push(ball.vertices)
    light = Light(0.6, Lamp(np.array([0.2, 0.2, 0.5]), np.zeros(3), 0.1, 8.0))
    rod_body = DrawnBody(rod, np.zeros(len(rod.vertices)))
    variant = choose_variant(folders=(), environment={})
    options = {"variant": variant, "samples": 9}
    rest = render([_body(ball.vertices, ball.triangles, texture)], rig.cameras, light, seed=1,
                  **options)  # fmt: skip
    bodies = [_body(loaded, ball.triangles, texture), rod_body]
    moved = render(bodies, rig.cameras, light, seed=2, **options)
    truth = truth_map(rig, ball, loaded, tool=rod)
    chip, gain = Pictures(response=0.5, noise=1.0), exposure_gain(rest)
    rng = np.random.default_rng(2)
    for k, camera in enumerate(rig.cameras):
        pictures = [grey_picture(shot[k], chip, gain=gain, rng=rng) for shot in (rest, moved)]
        dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        dis.setFinestScale(0)
        flow = dis.calc(*pictures, None)
        at = project(camera, truth.point)
        away = project(camera, truth.point + truth.displacement) - at
        usable = ((truth.hidden_rest | truth.hidden_loaded) >> k & 1) == 0
        keep = usable & _far_from(at[~usable], at) & _inside(at, truth.point)
        mapped = cv2.remap(flow, at[keep].astype(np.float32)[:, None], None, cv2.INTER_LINEAR)[:, 0]
        error = mapped - away[keep]
        assert keep.sum() > 5000
        assert np.linalg.norm(away[keep], axis=1).max() > 1.5
        # Measured: 0.023 px, the library's own on pictures with this noise; its median 0.004 px.
        assert np.sqrt((error**2).mean()) < 0.035
        assert np.abs(np.median(error, axis=0)).max() < 0.008


def _body(vertices, triangles, grey):
    return DrawnBody(TriangleMesh(vertices, triangles), grey)


def _far_from(places, points):
    """Points more than 12 px, the reach of a patch of the flow, from all places."""
    if len(places) == 0:
        return np.ones(len(points), dtype=bool)
    return cKDTree(places).query(points, p=np.inf)[0] > 12.0


def _inside(pixel, points):
    """Not near the outline, nor the picture's edge."""
    inner = (pixel > 12.0).all(axis=1) & (pixel < np.array(MAP_SIZE) - 13.0).all(axis=1)
    return inner & (points[:, 2] > 0.6 * RADIUS)


def test_the_file_holds_what_the_format_says_and_the_same_bytes(ball, rod, tmp_path):
    truth = truth_map(_rig(), ball, ball.vertices + _push(ball.vertices), tool=rod)
    for name in ("a", "b"):
        write_truth_map(tmp_path / f"{name}.npz", truth)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz") as entries:
        assert {name: entries[name].dtype.name for name in entries} == {
            "shape": "int64", "pixel": "int32", "X": "float32", "U": "float32",
            "hidden_rest": "uint8", "hidden_loaded": "uint8",
        }  # fmt: skip
        assert tuple(entries["shape"]) == MAP_SIZE[::-1]
        assert np.abs(entries["X"] - truth.point).max() < 1e-8
        assert np.array_equal(entries["hidden_loaded"], truth.hidden_loaded)


def test_points_agree_with_those_of_the_shared_half_ball(shared_data):
    """Rest points of another maker, who drew the ball itself on a mesh of his own."""
    folder = shared_data / "halfball_images"
    rig = read_rig(folder / "rig.toml")
    fine = make_render_mesh(read_mesh(folder / "mesh.ply"), rig.cameras, edge=3.0)
    truth = truth_map(rig, fine, fine.vertices)
    with np.load(folder / "truth_n01.npz") as shared:
        assert tuple(shared["shape"]) == truth.shape
        _, here, there = np.intersect1d(truth.pixel, shared["pixel"], return_indices=True)
        # Some pixels of the outline differ.
        assert len(here) > 0.999 * max(len(truth.pixel), len(shared["pixel"]))
        away = np.linalg.norm(truth.point[here] - shared["X"][there], axis=1)
        same = truth.hidden_rest[here] == shared["hidden_rest"][there]
    # A pixel is 0.3 mm wide; his mesh is flat between vertices 0.5 mm apart, ours 1 mm.
    assert np.median(away) < 5e-6
    assert same.mean() > 0.99


def test_refusals_of_maps(ball):
    rig = _rig()
    many = tuple(
        Camera(
            f"c{k}", MAP_SIZE, rig.cameras[0].matrix, np.zeros(8), rig.cameras[0].T_camera_object
        )
        for k in range(9)
    )
    with pytest.raises(InputError, match="hold 8 cameras, a bit each; the rig has 9"):
        truth_map(Rig(many, 0, "test"), ball, ball.vertices)
    with pytest.raises(InputError, match="has no size"):
        truth_map(_rig(size=None), ball, ball.vertices)
    aside = replace(ball, vertices=ball.vertices + np.array([1.0, 0.0, 0.0]))
    with pytest.raises(InputError, match="camera 'c0' sees nothing of the body"):
        truth_map(rig, aside, aside.vertices)
    above = ball.vertices + np.array([0.0, 0.0, DISTANCE])
    with pytest.raises(CalibrationError, match="beside or behind"):
        truth_map(rig, ball, above)

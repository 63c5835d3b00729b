"""Points from the pictures of one instant, their triangulation, and their object's pose."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from jaxtyping import Float
from scipy.io import netcdf_file
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from surfaces import box, hull_mesh, sphere
from vision.scenes import (
    LENS,
    SHAPE,
    STILL,
    Stage,
    example,
    example_views,
    make_rig,
    moved_frame,
    noisy_views,
    projected,
)

from palpate.errors import CalibrationError, InputError
from palpate.geometry import TriangleMesh
from palpate.records.programs.registry import read_rig
from palpate.records.rig import Camera, Rig
from palpate.vision.matching.features import prepare_pictures
from palpate.vision.pictures import read_pictures
from palpate.vision.projection import project
from palpate.vision.range_flow import Outcome
from palpate.vision.stereo.stereo import (
    MIN_POSE_POINTS,
    StereoPoints,
    StereoSettings,
    _excess,
    near_object,
    object_frame,
    register_object,
    smooth_surface,
    stereo_matches,
    stereo_points,
    triangulate_consistent,
)
from palpate.vision.triangulation import triangulate

RADIUS = 0.06  # of the example's dome [m]
ROTATION = Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix()
POSE = np.vstack([np.column_stack([ROTATION, [0.002, -0.001, 0.003]]), [0.0, 0.0, 0.0, 1.0]])


def _views(count: int = 3, lens: tuple[float, ...] = (), noise: float = 1.5) -> list[np.ndarray]:
    return noisy_views(example_views("still", count, lens), noise, seed=count)


def _stereo(rig: Rig, views, **options) -> StereoPoints:
    return stereo_points(prepare_pictures(rig, views), **options)


def _above(stereo: StereoPoints) -> tuple[np.ndarray, np.ndarray]:
    """Distance of points from the dome along its normal, and the claimed standard deviation."""
    x, y, z = stereo.point.T
    normal = np.column_stack([x / RADIUS, y / RADIUS, np.ones_like(x)])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    height = (z + (x * x + y * y) / (2.0 * RADIUS)) * normal[:, 2]
    return height, np.sqrt(np.einsum("ni,nij,nj->n", normal, stereo.covariance, normal))


def _turned(camera: Camera, angle: float) -> Camera:
    """A camera turned about its own x axis [rad]: its calibration has drifted."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.eye(4)
    turn[1:3, 1:3] = [[c, -s], [s, c]]
    return replace(camera, T_camera_object=turn @ camera.T_camera_object)


@pytest.mark.parametrize(("count", "lens"), [(2, ()), (3, LENS), (4, ())])
def test_points_lie_on_the_surface_as_well_as_they_claim(count, lens):
    stage = example(count, lens)
    stereo = _stereo(stage.rig, _views(count, lens))
    height, sigma = _above(stereo)
    # 1140 points of the grid; windows of 9 px at the rim of either picture are lost.
    assert len(height) > 950
    # Windows overlap: some fifty independent ones give their mean square to 20 %.
    assert 0.8 < np.sqrt(np.mean((height / sigma) ** 2)) < 1.2
    # A pixel is 0.3 mm wide; a hundredth of one at 20 degrees between the cameras is 0.01 mm.
    assert np.sqrt(np.mean(height**2)) < 1.5e-5
    truth = stage.points(stage.rest_points(stage.rig.cameras[0], stereo.pixel, STILL))
    beside = np.linalg.norm((stereo.point - truth)[:, :2], axis=1)
    assert np.sqrt(np.mean(beside**2)) < 6e-6
    assert stereo.cameras.max() == count
    assert stereo.counts.sum() == 30 * 38
    assert stereo.counts[Outcome.VALID] == len(stereo.pixel)


def test_windows_shrink_at_an_edge_of_the_object():
    """A roof: windows across the ridge are contradicted by smaller ones on one of its sides."""
    stage = Stage(make_rig(2), lambda x, y: -0.8 * np.abs(x), seed=5)
    views = noisy_views(stage.views(), 1.0, seed=5)
    stereo = _stereo(stage.rig, views)
    ridge = projected(stage.rig.cameras[0], np.zeros((1, 3)))[0, 0]
    near = np.abs(stereo.pixel[:, 0] - ridge) < 10.0
    assert near.sum() > 50
    height = (stereo.point[:, 2] + 0.8 * np.abs(stereo.point[:, 0])) / np.hypot(1.0, 0.8)
    # Windows of 21 px that end on the ridge see it rounded, by 0.8 * 10 px * 0.3 mm / 4 = 0.6 mm.
    assert np.sqrt(np.mean(height[near] ** 2)) < 1e-4
    assert np.sqrt(np.mean(height[~near] ** 2)) < 3e-5


def test_points_turn_with_the_frame_and_do_not_depend_on_the_order_of_cameras():
    rig, views = example(3).rig, _views(3)
    stereo = _stereo(rig, views)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    shift = np.array([0.1, -0.2, 0.3])
    elsewhere = _stereo(moved_frame(rig, turn, shift), views)
    np.testing.assert_allclose(elsewhere.point, stereo.point @ turn.T + shift, atol=1e-9)
    swapped = Rig(rig.cameras[::-1], 2, "scene")
    other = _stereo(swapped, views[::-1])
    np.testing.assert_array_equal(other.pixel, stereo.pixel)
    np.testing.assert_allclose(other.point, stereo.point, atol=1e-9)


def test_a_camera_that_shows_something_else_drops_out():
    rig, views = example(3).rig, _views(3)
    two = _stereo(Rig(rig.cameras[:2], 0, "scene"), views[:2])
    blank = [*views[:2], np.full_like(views[2], 80.0)]
    np.testing.assert_array_equal(_stereo(rig, blank).point, two.point)
    # Another texture, matched by chance nowhere that the neighbours would confirm.
    strange = [*views[:2], np.ascontiguousarray(views[2][::-1, ::-1])]
    remaining = _stereo(rig, strange)
    height, _ = _above(remaining)
    assert len(remaining.pixel) >= 0.98 * len(two.pixel)
    assert np.sqrt(np.mean(height**2)) < 2e-5


def test_a_point_that_one_camera_matches_is_valid_whatever_the_others_say():
    """The right half of one picture of three shows nothing."""
    rig, views = example(3).rig, _views(3)
    views[2] = views[2].copy()
    views[2][:, SHAPE[1] // 2 :] = 80.0
    matches = stereo_matches(prepare_pictures(rig, views))
    matched = np.isfinite(matches.pixels[1:]).all(axis=2)
    assert (matched[0] & ~matched[1]).sum() > 100
    assert (~matched.any(axis=0)).any()
    np.testing.assert_array_equal(matches.outcome == Outcome.VALID, matched.any(axis=0))


def test_a_wrong_match_of_one_camera_is_left_out():
    """One camera of four turned by 0.3 degrees (5 px): the other three agree without it."""
    rig, views = example(4).rig, _views(4)
    cameras = list(rig.cameras)
    cameras[3] = _turned(cameras[3], np.radians(0.3))
    stereo = _stereo(Rig(tuple(cameras), 0, "scene"), views)
    height, _ = _above(stereo)
    assert stereo.cameras.max() <= 3
    assert np.sqrt(np.mean(height**2)) < 2e-5


def test_a_drifted_calibration_is_searched_all_the_same_and_rejected_for_what_it_is():
    rig, views = example(2).rig, _views(2)
    drifted = Rig((rig.cameras[0], _turned(rig.cameras[1], np.radians(0.5))), 0, "scene")
    strict = _stereo(drifted, views)
    assert len(strict.pixel) == 0
    assert strict.counts[Outcome.REPROJECTION] > 800
    loose = _stereo(drifted, views, settings=StereoSettings(reprojection=20.0))
    assert len(loose.pixel) > 800
    # Half a degree is 8.7 px, shared by two cameras and two coordinates each.
    assert np.median(loose.residual) == pytest.approx(8.7 / np.sqrt(8.0), rel=0.1)


def test_mask_and_texture_decide_where_points_are():
    rig, views = example(2).rig, _views(2, noise=0.5)
    mask = np.zeros(SHAPE, dtype=bool)
    mask[40:100, 60:120] = True
    inside = _stereo(rig, views, mask=mask, settings=StereoSettings(step=3))
    assert inside.counts.sum() == 20 * 20
    assert len(inside.pixel) > 350
    assert (inside.pixel >= [60, 40]).all()
    assert (inside.pixel < [120, 100]).all()
    blank = views[0].copy()
    blank[:, 95:] = 90.0
    half = _stereo(rig, [blank, views[1]])
    # Windows of 9 px look 3 px ahead for texture on all sides.
    assert half.pixel[:, 0].max() < 95
    assert half.counts[Outcome.TEXTURE] > 15 * 30


def test_unlike_cameras_are_paired():
    """A picture of another size: the second camera is cropped."""
    rig, views = example(2).rig, _views(2)
    rows, columns = SHAPE[0] - 20, SHAPE[1] - 10
    cropped = replace(rig.cameras[1], size=(columns, rows))
    small = Rig((rig.cameras[0], cropped), 0, "scene")
    stereo = _stereo(small, [views[0], np.ascontiguousarray(views[1][:rows, :columns])])
    height, _ = _above(stereo)
    assert len(height) > 750
    assert np.sqrt(np.mean(height**2)) < 1.5e-5


def test_nothing_found_is_a_result():
    rig, views = example(2).rig, _views(2)
    stereo = _stereo(rig, views, mask=np.zeros(SHAPE, dtype=bool))
    assert len(stereo.pixel) == 0
    assert stereo.counts.sum() == 0


def test_input_is_checked():
    rig, views = example(2).rig, _views(2)
    with pytest.raises(InputError, match="1 pictures for 2 cameras"):
        _stereo(rig, views[:1])
    with pytest.raises(InputError, match="mask is of"):
        _stereo(rig, views, mask=np.ones((3, 4), dtype=bool))
    with pytest.raises(InputError, match="have 0 features in common"):
        _stereo(rig, [views[0], np.full_like(views[1], 80.0)])
    with pytest.raises(InputError, match="subset is 20"):
        StereoSettings(subset=20)
    with pytest.raises(InputError, match="step is 0"):
        StereoSettings(step=0)
    with pytest.raises(InputError, match="reprojection is 0; must be positive"):
        StereoSettings(reprojection=0.0)
    twins = Rig((rig.cameras[0], replace(rig.cameras[0], name="twin")), 0, "scene")
    with pytest.raises(CalibrationError, match="same centre"):
        _stereo(twins, views)


def _rendered(folder, pattern: str, truth: str):
    """Stereo points of a rendered set and what they should be, in the reference camera's axes."""
    rig = read_rig(folder / "rig.toml")
    pictures = read_pictures(rig, pattern, folder=folder, what="rest")
    stereo = _stereo(rig, pictures.grey)
    stored = np.load(folder / truth)
    point = np.full((int(np.prod(stored["shape"])), 3), np.nan)
    point[stored["pixel"]] = stored["X"]
    point = point.reshape(*stored["shape"], 3)
    column, row = stereo.pixel.astype(int).T
    error = (stereo.point - point[row, column]) @ rig.cameras[0].T_camera_object[:3, :3].T
    on_grid = int(np.isfinite(point[2::5, 2::5, 0]).sum())
    return stereo, error, on_grid


def test_rendered_half_ball(shared_data):
    _, error, on_grid = _rendered(
        shared_data / "halfball_images", "images/rest_{camera}.png", "truth_n01.npz"
    )
    seen = np.isfinite(error).all(axis=1)
    # Off the object: points within a pixel of its outline.
    assert (~seen).sum() < 0.01 * len(seen)
    assert seen.sum() > 0.8 * on_grid
    rms = np.sqrt(np.mean(error[seen] ** 2, axis=0))
    # A hundredth of a pixel, 0.32 mm wide, at 11 degrees between the cameras; measured 2.6, 2.0 and
    # 21 um, most of it near the outline.
    assert (rms < [5e-6, 5e-6, 4e-5]).all()
    assert np.median(np.abs(error[seen, 2])) < 8e-6


def test_rendered_solid_with_edges(shared_data):
    stereo, error, on_grid = _rendered(
        shared_data / "rigid_translation_x", "images/s0_{camera}.png", "truth_s0.npz"
    )
    seen = np.isfinite(error).all(axis=1)
    assert (~seen).sum() < 0.04 * len(seen)
    assert seen.sum() > 0.85 * on_grid
    # 0.54 mm a pixel, 7 degrees: a hundredth of a pixel is 45 um of depth. Edges every 30 px.
    assert np.median(np.abs(error[seen, 2])) < 6e-5
    # Measured 0.18 mm; 0.28 mm where windows do not shrink until they leave less.
    assert np.sqrt(np.mean(error[seen, 2] ** 2)) < 2.3e-4
    assert len(stereo.pixel) > 500


def _gold(path) -> tuple[Float[np.ndarray, "k 2"], Float[np.ndarray, "k 2"]]:
    """Pixels of a DICe solution, and where it finds them in the right camera."""
    with netcdf_file(path, mmap=False) as file:
        names = [b"".join(row).decode().strip("\0") for row in file.variables["name_nod_var"].data]
        value = {
            name: file.variables[f"vals_nod_var{i + 1}"].data[0].astype(np.float64)
            for i, name in enumerate(names)
        }
    good = value["SIGMA"] > 0.0
    left = np.stack([value["COORDINATE_X"], value["COORDINATE_Y"]], axis=1)
    right = np.stack([value["STEREO_COORDINATES_X"], value["STEREO_COORDINATES_Y"]], axis=1)
    return left[good], right[good]


@pytest.mark.slow
def test_matches_of_another_program_on_a_real_specimen(shared_data):
    folder = shared_data / "real" / "gt4_dspec"
    rig = read_rig(folder / "cal_vic3d.xml")
    grey = [
        cv2.imread(str(folder / side / f"GT4-0000_{k}.tif"), cv2.IMREAD_GRAYSCALE).astype(
            np.float32
        )
        for k, side in enumerate("LR")
    ]
    mask = np.zeros(grey[0].shape, dtype=bool)
    mask[400:700, 500:1300] = True
    stereo = _stereo(rig, grey, mask=mask, settings=StereoSettings(step=10))
    assert len(stereo.pixel) > 0.95 * mask.sum() / 100
    left, right = _gold(folder / "dice_gold" / "DICe_solution.e")
    distance, near = cKDTree(stereo.pixel).query(left, 9)
    left, right, near = (values[distance[:, 8] < 25.0] for values in (left, right, near))
    assert len(left) > 12
    seen = project(rig.cameras[1], stereo.point)
    error = []
    for pixel, partner, rows in zip(left, right, near, strict=True):
        plane = np.column_stack([np.ones(9), stereo.pixel[rows] - pixel])
        error.append(np.linalg.lstsq(plane, seen[rows], rcond=None)[0][0] - partner)
    # Along the rows, which are nearly the epipolar lines, the two programs' noise; across, half of
    # the 0.1 px by which this calibration misses.
    assert np.median(np.abs(error), axis=0)[0] < 0.015
    assert np.median(np.abs(error), axis=0)[1] < 0.08
    # The specimen is a flat plate.
    middle = stereo.point.mean(axis=0)
    _, _, axes = np.linalg.svd(stereo.point - middle)
    assert np.std((stereo.point - middle) @ axes[2]) < 2e-5


def _stereo_points(points: np.ndarray) -> StereoPoints:
    n = len(points)
    return StereoPoints(
        np.zeros((n, 2)), points, np.tile(1e-10 * np.eye(3), (n, 1, 1)), np.zeros(n),
        np.full(n, 2), np.full(n, 1e-3), np.zeros(8, dtype=np.int64), 8,
    )  # fmt: skip


def _moved_back(points: np.ndarray) -> np.ndarray:
    """Points of the mesh in the frame of the rig, with x_mesh = POSE x_rig."""
    return (points - POSE[:3, 3]) @ POSE[:3, :3]


def test_what_is_near_the_object() -> None:
    mesh = box(size=(0.02, 0.03, 0.06), cells=1)
    # The diagonal is 0.07 m; 0.6 of it is 0.042 m from the middle.
    middle, away = np.array([0.01, 0.015, 0.03]), np.array([0.0, 0.0, 1.0])
    points = middle + np.array([[0.0], [0.041], [0.043], [1.0]]) * away
    assert near_object(points, mesh).tolist() == [True, True, False, False]
    assert near_object(_moved_back(points), mesh, POSE).tolist() == [True, True, False, False]


def _in_view(mesh: TriangleMesh) -> np.ndarray:
    """Points of the surface that cameras far above it see."""
    vertices = smooth_surface(mesh).vertices
    return vertices[vertices[:, 2] > 0.01]


def _bumpy() -> TriangleMesh:
    """An ellipsoid of three different axes, which has a pose."""
    return hull_mesh(sphere(3).vertices * [0.02, 0.03, 0.04])


def test_the_pose_is_found_among_background() -> None:
    mesh = _bumpy()
    rng = np.random.default_rng(4)
    table = np.column_stack([rng.uniform(-0.2, 0.2, (400, 2)), np.full(400, -0.08)])
    surface = _in_view(mesh)
    points = _stereo_points(_moved_back(np.vstack([surface, table])))
    registration = register_object(make_rig(), points, smooth_surface(mesh))
    assert registration is not None
    # The points are those of the surface itself, to rounding; the search ends at 1e-6 m or better.
    np.testing.assert_allclose(registration.T_mesh_points, POSE, atol=2e-6)


def test_too_few_points_have_no_pose() -> None:
    smooth = smooth_surface(_bumpy())
    few = smooth.vertices[: MIN_POSE_POINTS - 1]
    assert register_object(make_rig(), _stereo_points(few), smooth) is None


def test_the_rig_in_the_frame_of_the_mesh_sees_the_same() -> None:
    rig, mesh = make_rig(), _bumpy()
    points = _moved_back(_in_view(mesh))
    registration = register_object(rig, _stereo_points(points), smooth_surface(mesh))
    assert registration is not None
    there = object_frame(rig, registration)
    in_mesh = points @ registration.T_mesh_points[:3, :3].T + registration.T_mesh_points[:3, 3]
    for before, after in zip(rig.cameras, there.cameras, strict=True):
        assert project(after, in_mesh) == pytest.approx(project(before, points), abs=1e-7)


def _seen_pixels(count: int = 4, points: int = 60, noise: float = 0.01):
    """Pixels of points on the example's dome in all cameras, with noise of matches."""
    rng = np.random.default_rng(2)
    stage = example(count)
    space = stage.points(rng.uniform(-0.015, 0.015, size=(points, 2)))
    pixels = np.stack([projected(camera, space) for camera in stage.rig.cameras])
    pixels += rng.normal(scale=noise, size=pixels.shape)
    covariance = np.broadcast_to(2.0 * noise**2 * np.eye(2), (count, points, 2, 2)).copy()
    return stage.rig, space, pixels, covariance


def test_the_camera_that_contradicts_the_others_is_left_out():
    rig, space, pixels, covariance = _seen_pixels()
    pixels[2, :9] += [0.4, 0.3]
    pixels[3, 20:24] = np.nan
    triangulated, used = triangulate_consistent(rig, pixels, covariance, reprojection=2.0)
    assert not used[2, :9].any()
    assert used[[0, 1, 3], :9].all()
    assert not used[3, 20:24].any()
    assert used.sum() == 4 * 60 - 13
    np.testing.assert_array_equal(triangulated.cameras, used.sum(axis=0))
    # A hundredth of a pixel of 0.3 mm, at 20 degrees.
    assert np.abs(triangulated.point - space).max() < 6e-5


def test_two_cameras_that_contradict_each_other_are_both_left_out():
    rig, _, pixels, covariance = _seen_pixels(2)
    # Across the epipolar lines, which run along the rows.
    pixels[1, :5, 1] += 0.6
    triangulated, used = triangulate_consistent(rig, pixels, covariance, reprojection=2.0)
    assert not used[:, :5].any()
    assert used[:, 5:].all()
    assert np.isnan(triangulated.point[:5]).all()


def test_half_of_each_matchs_variance_is_the_references():
    """The joint point is that of triangulation with these shares; the reference has their mean."""
    rig, _, pixels, covariance = _seen_pixels()
    covariance *= np.array([np.nan, 1.0, 2.0, 3.0])[:, None, None, None]
    triangulated, used = triangulate_consistent(rig, pixels, covariance, reprojection=2.0)
    assert used.all()
    covariance[0] = covariance[1:].mean(axis=0)
    expected = triangulate(rig, pixels, 0.5 * covariance)
    np.testing.assert_allclose(triangulated.point, expected.point, rtol=0, atol=1e-15)
    np.testing.assert_allclose(triangulated.covariance, expected.covariance, rtol=1e-12)


def test_what_all_points_share_is_the_rig_and_only_limited():
    """A row offset of a drifted camera: below the limit accepted, above not."""
    rig, _, pixels, covariance = _seen_pixels(2)
    pixels[1, :, 1] += 1.5
    for limit, count in ((2.0, 60), (0.5, 0)):
        _, used = triangulate_consistent(rig, pixels, covariance, reprojection=limit)
        assert used[0].sum() == count


def test_excess_is_over_the_noise_of_the_match_and_over_what_all_points_miss_by():
    """All points of the second camera miss by the same 0.5 px, the first by 1.2 px more."""
    covariance = np.broadcast_to(0.02 * np.eye(2), (2, 9, 2, 2))
    error = np.zeros((2, 9, 2))
    error[1] = [0.3, 0.4]
    error[1, 0] += [1.2, 0.0]
    used = np.ones((2, 9), dtype=bool)
    used[1, 8] = False
    excess = _excess(error, used, covariance, 2.0)
    # Five standard deviations, root of the trace 0.2 px.
    expected = np.array([[0.0] * 9, [1.2 / (5.0 * 0.2), *([0.5 / 2.0] * 7), -np.inf]])
    np.testing.assert_allclose(excess, expected, atol=1e-12)
    # By turns 0.3 px to either side, the scatter of all points adds to the noise.
    error[1, :8] = np.array([[0.3, 0.0], [-0.3, 0.0]] * 4)
    excess = _excess(error, used, covariance, 10.0)
    allowed = 5.0 * np.hypot(1.4826 * 0.3, 0.2)
    np.testing.assert_allclose(excess[1, :8], 0.3 / allowed, rtol=1e-12)

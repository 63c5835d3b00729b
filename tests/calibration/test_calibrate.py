"""From drawn pictures to a rig: targets, half turns, views that contradict, files."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.boards import board_points, draw_board, seen_corners, sightings, true_bundle
from palpate.app.cli import main
from palpate.calibration import (
    AprilGrid,
    Charuco,
    Chessboard,
    Circles,
    board_frame,
    calibrate,
    camera_quality,
    find_boards,
    find_pictures,
    length_check,
    length_sigma,
    middle_view,
    picture_errors,
    write_calibration,
)
from palpate.calibration.adjustment import Bundle
from palpate.calibration.calibrate import cameras_of
from palpate.calibration.sightings import Sightings
from palpate.errors import CalibrationError
from palpate.records import Rig, read_rig
from palpate.vision import project, triangulate

_SIZE = (640, 512)


def _scene(rng: np.random.Generator, board: Chessboard | Charuco, views: int) -> Bundle:
    """Two cameras of 640 x 512 pixels that see the whole board in every view."""
    truth = true_bundle(rng, cameras=2, views=views)
    intrinsics = truth.intrinsics.copy()
    intrinsics[:, :4] *= 0.5
    view = truth.view.copy()
    middle = board.points.mean(axis=0)
    view[:, :3, 3] = [0.03, 0.0, 0.36] - np.einsum("vij,j->vi", view[:, :3, :3], middle)
    view[:, :3, 3] += rng.uniform(-0.015, 0.015, (views, 3))
    return Bundle(intrinsics, truth.camera, view)


def _write(folder: Path, truth: Bundle, texture: np.ndarray, extent: tuple[float, float]) -> None:
    rng = np.random.default_rng(8)
    for c, intrinsics in enumerate(truth.intrinsics):
        (folder / f"c{c}").mkdir(parents=True)
        for v, view in enumerate(truth.view):
            picture = draw_board(
                texture, extent, intrinsics, truth.camera[c] @ view, _SIZE, rng=rng
            )
            cv2.imwrite(str(folder / f"c{c}" / f"c{c}_{v:02d}.png"), picture)


def test_charuco_from_pictures_to_rig(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    board = Charuco(9, 7, 0.012, 0.009)
    truth = _scene(np.random.default_rng(3), board, 6)
    _write(tmp_path / "boards", truth, board.drawing(60), (9 * 0.012, 7 * 0.012))
    monkeypatch.chdir(tmp_path)
    words = "calibrate boards --columns 9 --rows 7 --square 12mm --marker 9mm --out rig"
    assert main(words.split()) == 0
    said = capsys.readouterr()
    assert "known to" in said.out
    rig = read_rig(tmp_path / "rig")
    assert [camera.name for camera in rig.cameras] == ["c0", "c1"]
    with np.load(tmp_path / "rig" / "rig_covariance.npz") as stored:
        every = np.sqrt(np.diag(stored["covariance"]))
        across = every[stored["names"].tolist().index("c1.tx")]
        sigma = every[:18].reshape(2, 9)
        # Four rays a pixel and noise of 2 grey levels.
        assert stored["corner_noise"].max() < 0.15
    for camera, intrinsics, std in zip(rig.cameras, truth.intrinsics, sigma, strict=True):
        k = camera.matrix
        error = np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2]]) - intrinsics[:4]
        assert np.abs(error / std[:4]).max() < 4.0
        # The board fills a third of the picture in six views.
        assert std[:4].max() < 5.0
    away = rig.cameras[1].T_camera_object[0, 3] - truth.camera[1, 0, 3]
    assert abs(away) < 4.0 * across < 4e-3
    files = {path.name for path in (tmp_path / "rig").iterdir()}
    assert {"rig.toml", "rig_covariance.npz", "opencv.yml", "kalibr.yaml", "residuals.png"} <= files
    pictures = (tmp_path / "rig" / "views.csv").read_text().splitlines()
    assert pictures[0] == "camera,view,corners,left out,rms [px]"
    # Six views of at most 8 x 6 corners by each of two cameras, scattered by a tenth of a pixel.
    rows = [line.split(",") for line in pictures[1:]]
    assert [row[:2] for row in rows] == [[f"c{c}", f"{v:02d}"] for c in (0, 1) for v in range(6)]
    assert all(24 < int(row[2]) <= 48 and 0.01 < float(row[4]) < 0.3 for row in rows)
    for other in ("opencv.yml", "kalibr.yaml"):
        again = read_rig(tmp_path / "rig" / other)
        np.testing.assert_allclose(
            again.cameras[1].T_camera_object, rig.cameras[1].T_camera_object, atol=1e-12
        )
        np.testing.assert_allclose(again.cameras[0].matrix, rig.cameras[0].matrix, rtol=1e-12)


def test_several_boards_in_one_picture_are_views_of_their_own(tmp_path: Path) -> None:
    """Two boards side by side, their markers numbered on."""
    boards = [Charuco(5, 5, 0.016, 0.012), Charuco(5, 5, 0.016, 0.012, first=12)]
    truth = _scene(np.random.default_rng(6), boards[0], 5)
    (tmp_path / "c0").mkdir()
    rng = np.random.default_rng(9)
    for v, view in enumerate(truth.view):
        pictures = []
        for side, board in zip((-0.055, 0.03), boards, strict=True):
            pose = view.copy()
            pose[0, 3] += side
            pictures.append(
                draw_board(
                    board.drawing(48),
                    (0.08, 0.08),
                    truth.intrinsics[0],
                    pose,
                    _SIZE,
                    rng=rng,
                    noise=0.0,
                )
            )
        # White wherever no board is.
        cv2.imwrite(str(tmp_path / "c0" / f"{v}.png"), np.minimum(*pictures))
    result = calibrate(find_boards(find_pictures(tmp_path), boards), boards)
    assert set(result.sightings.views) == {f"{v} board {k}" for v in range(5) for k in range(2)}
    assert len(result.corners.pixel) > 0.9 * 5 * 2 * 16
    sigma = np.sqrt(np.diag(result.covariance))[0]
    assert abs(result.cameras[0].matrix[0, 0] - truth.intrinsics[0, 0]) < 4.0 * sigma < 20.0
    assert result.adjusted.noise[0] < 0.15


def test_the_board_on_the_table_is_the_frame() -> None:
    """Its corners lie on z = 0 about the origin, and the cameras above it."""
    both, board, _ = _synthetic(3, cameras=2)
    result = calibrate(both, [board])
    frame = board_frame(result, [board], both.views[4])
    corners = board.points - board.points.mean(axis=0)
    seen = result.adjusted.bundle.view[4]
    there = (corners + board.points.mean(axis=0)) @ seen[:3, :3].T + seen[:3, 3]
    back = (there - frame[:3, 3]) @ frame[:3, :3]
    # x along the rows, y against the direction in which rows are counted, z up.
    np.testing.assert_allclose(back, corners * [1.0, -1.0, 1.0], atol=1e-12)
    assert np.linalg.inv(frame)[2, 3] > 0.1
    with pytest.raises(CalibrationError, match="no view 'table' among those that were used"):
        board_frame(result, [board], "table")


@pytest.mark.parametrize(
    "target",
    [
        Chessboard(9, 6, 0.012),
        AprilGrid(5, 4, 0.016, 0.005),
        Circles(7, 5, 0.016),
        Circles(4, 8, 0.013, asymmetric=True),
        Circles(4, 7, 0.013, asymmetric=True),
    ],
    ids=["chessboard", "aprilgrid", "circles", "asymmetric alike", "asymmetric unlike"],
)
def test_marks_are_found_where_they_are(target: Chessboard | AprilGrid | Circles) -> None:
    rng = np.random.default_rng(4)
    intrinsics = np.array([900.0, 900.0, 319.5, 255.5, -0.1, 0.05, 0.0, 0.0, 0.0])
    pixels_per_metre, margin = 10000, 0.02
    points = target.points
    width, height = points[:, :2].max(axis=0) + 2 * margin
    texture = np.full(
        (int(height * pixels_per_metre), int(width * pixels_per_metre)), 255, np.uint8
    )
    at = np.rint((points[:, :2] + margin) * pixels_per_metre).astype(int)
    if isinstance(target, Circles):
        for x, y in at:
            # In sixteenths of a pixel; its centre is half a pixel from its corner.
            cv2.circle(texture, (int(16 * x - 8), int(16 * y - 8)), 16 * 50, 0, -1, shift=4)
    elif isinstance(target, AprilGrid):
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        for k, (x, y) in enumerate(at[::4]):
            texture[y : y + 160, x : x + 160] = cv2.aruco.generateImageMarker(dictionary, k, 160)
    else:
        side = round(target.square * pixels_per_metre)
        for i in range(-1, target.rows):
            for j in range(-1, target.columns):
                if (i + j) % 2 == 0:
                    y, x = margin * pixels_per_metre + side * np.array([i, j])
                    texture[int(y) : int(y) + side, int(x) : int(x) + side] = 0
    pose = true_bundle(rng, cameras=1, views=1).view[0]
    pose[:3, 3] = np.array([0.0, 0.0, 0.3]) - pose[:3, :3] @ np.append(
        (points.max(axis=0) / 2)[:2], 0
    )
    shifted = pose.copy()
    shifted[:3, 3] += pose[:3, :3] @ [-margin, -margin, 0.0]
    extent = (texture.shape[1] / pixels_per_metre, texture.shape[0] / pixels_per_metre)
    picture = draw_board(texture, extent, intrinsics, shifted, _SIZE, rng=rng, parts=3)
    sighting = target.find(picture)
    assert len(sighting.mark) == len(points)
    bundle = Bundle(intrinsics[None], np.eye(4)[None], pose[None])
    truth = seen_corners(bundle, points, rng, noise=0.0).pixel
    turned = np.arange(len(points)) if target.turned is None else target.turned
    errors = [np.linalg.norm(sighting.pixel - truth[order[sighting.mark]], axis=1) for order in
              (np.arange(len(points)), turned)]  # fmt: skip
    error = min(errors, key=lambda e: float(np.median(e)))
    # The drawing has texels of a third of a pixel. A tag's corner has one dark quarter out of four,
    # and the middle of a circle's picture is not that of the circle.
    limit = {Chessboard: 0.1, AprilGrid: 0.2, Circles: 0.15}[type(target)]
    assert np.sqrt((error**2).mean() / 2.0) < limit


def test_corners_at_the_rim_need_one_marker() -> None:
    """A board that reaches out of the picture on all sides: of a square that the rim cuts, the
    marker is lost, and the corner that it shares with a whole one is not."""
    board = Charuco(12, 9, 0.02, 0.015)
    intrinsics = np.array([900.0, 900.0, 319.5, 255.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    pose = np.eye(4)
    pose[:3, 3] = [-0.12, -0.09, 0.3]
    extent = (board.columns * board.square, board.rows * board.square)
    rng = np.random.default_rng(5)
    picture = draw_board(board.drawing(60), extent, intrinsics, pose, _SIZE, rng=rng)
    sighting = board.find(picture)
    pixel = intrinsics[:2] * (board.points + pose[:3, 3])[:, :2] / pose[2, 3] + intrinsics[2:4]
    # A corner needs a few pixels around it, and a whole marker of 45 on one side.
    visible = ((pixel > 8.0) & (pixel < np.array(_SIZE) - 9.0)).all(axis=1)
    assert visible.sum() == 88
    assert set(sighting.mark.tolist()) <= set(np.flatnonzero(visible).tolist())
    # The rim cuts both markers of two outermost corners.
    assert len(sighting.mark) == 86
    assert np.abs(sighting.pixel - pixel[sighting.mark]).max() < 0.3


def _synthetic(
    seed: int, *, cameras: int = 3, views: int = 14
) -> tuple[Sightings, Chessboard, Bundle]:
    rng = np.random.default_rng(seed)
    board = Chessboard(9, 7, 0.012)
    middle = board.points.mean(axis=0)
    truth = true_bundle(rng, cameras=cameras, views=views)
    truth.view[:, :3, 3] -= np.einsum("vij,j->vi", truth.view[:, :3, :3], middle)
    corners = seen_corners(truth, board_points() + middle, rng, noise=0.1)
    return sightings(corners, board, cameras), board, truth


def test_boards_seen_upside_down_are_turned_alike() -> None:
    seen, board, truth = _synthetic(10)
    turned = (seen.corners.camera == 1) & (seen.corners.view % 3 == 0)
    mark = np.where(turned, board.turned[seen.mark], seen.mark)
    point = np.where(turned[:, None], board.points[mark], seen.corners.point)
    seen = replace(seen, mark=mark, corners=replace(seen.corners, point=point))
    result = calibrate(seen, [board])
    assert not result.notes
    np.testing.assert_allclose(result.adjusted.noise, 0.1, rtol=0.1)
    for camera, pose in zip(result.cameras, truth.camera, strict=True):
        # A turn of the third camera, which sees parts of the boards, goes with its centre.
        np.testing.assert_allclose(camera.T_camera_object, pose, atol=2e-2)


def test_a_board_that_moved_between_the_cameras_is_named() -> None:
    seen, board, _ = _synthetic(11)
    moved = (seen.corners.camera == 1) & (seen.corners.view == 5)
    assert moved.sum() > 30
    pixel = seen.corners.pixel + np.where(moved[:, None], [4.0, -3.0], 0.0)
    result = calibrate(replace(seen, corners=replace(seen.corners, pixel=pixel)), [board])
    assert len(result.notes) == 1
    assert "'05'" in result.notes[0]
    assert "move" in result.notes[0]
    assert len(result.sightings.views) == 13
    np.testing.assert_allclose(result.adjusted.noise, 0.1, rtol=0.15)


def test_a_mark_found_beside_its_place_costs_no_view() -> None:
    """Ten pixels, a hundred times the noise: the corner is left out and the view is not."""
    seen, board, _ = _synthetic(11)
    pixel = seen.corners.pixel.copy()
    wrong = np.flatnonzero((seen.corners.camera == 1) & (seen.corners.view == 5))[7]
    pixel[wrong] += [8.0, -6.0]
    result = calibrate(replace(seen, corners=replace(seen.corners, pixel=pixel)), [board])
    assert result.notes == ()
    assert len(result.sightings.views) == 14
    assert not result.adjusted.good[wrong]


def test_pictures_of_different_instants_are_refused() -> None:
    seen, board, _ = _synthetic(12)
    view = np.where(seen.corners.camera == 1, (seen.corners.view + 3) % 14, seen.corners.view)
    with pytest.raises(CalibrationError, match="same instant"):
        calibrate(replace(seen, corners=replace(seen.corners, view=view)), [board])


def test_lengths_are_as_good_as_said() -> None:
    """Stretches of a block on the middle board against its true ones, over seeds: the largest in
    any direction is about as large as is claimed for the worst one."""
    block = np.array([*product((-0.048, 0.0, 0.048), (-0.036, 0.0, 0.036), (0.0, 0.024, 0.048))])
    ratios = []
    for seed in range(20, 32):
        seen, board, truth = _synthetic(seed, cameras=2)
        result = calibrate(seen, [board])
        view = middle_view(result)
        sigma = length_sigma(result, [board], view)
        frame = board_frame(result, [board], view)
        points = block @ frame[:3, :3].T + frame[:3, 3]
        pixels = np.stack([project(camera, points) for camera in cameras_of(seen, truth)])
        measured = triangulate(Rig(result.cameras, 0, ""), pixels, 0.1).point
        offsets = points - points.mean(axis=0)
        gradient = np.linalg.lstsq(offsets, measured - points, rcond=None)[0]
        ratios.append(np.abs(np.linalg.eigvalsh(gradient + gradient.T)).max() / 2.0 / sigma)
        check = length_check(result)
        assert check is not None
        # Three quarters of the views have a larger sigma, and four boards have their own noise.
        assert abs(check[1]) < 5.0 * sigma
    # Of 24 draws 1.17 (0.97 in the worst direction itself), and of twelve within a factor of 1.5.
    assert 0.78 < np.sqrt(np.mean(np.square(ratios))) < 1.75


def test_what_is_missing_is_said() -> None:
    seen, board, _ = _synthetic(13, cameras=1)
    quality = camera_quality(calibrate(seen, [board]))[0]
    assert quality.views == 14
    assert quality.noise == pytest.approx(0.1, rel=0.1)
    low = seen.corners.pixel[:, 0] < 0.6 * 1280
    corners = seen.corners.chosen(low)
    enough = np.bincount(corners.view, minlength=14) >= 12
    low[low] = enough[corners.view]
    corners = seen.corners.chosen(low)
    views, number = np.unique(corners.view, return_inverse=True)
    part = replace(
        seen, corners=replace(corners, view=number), mark=seen.mark[low],
        views=tuple(seen.views[v] for v in views), targets=(0,) * len(views),
    )  # fmt: skip
    missing = " ".join(camera_quality(calibrate(part, [board]))[0].missing)
    assert "upper right" in missing
    assert "lower right" in missing
    assert "middle centre" not in missing


def test_errors_of_pictures_and_of_regions_are_the_same_errors() -> None:
    """Summed over one camera's views they are those summed over its nine regions; a mark that is
    beside its place is counted in its own picture, and is in neither."""
    seen, board, _ = _synthetic(15, cameras=2)
    corners = seen.corners
    beside = np.flatnonzero((corners.camera == 1) & (corners.view == 3))[5]
    pixel = corners.pixel.copy()
    pixel[beside] += [6.0, -4.0]
    made = calibrate(replace(seen, corners=replace(corners, pixel=pixel)), [board])
    pictures = picture_errors(made)
    odd = [
        picture for picture in pictures if (picture.camera, picture.view) == ("c1", seen.views[3])
    ]
    assert [picture.rejected for picture in odd] == [1]
    for quality in camera_quality(made):
        mine = [picture for picture in pictures if picture.camera == quality.name]
        assert sum(picture.corners for picture in mine) == quality.corners
        by_view = sum((picture.corners - picture.rejected) * picture.rms**2 for picture in mine)
        by_region = np.nansum(quality.seen * quality.rms**2)
        assert by_view == pytest.approx(by_region, rel=1e-12)
        # Two coordinates of 0.1 px.
        assert max(picture.rms for picture in mine) < 0.2


def test_covariance_goes_with_its_names(tmp_path: Path) -> None:
    seen, board, _ = _synthetic(14, cameras=2)
    result = calibrate(seen, [board])
    write_calibration(tmp_path, result)
    with np.load(tmp_path / "rig_covariance.npz") as stored:
        assert stored["names"].tolist() == list(result.names)
        assert stored["covariance"].shape == (24, 24)
        np.testing.assert_array_equal(stored["covariance"], result.covariance)
    sigma = dict(zip(result.names, np.sqrt(np.diag(result.covariance)), strict=True))
    # 14 views of 63 corners of 0.1 px: a focal length of 1800 px to about half a pixel.
    assert 0.05 < sigma["c0.fx"] < 2.0
    assert sigma["c1.tx"] < 1e-4

"""What a bench does wrong before its cameras: one message each, with what to do."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.boards import (
    SIZE,
    board_points,
    draw_board,
    seen_corners,
    sightings,
    true_bundle,
)
from palpate.calibration import (
    Charuco,
    Chessboard,
    baseline_text,
    calibrate,
    find_boards,
    find_pictures,
    timing_note,
)
from palpate.calibration.adjustment import Bundle, seen_points
from palpate.calibration.sightings import Sightings
from palpate.errors import CalibrationError, RecordError

_BOARD = Chessboard(9, 7, 0.012)


def _found(seed: int, *, tilts: float | None = None) -> tuple[Sightings, Bundle]:
    """Boards before two cameras; tilted to all sides, or only to the right by so many degrees."""
    rng = np.random.default_rng(seed)
    truth = true_bundle(rng, cameras=2, views=14)
    middle = _BOARD.points.mean(axis=0)
    if tilts is not None:
        for v in range(14):
            angle = np.deg2rad(tilts * v / 14.0)
            turn = [[np.cos(angle), 0.0, -np.sin(angle)], [0.0, 1.0, 0.0],
                    [np.sin(angle), 0.0, np.cos(angle)]]  # fmt: skip
            truth.view[v, :3, :3] = turn
    truth.view[:, :3, 3] -= np.einsum("vij,j->vi", truth.view[:, :3, :3], middle)
    corners = seen_corners(truth, board_points() + middle, rng, noise=0.1)
    return sightings(corners, _BOARD, 2), truth


def test_no_board_in_any_picture(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for c in ("c0", "c1"):
        (tmp_path / c).mkdir()
        cv2.imwrite(str(tmp_path / c / "01.png"), rng.integers(0, 255, (60, 80)))
    with pytest.raises(CalibrationError, match="no board was found in any of 2 pictures") as caught:
        find_boards(find_pictures(tmp_path), [_BOARD])
    assert "columns and rows" in str(caught.value)


@pytest.mark.slow
def test_a_blurred_picture_is_named_and_left_out(tmp_path: Path) -> None:
    """Five pictures as sharp as a sensor draws them, noisy, and one that was moved by 12 px."""
    board = Charuco(7, 5, 0.016, 0.012)
    truth = true_bundle(np.random.default_rng(7), cameras=1, views=6)
    intrinsics = truth.intrinsics[0] * [0.5, 0.5, 0.5, 0.5, 1, 1, 1, 1, 1]
    (tmp_path / "c0").mkdir()
    for v, view in enumerate(truth.view):
        pose = view.copy()
        pose[:3, 3] = [0.0, 0.0, 0.36] - view[:3, :3] @ board.points.mean(axis=0)
        picture = draw_board(
            board.drawing(40), (7 * 0.016, 5 * 0.016), intrinsics, pose, (640, 512),
            rng=np.random.default_rng(v), noise=8.0,
        )  # fmt: skip
        moved = cv2.blur(picture, (12, 1)) if v == 3 else picture
        cv2.imwrite(str(tmp_path / "c0" / f"{v:02d}.png"), moved)
    seen = find_boards(find_pictures(tmp_path), [board])
    assert seen.views == ("00", "01", "02", "04", "05")
    assert len(seen.notes) == 1
    assert "03.png: no board found, or blurred: its edges are" in seen.notes[0]


def test_a_camera_whose_folder_is_empty_is_left_out_and_said(tmp_path: Path) -> None:
    """Pictures not copied, or of a kind that is not read; a hidden folder is no camera's."""
    board = Charuco(7, 5, 0.016, 0.012)
    drawn = cv2.copyMakeBorder(board.drawing(40), 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=255)
    for name in ("c0", "c1", "c2", ".cache"):
        (tmp_path / name).mkdir()
    (tmp_path / "c2" / "01.heic").write_bytes(b"not read")
    with pytest.raises(RecordError, match="has no pictures"):
        find_pictures(tmp_path)
    cv2.imwrite(str(tmp_path / "c0" / "01.png"), drawn)
    seen = find_boards(find_pictures(tmp_path), [board])
    assert seen.cameras == ("c0",)
    assert seen.views == ("01",)
    assert len(seen.notes) == 2
    for note, camera in zip(seen.notes, ("c1", "c2"), strict=True):
        assert f"camera '{camera}': its folder has no pictures (.png" in note


def test_swapped_pictures_of_one_view_are_named() -> None:
    seen, truth = _found(1)
    camera = seen.corners.camera
    swapped = np.where(seen.corners.view == 5, 1 - camera, camera)
    made = calibrate(replace(seen, corners=replace(seen.corners, camera=swapped)), [_BOARD])
    assert len(made.notes) == 1
    assert "view '05'" in made.notes[0]
    assert "'c0' and 'c1' look swapped" in made.notes[0]
    assert made.cameras[1].T_camera_object[0, 3] == pytest.approx(truth.camera[1, 0, 3], abs=1e-3)


def test_views_that_are_alike_say_which_tilts_are_missing() -> None:
    """All of them face the cameras: nothing tells the focal length."""
    seen, _ = _found(2, tilts=0.0)
    with pytest.raises(CalibrationError, match="too alike") as caught:
        calibrate(seen, [_BOARD])
    assert "to the right, to the left, up, down" in str(caught.value)


def test_a_board_of_another_size_is_told_by_the_baseline() -> None:
    """A board printed at 97 % was said to be whole: the cameras seem 3 % farther apart."""
    seen, truth = _found(3)
    made = calibrate(seen, [_BOARD])
    true = float(np.linalg.norm(truth.camera[1, :3, 3]))
    assert "mm apart by the boards" in baseline_text(made, true)
    with pytest.raises(CalibrationError, match=r"another size than was said, by a factor of 0\.9"):
        baseline_text(made, 0.9 * true)


def _shifted(seen: Sightings, truth: Bundle, shift: np.ndarray) -> np.ndarray:
    """How far pixels move when marks do, (m, 2) [px]; the shift is in the board's frame."""
    corners = seen.corners
    whole = truth.camera[corners.camera] @ truth.view[corners.view]
    moved = np.empty((len(corners.camera), 2))
    for c, intrinsics in enumerate(truth.intrinsics):
        of_camera = corners.camera == c
        turn, shifts = whole[of_camera, :3, :3], whole[of_camera, :3, 3]
        ends = [
            seen_points(intrinsics, np.einsum("nij,nj->ni", turn, mark[of_camera]) + shifts)[0]
            for mark in (corners.point, corners.point + shift)
        ]
        moved[of_camera] = ends[1] - ends[0]
    return moved


def _moving(seen: Sightings, truth: Bundle, late: np.ndarray) -> Sightings:
    """What is seen where each board moves by its own velocity, a millimetre or so."""
    corners, rng = seen.corners, np.random.default_rng(4)
    speed = rng.uniform(0.0, 1.5e-3, (len(seen.views), 1)) * rng.normal(size=(len(seen.views), 3))
    pixel = corners.pixel + _shifted(seen, truth, late[:, None] * speed[corners.view])
    return replace(seen, corners=replace(corners, pixel=pixel))


@pytest.mark.parametrize("seed", [4, 5])
def test_a_shutter_that_rolls_is_told(seed: int) -> None:
    """A board is where it is when the middle row is read."""
    seen, truth = _found(seed)
    late = seen.corners.pixel[:, 1] / SIZE[1] - 0.5
    said = timing_note(calibrate(_moving(seen, truth, late), [_BOARD]))
    assert "a shutter rolls; hold the board still" in said


@pytest.mark.parametrize("seed", [4, 5])
def test_a_camera_that_comes_late_is_told(seed: int) -> None:
    seen, truth = _found(seed)
    late = 0.1 * (seen.corners.camera == 1)
    said = timing_note(calibrate(_moving(seen, truth, late), [_BOARD]))
    assert "'c0' and 'c1' take theirs not at one instant" in said
    assert "one trigger" in said


@pytest.mark.parametrize("seed", [4, 5])
def test_boards_held_still_need_no_velocity(seed: int) -> None:
    """Of normal errors nothing is explained; of what a lens has beyond its model little; what a bow
    of half a millimetre leaves is as well explained by columns as by rows."""
    seen, truth = _found(seed)
    assert timing_note(calibrate(seen, [_BOARD])) == ""
    corners = seen.corners
    away = corners.point - _BOARD.points.mean(axis=0)
    bow = 5e-4 * np.outer((away**2).sum(axis=1) / 0.06**2, [0.0, 0.0, 1.0])
    wave = 0.15 * np.sin(corners.pixel[:, ::-1] / 50.0)
    for error in (wave, _shifted(seen, truth, bow)):
        odd = replace(seen, corners=replace(corners, pixel=corners.pixel + error))
        made = calibrate(odd, [_BOARD])
        assert made.adjusted.noise.min() > 0.12
        assert timing_note(made) == ""

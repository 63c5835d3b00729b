"""What a bench does wrong before its cameras: one message each, with what to do."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.boards import board_points, seen_corners, sightings, true_bundle
from palpate.calibration import (
    Chessboard,
    Sightings,
    baseline_text,
    calibrate,
    find_boards,
    find_pictures,
    motion_note,
)
from palpate.calibration.adjustment import Bundle
from palpate.errors import CalibrationError

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


def test_swapped_pictures_of_one_view_are_named() -> None:
    found, truth = _found(1)
    camera = found.corners.camera
    swapped = np.where(found.corners.view == 5, 1 - camera, camera)
    made = calibrate(replace(found, corners=replace(found.corners, camera=swapped)), [_BOARD])
    assert len(made.notes) == 1
    assert "view '05'" in made.notes[0]
    assert "'c0' and 'c1' look swapped" in made.notes[0]
    assert made.cameras[1].T_camera_object[0, 3] == pytest.approx(truth.camera[1, 0, 3], abs=1e-3)


def test_views_that_are_alike_say_which_tilts_are_missing() -> None:
    """All of them face the cameras: nothing tells the focal length."""
    found, _ = _found(2, tilts=0.0)
    with pytest.raises(CalibrationError, match="too alike") as caught:
        calibrate(found, [_BOARD])
    assert "to the right, to the left, up, down" in str(caught.value)


def test_a_board_of_another_size_is_told_by_the_baseline() -> None:
    """A board printed at 97 % was said to be whole: the cameras seem 3 % farther apart."""
    found, truth = _found(3)
    made = calibrate(found, [_BOARD])
    true = float(np.linalg.norm(truth.camera[1, :3, 3]))
    assert "mm apart by the boards" in baseline_text(made, true)
    with pytest.raises(CalibrationError, match=r"another size than was said, by a factor of 0\.9"):
        baseline_text(made, 0.9 * true)


def test_a_camera_that_comes_late_is_told_by_the_motion() -> None:
    """Boards of the second camera have moved on, each by its own speed; and by a speed that has
    nothing to do with it."""
    found, _ = _found(4)
    rng = np.random.default_rng(4)
    speed = rng.uniform(0.0, 1.5, 14)
    along = rng.uniform(0.0, 2.0 * np.pi, 14)
    moved = (speed * np.stack([np.cos(along), np.sin(along)]))[:, found.corners.view].T
    late = np.where((found.corners.camera == 1)[:, None], moved, 0.0)
    corners = replace(found.corners, pixel=found.corners.pixel + late)
    made = calibrate(replace(found, corners=corners), [_BOARD])
    said = motion_note(made, dict(zip(found.views, speed.tolist(), strict=True)))
    assert "grows with how fast the board moved" in said
    assert "one trigger" in said
    other = rng.uniform(0.0, 1.5, 14).tolist()
    assert motion_note(made, dict(zip(found.views, other, strict=True))) == ""

"""Videos of boards: still frames found, one view a place, lengths and names that do not fit."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.boards import draw_board, true_bundle
from palpate.app.cli import main
from palpate.calibration import Chessboard, find_videos
from palpate.errors import RecordError
from palpate.records import read_rig

_SIZE, _PLACES, _STILL, _MOVING = (320, 256), 5, 4, 3
_BOARD = Chessboard(7, 5, 0.016)
_WORDS = "--target chessboard --columns 7 --rows 5 --square 16mm --out"


def _texture() -> tuple[np.ndarray, tuple[float, float]]:
    """A chessboard with a white rim of a square."""
    squares = np.indices((_BOARD.rows + 1, _BOARD.columns + 1)).sum(axis=0) % 2
    whole = np.pad(squares, 1, constant_values=1)
    texture = (255 * np.kron(whole, np.ones((40, 40)))).astype(np.uint8)
    return texture, (whole.shape[1] * _BOARD.square, whole.shape[0] * _BOARD.square)


def _films(folder: Path) -> np.ndarray:
    """A board held still in some places and moved between; the true pose of the second camera."""
    rng = np.random.default_rng(5)
    truth = true_bundle(rng, cameras=2, views=_PLACES)
    texture, extent = _texture()
    folder.mkdir()
    for c, intrinsics in enumerate(truth.intrinsics):
        intrinsics = np.array([*(0.25 * intrinsics[:4]), *intrinsics[4:]])
        film = []
        for view in truth.view:
            view = view.copy()
            view[:3, 3] = [0.03, 0.0, 0.36] - view[:3, :3] @ [*(0.5 * np.array(extent)), 0.0]
            picture = draw_board(
                texture,
                extent,
                intrinsics,
                truth.camera[c] @ view,
                _SIZE,
                rng=rng,
                noise=0.0,
                parts=2,
            )
            for k in range(_MOVING):
                away = cv2.GaussianBlur(np.roll(picture, 4 * (k + 1), axis=1), (0, 0), 3.0)
                film.append(away)
            film += [picture] * _STILL
        writer = cv2.VideoWriter(
            str(folder / f"c{c}.avi"), cv2.VideoWriter.fourcc(*"FFV1"), 30.0, _SIZE
        )
        for grey in film:
            noisy = np.clip(grey + rng.normal(scale=1.5, size=grey.shape), 0, 255)
            writer.write(cv2.merge([np.rint(noisy).astype(np.uint8)] * 3))
        writer.release()
    return truth.camera[1]


@pytest.mark.slow
def test_still_frames_of_videos_give_the_rig(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pose = _films(tmp_path / "films")
    rig = tmp_path / "rig"
    assert main(["calibrate", str(tmp_path / "films"), *_WORDS.split(), str(rig)]) == 0
    said = capsys.readouterr()
    assert "frames show the board where another does" in said.err
    frames = sorted(path.stem for path in (rig / "frames" / "c0").iterdir())
    # Of every place one frame, and of those in which it is still.
    assert len(frames) == _PLACES
    assert all(int(name) % (_MOVING + _STILL) >= _MOVING for name in frames)
    pose_found = read_rig(rig).cameras[1].T_camera_object
    with np.load(rig / "rig_covariance.npz") as stored:
        sigma = dict(zip(stored["names"], np.sqrt(np.diag(stored["covariance"])), strict=True))
        assert stored["corner_noise"].max() < 0.15
    assert abs(pose_found[0, 3] - pose[0, 3]) < 4.0 * sigma["c1.tx"] < 2e-2


def test_videos_of_different_length_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "films").mkdir()
    for camera, frames in (("c0", 60), ("c1", 40)):
        writer = cv2.VideoWriter(
            str(tmp_path / "films" / f"{camera}.avi"), cv2.VideoWriter.fourcc(*"FFV1"), 30.0, _SIZE
        )
        for k in range(frames):
            writer.write(np.full((*_SIZE[::-1], 3), 100 + k, np.uint8))
        writer.release()
    words = ["calibrate", str(tmp_path / "films"), *_WORDS.split(), str(tmp_path / "rig")]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert "has 40 frames" in said
    assert "one trigger" in said


def test_two_videos_of_one_camera_are_refused(tmp_path: Path) -> None:
    (tmp_path / "c0").mkdir()
    for name in ("first.mp4", "second.mp4"):
        (tmp_path / "c0" / name).write_bytes(b"")
    with pytest.raises(RecordError, match="second video of camera 'c0'"):
        find_videos(tmp_path)

"""Frames of a recording: what is said of those that do not fit together."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate.errors import RecordError
from palpate.recording import footage
from palpate.recording.footage import Footage, read_frames

WIDE = np.arange(48, dtype=np.uint8).reshape(6, 8)
HIGH = WIDE.T.copy()


def test_a_frame_of_another_size_is_named_with_its_video(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    # Not every build of FFmpeg hands such frames over as they are; some scale them.
    frames = [(0.0, WIDE), (0.1, WIDE), (0.2, HIGH)]
    monkeypatch.setattr(footage, "video_frames", lambda _: iter(frames))
    video = Footage("c0", tmp_path / "c0.avi")
    words = r"c0\.avi: frame 2, counted from 0, has 6 x 8 pixels, frames before it 8 x 6"
    with pytest.raises(RecordError, match=words):
        list(read_frames(video))


def test_a_picture_of_another_size_is_named(tmp_path: Path) -> None:
    files = [tmp_path / f"{k}.png" for k in range(3)]
    for file, picture in zip(files, (WIDE, WIDE, HIGH), strict=True):
        cv2.imwrite(str(file), picture)
    pictures = Footage("c0", None, tuple(files), np.arange(3.0))
    with pytest.raises(RecordError, match=r"2\.png: has 6 x 8 pixels, pictures before it 8 x 6"):
        list(read_frames(pictures))


def test_times_are_read_in_the_unit_of_their_heading(tmp_path: Path) -> None:
    path = tmp_path / "c0.csv"
    path.write_text("frame,time [ms]\n0,40\n1,90\n")
    np.testing.assert_allclose(footage.read_times(path), [0.04, 0.09], rtol=1e-12)
    path.write_text("time [ms]\n40\n90\n")
    np.testing.assert_allclose(footage.read_times(path), [0.04, 0.09], rtol=1e-12)
    path.write_text("frame,time [h]\n0,0\n1,1\n")
    with pytest.raises(RecordError, match=r"is in 'h'; must be in one of s, ms"):
        footage.read_times(path)


def test_a_list_without_headings_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "c0.csv"
    path.write_text('""\n1\n2\n')
    with pytest.raises(RecordError, match=r"c0\.csv: line 1 has no headings"):
        footage.read_times(path)

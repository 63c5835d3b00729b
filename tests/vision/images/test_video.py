"""Frames of a video: all of them in order, or none and the reason."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate.errors import RecordError
from palpate.vision.images.video import video_frames

_SIZE = (64, 48)


def _film(path: Path, levels: list[int]) -> Path:
    """A lossless film of 25 frames a second, each frame of one grey level."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 25.0, _SIZE)
    for level in levels:
        writer.write(np.full((*_SIZE[::-1], 3), level, np.uint8))
    writer.release()
    return path


def test_every_frame_comes_once_in_order_with_its_time(tmp_path: Path) -> None:
    frames = list(video_frames(_film(tmp_path / "c0.avi", [10, 60, 110, 160])))
    assert [int(np.median(grey)) for _, grey in frames] == [10, 60, 110, 160]
    assert {grey.shape for _, grey in frames} == {_SIZE[::-1]}
    # To a microsecond: times are counted in milliseconds.
    np.testing.assert_allclose([time for time, _ in frames], np.arange(4) / 25.0, atol=1e-6)


def test_a_single_frame_is_refused_for_what_it_is_before_it_is_used(tmp_path: Path) -> None:
    frames = video_frames(_film(tmp_path / "c0.avi", [100]))
    with pytest.raises(RecordError, match=r"c0\.avi: only one frame can be decoded") as caught:
        next(frames)
    assert "convert it" in str(caught.value)

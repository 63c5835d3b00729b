"""Frames of a video, one at a time."""

import os
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from palpate.errors import RecordError
from palpate.files import checked_file

VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v")
# Silences FFmpeg's own messages on the terminal.
_QUIET = {"OPENCV_FFMPEG_LOGLEVEL": "-8"}
_CURE = "copy it again, or convert it, e.g. to MP4 with H.264 or to AVI with MJPEG"


def open_video(path: Path) -> "cv2.VideoCapture":
    """Open a video for reading.

    Parameters
    ----------
    path : Path

    Returns
    -------
    cv2.VideoCapture                to be released by the caller

    Raises
    ------
    RecordError                     the file does not exist or cannot be decoded as a video
    """
    checked_file(path)
    for name, value in _QUIET.items():
        os.environ.setdefault(name, value)
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise RecordError(
            f"{path}: cannot be decoded as a video ({path.stat().st_size} bytes); {_CURE}"
        )
    return capture


def video_frames(path: Path) -> Iterator[tuple[float, UInt8[np.ndarray, "_ _"]]]:
    """Iterate over all frames of a video, holding no more than two in memory.

    Parameters
    ----------
    path : Path

    Yields
    ------
    float [s], (rows, columns) uint8    time stamp in the file, grey levels

    Raises
    ------
    RecordError                     as `open_video`; or fewer than two frames can be decoded, which
                                    is raised before the first one is yielded
    """
    capture = open_video(path)
    try:
        frames = _decoded(capture)
        begun = list(islice(frames, 2))
        if not begun:
            raise RecordError(f"{path}: not one frame can be decoded; {_CURE}")
        if len(begun) == 1:
            raise RecordError(f"{path}: only one frame can be decoded, two are needed; {_CURE}")
        while begun:
            yield begun.pop(0)
        yield from frames
    finally:
        capture.release()


def _decoded(capture: "cv2.VideoCapture") -> Iterator[tuple[float, UInt8[np.ndarray, "_ _"]]]:
    """Time stamp and grey levels of every frame up to the first that cannot be decoded."""
    while True:
        good, picture = capture.read()
        if not good:
            return
        grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        yield capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3, np.asarray(grey)

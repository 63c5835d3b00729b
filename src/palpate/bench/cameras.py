"""Cameras whose pictures a child process sends; those that OpenCV opens: by number, a film, or a
stream of the network.

Drivers and decoders are not ours, and what a network camera sends may be anything: they run in a
child process with limits (`foreign.py`), which also is what ends when a camera is pulled out.
"""

import os
import sys
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from threading import Condition, Thread
from typing import Any

import numpy as np

from palpate.bench.devices import DeviceError, Picture
from palpate.foreign import results_in_child
from palpate.optional_imports import late_import
from palpate.records import TomlTable

# Longest time until the first picture, and between two pictures [s].
_OPENS, _NEXT = 20.0, 5.0
# Linux's cameras.
_FILE = "/dev/video{}"
# Sources of the network, and the formats that FFmpeg may take them for.
STREAMS = ("rtsp://", "http://", "https://")
_FORMATS = "mpjpeg,mjpeg,rtsp,rtp,sdp,mpegts,h264,hevc"


def live_pictures(source: int | str, size: tuple[int, int] | None) -> Iterator[Any]:
    """Pictures of a camera as they come; runs in a child.

    Parameters
    ----------
    source : int or str             number of a camera, address of a stream, or a film, which is
                                    played at its own pace
    size : (columns, rows) or None  to ask for; None: as the camera has it

    Yields
    ------
    (rows, columns) uint8, float [s]    grey levels, and when they arrived

    Raises
    ------
    RuntimeError                    it does not open, or ends
    """
    cv2 = late_import("cv2", extra=None, purpose="cameras")
    is_stream = isinstance(source, str) and source.startswith(STREAMS)
    if is_stream:
        os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = f"format_whitelist;{_FORMATS}"
    capture = cv2.VideoCapture(source) if isinstance(source, int) else (
        cv2.VideoCapture(source, cv2.CAP_FFMPEG)
    )  # fmt: skip
    if size is not None:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
    if not capture.isOpened():
        raise RuntimeError(f"it does not open{_unopened(source)}")
    begun = time.monotonic()
    while True:
        good, picture = capture.read()
        if not good:
            raise RuntimeError("it has stopped sending")
        if isinstance(source, str) and not is_stream:
            due = begun + capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
            time.sleep(max(due - time.monotonic(), 0.0))
        grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        yield np.asarray(grey), time.monotonic()


def shown_cameras() -> list[str]:
    """The cameras that Linux shows as files; their numbers are what a source can be."""
    every = Path(_FILE.format("*"))
    return [str(file) for file in sorted(every.parent.glob(every.name))]


def _unopened(source: int | str) -> str:
    """Why a camera with a number does not open, where Linux shows it as a file."""
    if not (isinstance(source, int) and sys.platform == "linux"):
        return ""
    file = Path(_FILE.format(source))
    if not file.exists():
        return f": there is no {file}, but {', '.join(shown_cameras()) or 'no camera at all'}"
    if not os.access(file, os.R_OK | os.W_OK):
        return f": you may not use {file}; join its group, {file.group()}"
    return f", though {file} is there: another program has it, or it is no camera"


class LiveCamera:
    """A camera, film or stream; the newest picture is kept, older ones are let go.

    Parameters
    ----------
    name : str                      of its camera in the rig
    pictures : callable             a generator like `live_pictures`, which runs in a child
    source : int or str             its first argument
    *others                         its other arguments
    """

    def __init__(
        self, name: str, pictures: Callable[..., Iterator[Any]], source: int | str, *others: Any
    ) -> None:
        self.name, self.source, self._work = name, source, (pictures, source, *others)
        self._new = Condition()
        self._latest: tuple[Picture, float] | None = None
        self._error, self._stopping = "", False
        self._shown = (0, 0)
        self._pictures: Generator[Any, None, None] | None = None
        self._reader: Thread | None = None

    def start(self) -> None:
        """Open the camera and wait for its first picture.

        Raises
        ------
        DeviceError                 none comes
        """
        self.close()
        self._error, self._latest, self._stopping = "", None, False
        self._pictures = results_in_child(*self._work, seconds=_OPENS)
        self._reader = Thread(target=self._receive, args=(self._pictures,), daemon=True)
        self._reader.start()
        picture, _ = self._waited(_OPENS + 1.0)
        self._shown = picture.shape[1], picture.shape[0]

    def grab(self) -> tuple[Picture, float]:
        """As in `Camera`."""
        return self._waited(_NEXT)

    @property
    def settings(self) -> Mapping[str, str]:
        """Source and size of the pictures."""
        return {"source": str(self.source), "size": "{} x {}".format(*self._shown)}

    def close(self) -> None:
        """As in `Camera`."""
        if self._reader is not None:
            self._stopping = True
            self._reader.join()
            self._reader = None

    def _receive(self, pictures: Generator[Any, None, None]) -> None:
        """Keep the newest picture until the child ends; runs in a thread."""
        try:
            for newest in pictures:
                with self._new:
                    self._latest = newest
                    self._new.notify()
                if self._stopping:
                    break
        # Whatever ends the camera is said where the next picture is asked for.
        except Exception as error:  # noqa: BLE001
            with self._new:
                self._error = str(error) or type(error).__name__
                self._new.notify()
        finally:
            with suppress(RuntimeError):
                pictures.close()

    def _waited(self, seconds: float) -> tuple[Picture, float]:
        """The newest picture that was not given yet."""
        with self._new:
            self._new.wait_for(lambda: self._latest is not None or self._error, timeout=seconds)
            newest, self._latest = self._latest, None
        if newest is not None:
            return newest
        reason = self._error or f"no picture for {seconds:g} s"
        raise DeviceError(
            f"camera '{self.name}' ({self.source}): {reason}; see that it is plugged in and that no"
            " other program uses it, then go on"
        )


def opencv_camera(table: TomlTable) -> LiveCamera:
    """The camera of its table in bench.toml."""
    table.check_keys(("name", "driver", "source", "size"))
    source = table.get("source")
    if type(source) is int:
        source = table.count("source")
    else:
        source = table.text("source")
        if not source.startswith(STREAMS):
            source = str(table.existing_file("source"))
    return LiveCamera(table.text("name"), live_pictures, source, picture_size(table))


def picture_size(table: TomlTable) -> tuple[int, int] | None:
    """Columns and rows that a camera is asked for; None: as it has them."""
    size = table.optional("size", lambda key: tuple(table.each(TomlTable.count, key)))
    if size is None:
        return None
    if len(size) != 2 or 0 in size:
        table.fail("size", f"is {list(size)}; must be [columns, rows], in pixels")
    return size[0], size[1]

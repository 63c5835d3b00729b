"""Decoding of pictures with OpenCV, whose codecs write their complaints to the error stream.

The codecs behind it (libjpeg, libpng, libtiff) return a picture from damaged data and mention the
damage on the process's error stream only. That stream is led into a file while one picture is
decoded: nothing of it reaches the terminal, and the damage becomes known.
"""

import os
import re
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress

import cv2
import numpy as np

# The error stream belongs to the whole process: one at a time may lead it elsewhere.
_ONE_AT_A_TIME = threading.Lock()
_ERROR_STREAM = 2
_FROM_CODECS = re.compile(r"JPEG|libpng|TIFF|imgcodecs|grfmt|imdecode|\[ *(WARN|ERROR|INFO):")
# Warnings, such as one about an unknown tag, say nothing about the pixels.
_DAMAGE = re.compile(r"Corrupt JPEG|[Pp]remature end|ERROR|error")


def decode_picture(content: bytes) -> tuple[np.ndarray | None, str | None]:
    """Pixels of a picture as they are stored: not converted, not turned.

    Parameters
    ----------
    content : bytes                 the whole file

    Returns
    -------
    array or None                   (rows, columns) or (rows, columns, channels) with the channels
                                    blue, green, red, alpha; None where nothing could be decoded
    str or None                     what the codec says is damaged, if anything
    """
    pixels, said = _quietly(
        lambda: cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    )
    damage = [line.strip() for line in said if _DAMAGE.search(line)]
    return pixels, damage[0] if damage else None


def _quietly(
    decode: Callable[[], np.ndarray | None],
) -> tuple[np.ndarray | None, list[str]]:
    """Call a decoder with the error stream led into a file; what others wrote is passed on."""
    with _ONE_AT_A_TIME, tempfile.TemporaryFile() as aside:
        try:
            kept = os.dup(_ERROR_STREAM)
        except OSError:  # there is no error stream to keep clean
            return _decoded(decode), []
        try:
            os.dup2(aside.fileno(), _ERROR_STREAM)
            pixels = _decoded(decode)
        finally:
            os.dup2(kept, _ERROR_STREAM)
            os.close(kept)
        aside.seek(0)
        lines = aside.read().decode(errors="replace").splitlines(keepends=True)
    others = "".join(line for line in lines if not _FROM_CODECS.search(line))
    if others:
        with suppress(OSError):
            os.write(_ERROR_STREAM, others.encode())
    return pixels, [line for line in lines if _FROM_CODECS.search(line)]


def _decoded(decode: Callable[[], np.ndarray | None]) -> np.ndarray | None:
    try:
        return decode()
    except cv2.error:
        return None

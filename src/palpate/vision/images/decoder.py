"""Decoding of picture files with OpenCV, with detection of damaged files.

The codecs behind OpenCV (libjpeg, libpng, libtiff) report damage only on the process's standard
error; libjpeg even returns a picture, whose lower part is grey and would be taken for the object.
Standard error is therefore redirected to a file while a picture is decoded, so that nothing reaches
the terminal and damage is detected.
"""

import os
import re
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import cv2
import numpy as np

from palpate.errors import RecordError
from palpate.vision.images.picture_size import BMP, JPEG, PNG, TIFF, picture_count

PICTURE_KINDS = "PNG, JPEG, TIFF or BMP"
# JPEG markers: start of the coded data of a scan, and end of the image.
_START_OF_SCAN, _END_OF_IMAGE = b"\xff\xda", b"\xff\xd9"
# Standard error belongs to the whole process: only one thread at a time may redirect it.
_ONE_AT_A_TIME = threading.Lock()
_ERROR_STREAM = 2
_FROM_CODECS = re.compile(r"JPEG|libpng|TIFF|imgcodecs|grfmt|imdecode|\[ *(WARN|ERROR|INFO):")
# Warnings, such as one about an unknown tag, say nothing about the pixels.
_DAMAGE = re.compile(r"Corrupt JPEG|[Pp]remature end|ERROR|error")
# Prefix of an OpenCV message: the place in its sources.
_SOURCE = re.compile(r"^\[.*?\] global \S+ ")


def decode_picture(content: bytes) -> np.ndarray:
    """Decode the pixels of a file as stored: not converted, not rotated.

    Parameters
    ----------
    content : bytes                 the whole file

    Returns
    -------
    array                           (rows, columns) or (rows, columns, channels) with the channels
                                    blue, green, red, alpha

    Raises
    ------
    RecordError                     the file is empty, of an unknown type, truncated or damaged, or
                                    a TIFF with several pictures; the message continues a sentence
                                    that begins with the file's name
    """
    if not content:
        raise RecordError("is empty; copy or record it again")
    if not content.startswith((PNG, JPEG, BMP, *TIFF)):
        raise RecordError(
            f"is none of {PICTURE_KINDS} (it starts with {content[:8]!r}); copy or record it again"
        )
    if (count := picture_count(content)) > 1:
        raise RecordError(f"holds {count} pictures; give each a file of its own")
    pixels = None
    buffer = np.frombuffer(content, dtype=np.uint8)
    with _codec_messages() as messages, suppress(cv2.error):
        pixels = cv2.imdecode(buffer, cv2.IMREAD_UNCHANGED)
    damage = [_SOURCE.sub("", line.strip()) for line in messages if _DAMAGE.search(line)]
    # The end marker 0xFF 0xD9 cannot occur within coded data.
    if content.startswith(JPEG) and content.rfind(_END_OF_IMAGE) < content.rfind(_START_OF_SCAN):
        damage.insert(0, "it has no end-of-image marker")
    if damage or pixels is None:
        said = f" ({damage[0]})" if damage else ""
        raise RecordError(
            f"is cut off or damaged, or of a kind that cannot be decoded{said}; it has"
            f" {len(content)} bytes: copy or record it again"
        )
    return pixels


@contextmanager
def _codec_messages() -> Iterator[list[str]]:
    """Redirect standard error to a file; on exit the list holds the codecs' messages.

    Anything else written there meanwhile is passed on.
    """
    messages: list[str] = []
    with _ONE_AT_A_TIME, tempfile.TemporaryFile() as aside:
        try:
            kept = os.dup(_ERROR_STREAM)
        except OSError:  # standard error is closed
            yield messages
            return
        try:
            os.dup2(aside.fileno(), _ERROR_STREAM)
            yield messages
        finally:
            os.dup2(kept, _ERROR_STREAM)
            os.close(kept)
        aside.seek(0)
        lines = aside.read().decode(errors="replace").splitlines(keepends=True)
        messages += [line for line in lines if _FROM_CODECS.search(line)]
        others = [line for line in lines if line.strip() and not _FROM_CODECS.search(line)]
        with suppress(OSError):
            os.write(_ERROR_STREAM, "".join(others).encode())

"""Sizes that headers claim, against what encoders put into them."""

import resource
import struct
import tracemalloc

import cv2
import numpy as np
import pytest

from palpate.errors import RecordError
from palpate.records import Camera, Rig
from palpate.vision.images.picture_file import claimed_size, decode_picture
from palpate.vision.images.pictures import read_pictures

GREY = np.arange(12 * 20, dtype=np.uint8).reshape(12, 20)


def _encoded(kind: str, pixels: np.ndarray = GREY) -> bytes:
    return cv2.imencode(kind, pixels)[1].tobytes()


def _old_bmp() -> bytes:
    return b"BM" + struct.pack("<IHHI", 26, 0, 0, 26) + struct.pack("<IHHHH", 12, 20, 12, 1, 8)


def _large_tiff() -> bytes:
    """BigTIFF in the other byte order: a directory of two entries."""
    entries = struct.pack(">HHQQ", 256, 16, 1, 20) + struct.pack(">HHQI4x", 257, 4, 1, 12)
    return b"MM\0+" + struct.pack(">HHQQ", 8, 0, 16, 2) + entries


@pytest.mark.parametrize("kind", [".png", ".jpg", ".tif", ".bmp"])
def test_the_size_is_that_of_the_pixels(kind):
    assert claimed_size(_encoded(kind)) == (20, 12)
    assert claimed_size(_encoded(kind, np.dstack([GREY] * 3))) == (20, 12)


def test_rare_headers_are_known():
    assert claimed_size(_old_bmp()) == (20, 12)
    assert claimed_size(_large_tiff()) == (20, 12)


@pytest.mark.parametrize("kind", [".png", ".jpg", ".tif", ".bmp"])
def test_a_header_cut_off_anywhere_has_none_or_the_right_one(kind):
    content = _encoded(kind)
    assert {claimed_size(content[:end]) for end in range(len(content))} <= {None, (20, 12)}


def test_a_size_that_no_camera_has_is_refused_before_memory_is_taken(tmp_path):
    content = bytearray(_encoded(".png"))
    content[16:24] = struct.pack(">II", 30_000, 30_000)
    (tmp_path / "s_c0.png").write_bytes(content)
    beside = np.eye(4)
    beside[0, 3] = -0.1
    first, second = (
        Camera(name, None, np.diag([50.0, 50.0, 1.0]), np.zeros(8), pose)
        for name, pose in (("c0", np.eye(4)), ("c1", beside))
    )
    rig = Rig((first, second), 0, "rig.toml")
    tracemalloc.start()
    with pytest.raises(RecordError, match=r"camera 'c0': .*s_c0\.png: has 30000 x 30000 pixels"):
        read_pictures(rig, "s_{camera}.png", folder=tmp_path, what="step 's'")
    # Of the 900 MB that it claims.
    assert tracemalloc.get_traced_memory()[1] < 1e6
    tracemalloc.stop()


@pytest.mark.parametrize("length", [100, 0xF4002F49, 0x7FFFFFFF])
def test_a_chunk_longer_than_its_file_takes_no_memory(length):
    content = _encoded(".png")
    place = content.index(b"IDAT") - 4
    damaged = content[:place] + struct.pack(">I", length + len(content)) + content[place + 4 :]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(RecordError, match=r"is cut off or damaged.*it has \d+ bytes"):
        decode_picture(damaged)
    # Kilobytes: OpenCV would take four gigabytes for the longest.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000


def test_what_follows_the_end_of_a_png_does_not_matter():
    np.testing.assert_array_equal(decode_picture(_encoded(".png") + b"more"), GREY)

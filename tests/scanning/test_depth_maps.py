"""Depth maps: points along the camera's axis, and files that hold something else."""

import cv2
import numpy as np
import pytest

from palpate.errors import RecordError
from palpate.records import Camera
from palpate.scanning import depth_points

LEVELS = np.full((12, 16), 800, dtype=np.uint16)
CAMERA = Camera("c0", (16, 12), np.diag([20.0, 20.0, 1.0]), np.zeros(8), np.eye(4))


def _points(path):
    return depth_points(path, CAMERA, metres_per_level=1e-3)


@pytest.mark.parametrize("name", ["depth.png", "depth.tif", "depth.npy"])
def test_every_format_gives_the_same_points(tmp_path, name):
    path = tmp_path / name
    if path.suffix == ".npy":
        np.save(path, LEVELS)
    else:
        cv2.imwrite(str(path), LEVELS)
    found = _points(path)
    assert len(found) == LEVELS.size
    np.testing.assert_allclose(found[:, 2], 0.8)
    # The last pixel, at (15, 11), is 15 / 20 and 11 / 20 of the depth beside the axis.
    np.testing.assert_allclose(found[-1], [0.6, 0.44, 0.8])


def test_several_maps_in_one_file_are_refused(tmp_path):
    _, pages = cv2.imencodemulti(".tif", [LEVELS, LEVELS])
    (tmp_path / "depth.tif").write_bytes(pages.tobytes())
    with pytest.raises(RecordError, match=r"depth map: .*depth\.tif: holds 2 pictures"):
        _points(tmp_path / "depth.tif")


def test_an_array_that_is_cut_off_is_refused(tmp_path):
    np.save(tmp_path / "depth.npy", LEVELS)
    content = (tmp_path / "depth.npy").read_bytes()
    (tmp_path / "depth.npy").write_bytes(content[:-8])
    with pytest.raises(RecordError, match=r"depth\.npy: .*384 bytes, and holds 376"):
        _points(tmp_path / "depth.npy")

"""Points come back from every format and from depth maps; other files are refused."""

import struct

import cv2
import numpy as np
import pye57
import pytest
import trimesh

from palpate.errors import RecordError
from palpate.records import Camera
from palpate.scanning import read_points
from palpate.scanning.scan_file import depth_points

POINTS = np.random.default_rng(0).normal(size=(40, 3))
LEVELS = np.full((12, 16), 800, dtype=np.uint16)
CAMERA = Camera("c0", (16, 12), np.diag([20.0, 20.0, 1.0]), np.zeros(8), np.eye(4))


def pcd(path, kind):
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS intensity x y z\nSIZE 1 4 4 4\nTYPE U F F F\n"
        f"COUNT 1 1 1 1\nWIDTH 40\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 40\nDATA {kind}\n"
    ).encode()
    if kind == "ascii":
        body = "".join(f"7 {x!r} {y!r} {z!r}\n" for x, y, z in POINTS.tolist()).encode()
    else:
        body = b"".join(struct.pack("<B3f", 7, *row) for row in POINTS)
    path.write_bytes(head + body)


def write(path, how, *, scans=1):
    if how == "ply":
        path.write_bytes(trimesh.PointCloud(POINTS).export(file_type="ply"))
    elif how == "e57":
        file = pye57.E57(str(path), mode="w")
        axes = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), POINTS.T.copy(), strict=True))
        for _ in range(scans):
            file.write_scan_raw(axes)
        file.close()
    elif how == "npy":
        np.save(path, POINTS)
    elif how == "csv":
        np.savetxt(path, POINTS, delimiter=",", header="x,y,z", comments="")
    elif how == "xyz":
        np.savetxt(path, np.column_stack([POINTS, np.full(40, 255)]))
    else:
        pcd(path, how)


@pytest.mark.parametrize("how", ["ply", "npy", "csv", "xyz", "ascii", "binary"])
def test_points_come_back(tmp_path, how):
    path = tmp_path / f"scan.{'pcd' if how in ('ascii', 'binary') else how}"
    write(path, how)
    # Binary formats hold single precision.
    np.testing.assert_allclose(
        read_points(path, metres_per_unit=1e-3), 1e-3 * POINTS, rtol=2e-6, atol=1e-9
    )


def test_what_the_scanner_did_not_measure_is_left_out(tmp_path):
    path = tmp_path / "scan.xyz"
    path.write_text("nan nan nan\n0 0 0\n0 0 0\n1 2 3\n1 2 4\n")
    np.testing.assert_array_equal(read_points(path), [[1, 2, 3], [1, 2, 4]])


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("scan.las", b"", "not read; convert it to one of .ply .pcd"),
        ("scan.xyz", b"1 2 3\n4 five 6\n", "line 2: '4 five 6' is no row of numbers"),
        ("scan.xyz", b"", "holds no points"),
        ("scan.ply", b"ply\nformat ascii", "cannot be read as points of type PLY"),
        ("scan.pcd", b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nDATA binary_compressed\n",
         "save it as ascii or binary"),
        ("scan.xyz", b"1e9 0 1\n1e9 5 1\n", "check the unit"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(RecordError) as raised:
        read_points(path)
    assert words in str(raised.value)


def _points(path):
    return depth_points(path, CAMERA, metres_per_level=1e-3)


@pytest.mark.parametrize("name", ["depth.png", "depth.tif", "depth.npy"])
def test_every_format_gives_the_same_points(tmp_path, name):
    path = tmp_path / name
    if path.suffix == ".npy":
        np.save(path, LEVELS)
    else:
        cv2.imwrite(str(path), LEVELS)
    points = _points(path)
    assert len(points) == LEVELS.size
    np.testing.assert_allclose(points[:, 2], 0.8)
    # The last pixel, at (15, 11), is 15 / 20 and 11 / 20 of the depth beside the axis.
    np.testing.assert_allclose(points[-1], [0.6, 0.44, 0.8])


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

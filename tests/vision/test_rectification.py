"""Rectified cameras against their laws, OpenCV, and pictures rendered directly."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from vision_cameras import BARREL, RATIONAL, make_camera

from palpate.errors import CalibrationError, InputError
from palpate.records.programs.registry import read_rig
from palpate.vision.projection import project, rays
from palpate.vision.rectification import rectify, remapped

SHAPE = (240, 320)
EXACT = 1e-9  # px, what the issue asks for


def _at(name, centre, *, lens=(), roll=0.0, focal=500.0, target=(0.0, 0.0, 0.0), skew=0.4):
    """A camera at `centre` that looks at `target`, its rows along the object's x but for a roll."""
    z = np.subtract(target, centre) / np.linalg.norm(np.subtract(target, centre))
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    rotation = cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0] @ rotation
    camera = make_camera(name, lens=lens, focal=focal, skew=skew, size=(SHAPE[1], SHAPE[0]))
    matrix = camera.matrix.copy()
    matrix[:2, 2] = 161.3, 117.8
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ np.array(centre)
    return replace(camera, matrix=matrix, T_camera_object=pose)


def _pair():
    return (
        _at("a", (0.05, 0.01, -0.6), lens=RATIONAL, roll=0.05),
        _at("b", (-0.08, 0.02, -0.55), lens=BARREL, roll=-0.03, focal=540.0),
    )


def _triple():
    """An L of 79 degrees, each camera turned and looking inwards."""
    return (
        _at("c0", (0.0, 0.0, -0.6), lens=RATIONAL, roll=0.04),
        _at("c1", (-0.09, 0.005, -0.62), lens=BARREL, roll=-0.02, focal=520.0),
        _at("c2", (0.012, -0.1, -0.58), lens=(), roll=0.02, focal=480.0),
    )


def _points(count=300, seed=0):
    return np.random.default_rng(seed).uniform(-0.06, 0.06, (count, 3))


def _seen(rectified, points):
    return [project(camera, points) for camera in rectified.cameras]


def test_a_point_shares_its_row_in_a_pair():
    a, b = _seen(rectify(_pair(), SHAPE), _points())
    np.testing.assert_allclose(a[:, 1], b[:, 1], rtol=0.0, atol=EXACT)
    assert np.ptp(a[:, 1]) > 50.0
    assert np.ptp(a[:, 0] - b[:, 0]) > 5.0


def test_a_point_shares_its_row_with_the_left_and_its_column_with_the_top_camera():
    rectified = rectify(_triple(), SHAPE)
    reference, left, top = _seen(rectified, _points())
    np.testing.assert_allclose(left[:, 1], reference[:, 1], rtol=0.0, atol=EXACT)
    np.testing.assert_allclose(top[:, 0], reference[:, 0], rtol=0.0, atol=EXACT)
    assert np.ptp(left[:, 0] - reference[:, 0]) > 5.0
    assert np.ptp(top[:, 1] - reference[:, 1]) > 5.0


def test_rectified_cameras_are_turned_and_not_moved():
    for given, rectified in (
        (_pair(), rectify(_pair(), SHAPE)),
        (_triple(), rectify(_triple(), SHAPE)),
    ):
        origin = np.zeros((1, 2))
        for before, after in zip(given, rectified.cameras, strict=True):
            np.testing.assert_allclose(rays(before, origin)[0], rays(after, origin)[0], atol=1e-15)
            # By less than 37 degrees about each axis: not upside down, not mirrored.
            both = before.T_camera_object[:3, :3] @ after.T_camera_object[:3, :3].T
            assert (np.diag(both) > 0.8).all()
            assert not after.distortion.any()
            assert after.name == before.name
            np.testing.assert_array_equal(after.matrix[:2, :2], rectified.cameras[0].matrix[:2, :2])


def test_pair_is_turned_about_its_baseline_as_opencvs():
    a, b = _pair()
    step = b.T_camera_object @ np.linalg.inv(a.T_camera_object)
    size = (SHAPE[1], SHAPE[0])
    turn = cv2.stereoRectify(
        a.matrix, a.distortion, b.matrix, b.distortion, size, step[:3, :3], step[:3, 3:]
    )[0]
    theirs = turn @ a.T_camera_object[:3, :3]
    ours = rectify((a, b), SHAPE).cameras[0].T_camera_object[:3, :3]
    # The baseline is the x axis of both; about it OpenCV halves the turn, we average the views:
    # the same but for terms of second order in the roll (0.08 rad).
    np.testing.assert_allclose(abs(theirs[0] @ ours[0]), 1.0, atol=1e-12)
    assert abs(theirs[2] @ ours[2]) > np.cos(0.02)


@pytest.mark.parametrize("kind", ["pair", "triple"])
def test_canvas_holds_the_whole_reference_picture(kind):
    cameras = _pair() if kind == "pair" else _triple()
    given, rectified = cameras[0], rectify(cameras, SHAPE)
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    pixels = np.stack([column.ravel(), row.ravel()], axis=1)
    origin, direction = rays(given, pixels)
    pixel = project(rectified.cameras[0], origin + direction)
    rows, columns = rectified.maps[0].shape[1:]
    assert rectified.cameras[0].size == (columns, rows)
    # Origin and size are set by the border itself: rounding only.
    assert pixel.min() > -1e-9
    assert (pixel.max(axis=0) < [columns - 1 + 1e-9, rows - 1 + 1e-9]).all()
    # Not wastefully large either: these turn by little.
    assert rows * columns < 2.0 * SHAPE[0] * SHAPE[1]
    assert len({coordinate.shape for coordinate in rectified.maps}) == 1


@pytest.mark.parametrize("kind", ["pair", "triple"])
def test_maps_lead_to_the_pixel_with_the_same_ray(kind):
    given = _pair() if kind == "pair" else _triple()
    rectified = rectify(given, SHAPE)
    for before, after, sources in zip(given, rectified.cameras, rectified.maps, strict=True):
        rows, columns = sources.shape[1:]
        row, column = np.mgrid[:rows:9, :columns:9].astype(np.float64)
        _, wanted = rays(after, np.stack([column.ravel(), row.ravel()], axis=1))
        pixel = sources[:, ::9, ::9].reshape(2, -1).T.astype(np.float64)
        inside = (pixel > -0.5).all(axis=1) & (pixel < [SHAPE[1], SHAPE[0]]).all(axis=1)
        assert inside.mean() > 0.4
        _, direction = rays(before, pixel[inside])
        # float32 holds a pixel of 300 to 1.5e-5 px, which is 3e-8 of a ray.
        np.testing.assert_allclose(direction, wanted[inside], atol=1e-7)


def _rendered(camera, size):
    """A plane of the object with a smooth texture, as a camera sees it."""
    columns, rows = size
    column, row = np.meshgrid(np.arange(columns, dtype=np.float64), np.arange(rows))
    origin, direction = rays(camera, np.stack([column.ravel(), row.ravel()], axis=1))
    normal = np.array([0.2, -0.1, 1.0])
    where = origin - (origin @ normal) / (direction @ normal)[:, None] * direction
    grey = 128.0 + 50.0 * np.sin(200.0 * where[:, 0]) * np.cos(170.0 * where[:, 1])
    return grey.reshape(rows, columns)


@pytest.mark.parametrize("kind", ["pair", "triple"])
def test_remapped_pictures_are_those_of_the_rectified_cameras(kind):
    given = _pair() if kind == "pair" else _triple()
    rectified = rectify(given, SHAPE)
    for index, (before, after) in enumerate(zip(given, rectified.cameras, strict=True)):
        taken = _rendered(before, (SHAPE[1], SHAPE[0])).astype(np.float32)
        picture = remapped(rectified, index, taken)
        wanted = _rendered(after, after.size)
        inside = np.isfinite(picture)
        assert inside.sum() > 0.7 * taken.size
        # Fifteen pixels in the spline knows nothing of the edge. Its error on a wave of 26 px is
        # (2 pi / 26)^4 / 384 of 50 grey levels, 5e-4; float32 places err by 2e-5 px of 17 levels.
        around, edge = np.ones((31, 31), np.uint8), cv2.BORDER_CONSTANT
        deep = cv2.erode(inside.astype(np.uint8), around, borderType=edge, borderValue=0) > 0
        assert deep.sum() > 0.5 * taken.size
        assert np.abs(picture - wanted)[deep].max() < 4e-3


def test_rendered_rig_of_three(shared_data):
    """Not quite an L: c1 left, c2 above, all aimed at the object."""
    rig = read_rig(shared_data / "halfball_images" / "rig.toml")
    rectified = rectify(rig.cameras, (480, 640))
    points = 0.03 * np.random.default_rng(0).normal(size=(100, 3))
    reference, left, top = _seen(rectified, points)
    np.testing.assert_allclose(left[:, 1], reference[:, 1], rtol=0.0, atol=EXACT)
    np.testing.assert_allclose(top[:, 0], reference[:, 0], rtol=0.0, atol=EXACT)
    assert abs(rectified.cameras[0].matrix[0, 1]) < 1.0  # a right angle: no skew


def test_what_cannot_be_rectified_is_refused():
    a, b = _pair()
    with pytest.raises(CalibrationError, match="'a' and 'c' have the same centre"):
        rectify((a, replace(a, name="c")), SHAPE)
    behind = _at("c", (0.1, 0.02, -1.2))
    with pytest.raises(CalibrationError, match="look along the line between them"):
        rectify((a, behind), SHAPE)
    c0, c1, _ = _triple()
    line = _at("c2", (0.2, 0.03, -0.6))
    with pytest.raises(CalibrationError, match=r"'c1' and 'c2' are 1\d\d\.\d degrees apart"):
        rectify((c0, c1, line), SHAPE)
    with pytest.raises(CalibrationError, match="look along the plane of their centres"):
        rectify((c0, c1, _at("c2", (0.01, 0.02, -1.2))), SHAPE)
    with pytest.raises(InputError, match="'a' has 320 x 240 pixels; asked for 640 x 480"):
        rectify((a, b), (480, 640))
    sideways = _at("b", (-0.3, 0.0, -0.6), target=(-1.0, 0.0, -0.59))
    with pytest.raises(CalibrationError, match="'b' looks elsewhere"):
        rectify((_at("a", (0.0, 0.0, -0.6)), sideways), SHAPE)

"""From the frame of a program onto the mesh: places, turned errors, points that are left out."""

import dataclasses

import numpy as np
import pytest
from surfaces import box

from palpate.errors import RecordError
from palpate.records import observed_rows, write_displacement
from palpate.records.files.displacement import read_displacement
from palpate.records.measured_points import (
    MeasuredPoints,
    in_object_frame,
    on_surface,
    read_import_pose,
)

SIDE = 0.04
NAN = np.full(3, np.nan)
TURN = "R = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]"


@pytest.fixture(scope="module")
def cube():
    return box(size=(SIDE, SIDE, SIDE), cells=8)


def _top(count=50):
    """Points of the upper face and displacements that differ everywhere."""
    rng = np.random.default_rng(5)
    points = SIDE * np.column_stack([rng.uniform(size=(count, 2)), np.ones(count)])
    return points, 1e-4 * rng.normal(size=(count, 3))


def _measured(points, moved, std=None):
    return MeasuredPoints(points, moved, std, source="a.csv", notes=("A note.",))


def _pose(axis=(1.0, 2.0, -0.5), angle=0.7, shift=(0.1, -0.2, 0.3)):
    """Rodrigues' rotation and a shift."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    pose = np.eye(4)
    pose[:3, :3] = np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k
    pose[:3, 3] = shift
    return pose


def test_pose_takes_points_to_the_object(cube):
    points, moved = _top()
    pose = _pose()
    elsewhere = (points - pose[:3, 3]) @ pose[:3, :3]
    placed = in_object_frame(_measured(elsewhere, moved @ pose[:3, :3]), pose)
    # Coordinates below 0.4 m, a few roundings of 5e-17 m.
    np.testing.assert_allclose(placed.points, points, atol=1e-15)
    np.testing.assert_allclose(placed.displacement, moved, atol=1e-18)
    imported = on_surface(placed, cube)
    assert imported.median_distance < 1e-15
    np.testing.assert_array_equal(imported.field.displacement, placed.displacement)
    assert imported.field.source == "a.csv"
    assert imported.notes == ("A note.",)


def test_errors_turn_with_the_frame():
    points, moved = _top(4)
    std = np.tile([1e-6, 2e-6, 8e-6], (4, 1))
    std[3] = np.nan
    moved[3] = np.nan
    pose = _pose()
    turned = in_object_frame(_measured(points, moved, std), pose).std
    covariance = pose[:3, :3] @ np.diag(std[0] ** 2) @ pose[:3, :3].T
    np.testing.assert_allclose(turned[0], np.sqrt(np.diag(covariance)), rtol=1e-13)
    assert np.isnan(turned[3]).all()


def test_a_quarter_turn_swaps_the_errors():
    points, moved = _top(2)
    pose = _pose(axis=(0, 0, 1), angle=np.pi / 2)
    turned = in_object_frame(
        _measured(points, moved, np.tile([1e-6, 2e-6, 8e-6], (2, 1))), pose
    ).std
    np.testing.assert_allclose(turned[0], [2e-6, 1e-6, 8e-6], rtol=1e-12)


def test_failed_points_stay_where_they_have_a_place(cube):
    points, moved = _top(20)
    moved[[0, 1, 2, 3, *range(4, 14)]] = np.nan
    points[4:14, 2] += 0.002
    points[1] = NAN
    points[2] = [0.0, 0.0, 0.5]
    imported = on_surface(_measured(points, moved), cube)
    counts = (imported.read, imported.failed, imported.without_position, imported.off_surface)
    assert counts == (20, 12, 2, 0)
    assert len(imported.field.points) == 18
    assert observed_rows(imported.field).sum() == 6
    # Of the measured points alone: the failed ones lie 2 mm above.
    assert imported.median_distance < 1e-15


def test_points_off_the_surface_need_leave(cube):
    points, moved = _top(20)
    std = np.full((20, 3), 1e-6)
    points[:3, 2] += 0.01
    measured = _measured(points, moved, std)
    with pytest.raises(RecordError, match=r"3 of 20 measured points.*--drop-off-surface.*--to-obj"):
        on_surface(measured, cube)
    imported = on_surface(measured, cube, drop_off_surface=True)
    assert (imported.off_surface, imported.failed, len(imported.field.points)) == (3, 0, 17)
    np.testing.assert_array_equal(imported.field.points, points[3:])
    assert imported.field.std.shape == (17, 3)
    assert imported.median_distance < 1e-15


@pytest.mark.parametrize("drop", [False, True])
def test_another_frame_is_refused_whatever_is_allowed(cube, drop):
    points, moved = _top()
    with pytest.raises(RecordError, match=r"frame of the program is not the object's.*--to-object"):
        on_surface(_measured(points + 0.1, moved), cube, drop_off_surface=drop)


@pytest.mark.parametrize("factor", [1e3, 1e-3])
def test_another_unit_is_told(cube, factor):
    points, moved = _top()
    # As a camera sees them: far from the origin.
    away = factor * points + np.array([0.0, 0.0, 0.3])
    with pytest.raises(RecordError, match=r"they span .* m and the mesh 0.0693 m: check --length"):
        on_surface(_measured(away, moved), cube)


def test_points_that_shrank_onto_the_origin_are_doubted(cube):
    points, moved = _top()
    imported = on_surface(_measured(1e-3 * points, moved), cube)
    assert "span 5" in imported.notes[-1]
    assert "of an object of 0.0693 m, implausibly little: is their unit right" in imported.notes[-1]
    assert on_surface(_measured(points, moved), cube).notes == ("A note.",)


@pytest.mark.parametrize("share", [0.99, 1.01])
@pytest.mark.parametrize("cells", [8, 18])
def test_the_limit_is_that_of_the_session_reader(tmp_path, cells, share):
    cube = box(size=(SIDE, SIDE, SIDE), cells=cells)
    # 0.02 diagonals of the cube (of 18 cells) against half a mean edge (of 8).
    limit = max(0.02 * SIDE * np.sqrt(3.0), 0.5 * SIDE / cells * (2 + np.sqrt(2.0)) / 3)
    points, moved = _top()
    measured = _measured(points + np.array([0.0, 0.0, share * limit]), moved)
    if share > 1.0:
        with pytest.raises(RecordError):
            on_surface(measured, cube)
        return
    imported = on_surface(measured, cube)
    write_displacement(tmp_path / "a.csv", imported.field, metres_per_unit=0.001)
    field, _ = read_displacement(tmp_path / "a.csv", cube, metres_per_unit=0.001)
    np.testing.assert_allclose(field.displacement, moved, rtol=1e-15)
    too_far = dataclasses.replace(
        imported.field, points=imported.field.points + np.array([0.0, 0.0, 0.02 * limit])
    )
    write_displacement(tmp_path / "b.csv", too_far)
    with pytest.raises(RecordError):
        read_displacement(tmp_path / "b.csv", cube)


@pytest.mark.parametrize(("share", "doubted"), [(0.009, True), (0.011, False)])
def test_a_hundredth_of_the_object_is_too_little(cube, share, doubted):
    """The span of the points against the diagonal of the cube, on both sides of the limit."""
    points, moved = _top()
    span = np.linalg.norm(np.ptp(points, axis=0))
    middle = np.array([0.5 * SIDE, 0.5 * SIDE, SIDE])
    shrunk = middle + share * SIDE * np.sqrt(3.0) / span * (points - points.mean(axis=0))
    notes = on_surface(_measured(shrunk, moved), cube).notes
    assert ("implausibly little" in notes[-1]) is doubted


@pytest.mark.parametrize(("share", "cure"), [(2.9, "--to-object"), (3.1, "--length-unit")])
def test_three_times_the_object_is_another_unit(cube, share, cure):
    points, moved = _top()
    span = np.linalg.norm(np.ptp(points, axis=0))
    wide = 1.0 + share * SIDE * np.sqrt(3.0) / span * points
    with pytest.raises(RecordError, match=cure):
        on_surface(_measured(wide, moved), cube)


def _pose_file(tmp_path, text):
    path = tmp_path / "pose.toml"
    path.write_text(text)
    return read_import_pose(path)


@pytest.mark.parametrize(
    "text",
    [
        f'length_unit = "mm"\n{TURN}\nt = [1, 2, 3]',
        'length_unit = "mm"\nT = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]',
    ],
)
def test_pose(tmp_path, text):
    pose, notes = _pose_file(tmp_path, text)
    # x_object = R x_file + t: the file's x axis is the object's y axis.
    np.testing.assert_allclose(pose @ [1.0, 0.0, 0.0, 1.0], [1e-3, 1.002, 3e-3, 1.0], rtol=1e-15)
    assert notes == ()


def test_pose_typed_with_few_digits_is_made_a_rotation(tmp_path):
    text = 'length_unit = "m"\nR = [[0.866, -0.5, 0], [0.5, 0.866, 0], [0, 0, 1]]\nt = [0, 0, 0]'
    pose, notes = _pose_file(tmp_path, text)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-15)
    # The nearest rotation to two typed numbers is theirs over their length.
    assert pose[0, 0] == pytest.approx(0.866 / np.hypot(0.866, 0.5), rel=1e-14)
    assert "R was made orthogonal; it was 4e-05 off" in notes[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{TURN}\nt = [0, 0, 0]", "the key 'length_unit' is missing"),
        ('length_unit = "km"', "is 'km'.*allowed: um, mm, cm, m, in"),
        ('length_unit = "m"', "must have either R and t, or T; for example: length_unit"),
        (f'length_unit = "m"\n{TURN}', "the key 't' is missing"),
        (f'length_unit = "m"\n{TURN}\nt = [0, 0, 0]\nT = [1]', "must have either R and t, or T"),
        ('length_unit = "m"\nR = [[1, 0], [0, 1]]\nt = [0, 0, 0]', "must be 3 rows of 3 finite"),
        ('length_unit = "m"\nR = "I"\nt = [0, 0, 0]', "must be 3 rows of 3 finite numbers"),
        (
            'length_unit = "m"\nR = [[1, 0, 0], [0, 1, 0.1], [0, 0, 1]]\nt = [0, 0, 0]',
            "R: is no rotation: R R.T is 0.1 off the identity",
        ),
        (
            'length_unit = "m"\nR = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]\nt = [0, 0, 0]',
            "is a mirror image",
        ),
        (
            'length_unit = "m"\nT = [[1,0,0,0], [0,1,0,0], [0,0,1,0], [0,0,0,2]]',
            r"has the last row \[0.0, 0.0, 0.0, 2.0\]",
        ),
        ('length_unit = "m"\nrotation = 1', "unknown key 'rotation'"),
        ("length_unit =", "is not valid TOML"),
    ],
)
def test_pose_refusals(tmp_path, text, message):
    with pytest.raises(RecordError, match=message):
        _pose_file(tmp_path, text)


@pytest.mark.parametrize(("error", "refused"), [(0.9e-3, False), (1.1e-3, True)])
def test_a_rotation_may_be_off_by_a_thousandth(tmp_path, error, refused):
    # R R^T is (1 + error / 2)^2 in one place: off by the error, to its square.
    text = f'length_unit = "m"\nR = [[{1 + error / 2}, 0, 0], [0, 1, 0], [0, 0, 1]]\nt = [0, 0, 0]'
    if refused:
        with pytest.raises(RecordError, match="is no rotation"):
            _pose_file(tmp_path, text)
        return
    pose, notes = _pose_file(tmp_path, text)
    np.testing.assert_allclose(pose, np.eye(4), atol=1e-15)
    assert "made orthogonal" in notes[0]

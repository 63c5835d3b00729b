"""What windows make of a motion that bends, against windows that were matched."""

from functools import cache

import numpy as np
import pytest
from surfaces import box
from vision.scenes import STILL, bump, example, followed, noisy_views

from palpate.geometry import TriangleMesh
from palpate.vision import JointFlow
from palpate.vision.cameras.projection import pixel_sizes
from palpate.vision.joint import averaging
from palpate.vision.matching.fit_operators import LocalFits

# Windows of 6.3 mm on a bump of this width.
BUMP = bump((4e-4, -2e-4, -6e-4), 0.007)


def _mesh():
    return TriangleMesh(*example().mesh(2e-3, 0.034))


@cache
def _pictures(motion, seeds):
    """Pictures of the example after a motion, with each of some textures."""
    return example().textured_views(motion, *seeds)


def _measured(motion, seeds, method=JointFlow()):
    """Vertices' displacements with each of some textures, nearly without noise."""
    stage = example()
    before, after = _pictures(STILL, seeds), _pictures(motion, seeds)
    for still, moved in zip(before, after, strict=True):
        start = method.start(stage.rig, noisy_views(still, 0.5, 3), _mesh())
        flow = next(followed(start, [noisy_views(moved, 0.5, 7)], method))
        found = method.vertices(flow, stage.rig, _mesh())
        yield method.averaged(found, flow, stage.rig, _mesh())


def _averaged(found, motion):
    average = found.average
    moved = (average.weights @ motion(average.points).ravel()).reshape(-1, 3)
    moved[~average.has_weights] = np.nan
    return moved


def test_the_average_is_what_windows_find():
    place = _mesh().vertices
    measured = list(_measured(BUMP, (1, 2, 3)))
    # Each texture has errors of its own, 0.005 px; their mean shows what all windows share.
    error = np.mean([one.displacement for one in measured], axis=0) - BUMP(place)
    expected = np.mean([_averaged(one, BUMP) for one in measured], axis=0) - BUMP(place)
    chosen = np.linalg.norm(place[:, :2], axis=1) < 0.016
    chosen &= np.isfinite(error).all(axis=1) & np.isfinite(expected).all(axis=1)
    assert chosen.sum() > 150
    error, expected = error[chosen], expected[chosen]
    slope = (error * expected).sum(axis=0) / (expected**2).sum(axis=0)
    # 1.05, 0.80, 1.07; cameras on one side weigh components otherwise than the mean of all.
    assert np.abs(slope - 1.0).max() < 0.3
    # 0.52 of the root mean square was left, most of it of the textures; 1 without an average.
    assert ((error - expected) ** 2).mean() < 0.45 * (error**2).mean()


@pytest.mark.parametrize("shape", ["affine", "quadratic"])
def test_what_windows_follow_is_its_own_average(shape):
    place = _mesh().vertices
    (found,) = _measured(STILL, (1,), JointFlow(shape=shape))
    given = found.average.has_weights
    assert given[np.isfinite(found.displacement).all(axis=1)].mean() > 0.9

    def turned(points):
        return np.cross([0.01, -0.02, 0.03], points) + np.array([1e-3, 0.0, -1e-3])

    # Points are seen on finer facets, 1e-7 of a window's place apart; times a turn of 0.04.
    np.testing.assert_allclose(_averaged(found, turned)[given], turned(place)[given], atol=2e-8)


@pytest.mark.slow
def test_quadratic_windows_leave_less_of_a_bend():
    dent, place = bump((0.0, 0.0, -1e-3), 0.007), _mesh().vertices

    def bias(shape):
        (found,) = _measured(dent, (1,), JointFlow(shape=shape))
        away = (_averaged(found, dent) - dent(place))[np.linalg.norm(place[:, :2], axis=1) < 0.016]
        return np.sqrt(np.nanmean(away[:, 2] ** 2))

    assert bias("quadratic") < 0.5 * bias("affine")


def test_shifted_windows_say_nothing_of_their_average():
    (found,) = _measured(STILL, (1,), JointFlow(shape="shift"))
    assert found.average is None


def test_windows_hold_the_pixels_of_all_cameras():
    stage, mesh = example(), _mesh()
    inside = np.flatnonzero(np.linalg.norm(mesh.vertices[:, :2], axis=1) < 0.012)
    place = mesh.vertices[inside]
    tangent = np.tile(np.eye(3)[:2], (len(place), 1, 1))
    nothing = np.zeros(0, dtype=np.int64)
    points = LocalFits(place, tangent, np.ones(len(place)), place, nothing, nothing, np.zeros(0))
    extent = 10.0 * pixel_sizes(stage.rig.cameras[0], place)
    windows = averaging._windows(21, stage.rig, averaging._cut(mesh, 1.5e-3, place), points, extent)
    pixels = np.bincount(windows.first, windows.weight)
    # Less a piece of some 20 px: windows are narrower, so that their spread is that of pixels.
    share = pixels / (len(stage.rig.cameras) * 21**2)
    assert share.min() > 0.94
    assert share.max() < 1.0


def test_pieces_have_the_area_of_the_surface_about_the_points():
    cube = box((0.04, 0.04, 0.04), 6)
    pieces = averaging._cut(cube, 1.5e-3, cube.vertices)
    assert np.linalg.norm(pieces.area, axis=1).sum() == pytest.approx(6 * 0.04**2)
    np.testing.assert_allclose(pieces.from_nodes @ pieces.nodes, pieces.middle, atol=1e-12)
    # Windows of 4 mm on a body of a metre: no more pieces than fit into memory, about them.
    large = averaging._cut(box((1.0, 1.0, 0.1), 2), 1e-3, np.array([[0.5, 0.25, 0.1]]))
    assert len(large.middle) <= 1e6
    near = box((1.0, 1.0, 0.1), 40)
    few = averaging._cut(near, 1e-3, np.array([[0.5, 0.25, 0.1]]))
    assert np.linalg.norm(few.middle - [0.5, 0.25, 0.1], axis=1).max() < 0.1


def test_what_a_camera_cannot_picture_is_in_none_of_its_windows():
    stage = example()
    # A wall that reaches behind the cameras goes on from the dome.
    far = np.array([[0.2, 0.0, 1.0], [0.2, 0.1, 1.0], [0.3, 0.0, -1.0]])
    vertices = np.concatenate([_mesh().vertices, far])
    count = len(_mesh().vertices)
    triangles = np.concatenate([_mesh().triangles, [[count, count + 1, count + 2]]])
    inside = np.flatnonzero(np.linalg.norm(vertices[:, :2], axis=1) < 0.012)[:20]
    place = np.concatenate([vertices[inside], far[:1]])
    tangent = np.tile(np.eye(3)[:2], (len(place), 1, 1))
    nothing = np.zeros(0, dtype=np.int64)
    points = LocalFits(place, tangent, np.ones(len(place)), place, nothing, nothing, np.zeros(0))
    # Each triangle in nine: few pieces make the wall, with some before the cameras, some behind.
    pieces = averaging._cut(TriangleMesh(vertices, triangles), 0.15, place)
    beyond = pieces.middle[pieces.middle[:, 0] > 0.1, 2]
    assert beyond.min() < 0.25
    assert beyond.max() > 0.4
    windows = averaging._windows(21, stage.rig, pieces, points, np.full(len(place), 3e-3))
    assert set(windows.first.tolist()) == set(range(len(inside)))

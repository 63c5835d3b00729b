"""The first instant of analytic scenes: points on the surface, what each camera sees, outlines."""

import cv2
import numpy as np
import pytest
from vision.scenes import (
    LENS,
    PITCH,
    SHAPE,
    Stage,
    example,
    example_views,
    make_rig,
    projected,
    rigid,
    tilted,
)

from palpate.vision.matching.scene import (
    advanced_scene,
    interior_pixels,
    make_scene,
    scene_rows,
)
from palpate.vision.projection import pixel_sizes
from palpate.vision.surface_map import SurfaceMap

STEP = 5


def _scene(rig, views, mesh, step=STEP):
    return make_scene(rig, views, *mesh, subset=21, step=step, smoothing=1.0)


@pytest.fixture(scope="module")
def scene():
    stage = example(3, LENS)
    return _scene(stage.rig, example_views("still", 3, LENS), stage.mesh())


def test_points_lie_on_the_surface_behind_the_pixels_of_a_grid(scene):
    assert (scene.pixel % STEP == STEP // 2).all()
    assert len(np.unique(scene.pixel, axis=0)) == len(scene.pixel)
    # The object fills the picture: all of the grid but for the rim.
    rows, columns = SHAPE
    assert len(scene.pixel) == (rows // STEP) * (columns // STEP)
    camera = scene.rig.cameras[0]
    np.testing.assert_allclose(projected(camera, scene.point), scene.pixel, atol=1e-6)
    x, y, z = scene.point.T
    # Facets of 1 mm on a radius of 60 mm hang 1.4^2 / 8 / 60 mm below the arch.
    gap = example().height(x, y) - z
    assert (gap > -1e-9).all()
    assert (gap < 4.5e-6).all()


def test_tangents_are_orthonormal_and_in_the_surface(scene):
    gram = np.einsum("nai,nbi->nab", scene.tangent, scene.tangent)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(2), gram.shape), atol=1e-12)
    normal = np.cross(scene.tangent[:, 0], scene.tangent[:, 1])
    slope = -scene.point[:, :2] / 0.06
    true = np.column_stack([-slope, np.ones(len(slope))])
    true /= np.linalg.norm(true, axis=1)[:, None]
    # Within half a facet: 0.7 mm on 60 mm.
    assert np.abs(normal - true).max() < 0.02


def test_the_half_window_is_one_on_the_surface(scene):
    camera = scene.rig.cameras[0]
    pose = camera.T_camera_object
    side = np.einsum("i,ni->n", pose[2, :3], scene.point) + pose[2, 3]
    np.testing.assert_allclose(scene.half_window, 10.0 * side / camera.matrix[0, 0], rtol=1e-12)
    np.testing.assert_allclose(
        pixel_sizes(camera, scene.point), scene.half_window / 10.0, rtol=1e-12
    )
    assert np.median(scene.half_window) == pytest.approx(10.0 * PITCH, rel=0.05)
    # Moving a point sideways by that moves its pixel by half a window.
    away = scene.point + scene.half_window[:, None] * pose[0, :3]
    moved = projected(camera, away) - scene.pixel
    # Through a lens that bends by 1.5 px of 90.
    np.testing.assert_allclose(moved[:, 0], 10.0, atol=0.6)


def test_cameras_see_the_points_that_fall_into_their_picture(scene):
    """Nothing hides anything on this dome, which all cameras see from above."""
    for c, camera in enumerate(scene.rig.cameras):
        pixel = projected(camera, scene.point)
        away = np.maximum(-pixel, pixel - np.array(SHAPE[::-1]) + 1.0).max(axis=1)
        assert scene.seen[away < -0.01, c].all()
        assert not scene.seen[away > 0.01, c].any()
    assert scene.seen[:, 0].all()
    assert 0.8 < scene.seen[:, 1:].mean() < 1.0


def test_surface_of_every_camera_projects_to_its_pixels(scene):
    for camera, surface, interior in zip(
        scene.rig.cameras, scene.surface, scene.interior, strict=True
    ):
        assert surface.dtype == np.float32
        row, column = np.nonzero(interior)
        pixel = projected(camera, surface[row, column].astype(np.float64))
        # Single precision of 60 mm: 4 nm.
        np.testing.assert_allclose(pixel, np.stack([column, row], axis=1), atol=1e-4)


def test_pixels_near_an_outline_are_not_interior():
    """A sheet that ends within the picture: two pixels beside its edge are left out."""
    stage = Stage(make_rig(2), tilted((0.1, 0.0)))
    vertices, triangles = stage.mesh(1e-3, 0.012)
    scene = _scene(stage.rig, [np.zeros(SHAPE, dtype=np.float32)] * 2, (vertices, triangles))
    for camera, interior in zip(stage.rig.cameras, scene.interior, strict=True):
        corner = projected(camera, vertices)
        row, column = np.nonzero(interior)
        low, high = corner.min(axis=0), corner.max(axis=0)
        pixel = np.stack([column, row], axis=1)
        assert (pixel > low + 1.0).all()
        assert (pixel < high - 1.0).all()
        # A square turned by up to 3 degrees: no more than the rim is lost.
        assert interior.sum() > 0.85 * (np.prod(high - low - 5.0) - 0.1 * np.prod(high - low))
    inside = interior_distance(scene)
    assert inside.min() >= 2.0


def interior_distance(scene):
    """Distance of each point's pixel from the nearest pixel that does not show the surface."""
    shows = np.isfinite(scene.surface[0][..., 0])
    row, column = np.nonzero(~shows)
    bare = np.stack([column, row], axis=1)
    return np.abs(scene.pixel[:, None] - bare).max(axis=2).min(axis=1) - 1.0


def test_a_step_in_depth_is_an_outline():
    """One half nearer by ten pixel sides; a slope of 45 degrees is none."""
    camera = make_rig(2).cameras[0]
    column = np.arange(60.0)

    def surface(depth):
        """What a camera straight above would see; `depth` along the columns [m]."""
        x = np.broadcast_to((column - 30.0) * PITCH, (40, 60))
        y = np.broadcast_to((np.arange(40.0)[:, None] - 20.0) * PITCH, (40, 60))
        point = np.stack([x, -y, np.broadcast_to(-depth, (40, 60))], axis=-1)
        return SurfaceMap(point, np.zeros((40, 60), dtype=np.int64))

    step = np.where(column < 30, 0.0, 10.0 * PITCH)
    interior = interior_pixels(surface(step), camera)
    assert interior.dtype == np.float32
    assert not interior[:, 27:33].any()
    assert interior[2:-2, 2:27].all()
    assert interior[2:-2, 33:-2].all()
    assert not interior[:2].any()
    assert not interior[:, -2:].any()
    assert interior_pixels(surface(column * PITCH), camera)[2:-2, 2:-2].all()
    assert not interior_pixels(surface(column * 8.0 * PITCH), camera).any()


def test_a_scene_that_the_reference_does_not_see_has_no_points():
    stage = example(3, LENS)
    vertices, triangles = stage.mesh(4e-3)
    away = vertices * [0.02, 0.02, 1.0] + [0.2, 0.0, 0.0]
    scene = _scene(stage.rig, example_views("still", 3, LENS), (away, triangles))
    assert scene.point.shape == (0, 3)
    assert scene.tangent.shape == (0, 2, 3)
    assert scene.seen.shape == (0, 3)


def test_rows_of_a_scene_are_points_and_nothing_else(scene):
    rows = np.array([5, 3, 100])
    part = scene_rows(scene, rows)
    for name in ("pixel", "point", "tangent", "half_window", "seen"):
        np.testing.assert_array_equal(getattr(part, name), getattr(scene, name)[rows])
    assert part.pictures is scene.pictures
    assert part.surface is scene.surface


def test_every_camera_needs_its_picture():
    stage = example(3, LENS)
    with pytest.raises(ValueError, match="zip"):
        _scene(stage.rig, example_views("still", 3, LENS)[:2], stage.mesh(4e-3))


def test_the_reference_camera_has_the_grid():
    rig = make_rig(3, reference=2)
    stage = Stage(rig, example().height, 3)
    views = [np.zeros(SHAPE, dtype=np.float32)] * 3
    scene = _scene(rig, views, stage.mesh(2e-3), step=9)
    np.testing.assert_allclose(projected(rig.cameras[2], scene.point), scene.pixel, atol=1e-6)
    assert (scene.pixel % 9 == 4).all()


def test_an_advanced_scene_is_the_moved_surface(scene):
    """Points, tangents and what each camera sees after a rigid motion of 4 px and 2 degrees."""
    motion = rigid((0.01, -0.02, 0.03), (8e-4, -5e-4, 4e-4))
    turn = cv2.Rodrigues(np.array([0.01, -0.02, 0.03]))[0]
    move = np.zeros((len(scene.point), 6, 3))
    move[:, 0] = motion(scene.point)
    move[:, 1:3] = scene.half_window[:, None, None] * (scene.tangent @ turn.T - scene.tangent)
    valid = np.ones(len(scene.point), dtype=bool)
    valid[7] = False
    move[7] = np.nan
    later = advanced_scene(scene, scene.grey, move, valid)
    np.testing.assert_allclose(
        later.point[valid], scene.point[valid] + motion(scene.point[valid]), atol=1e-15
    )
    np.testing.assert_allclose(later.tangent[valid], scene.tangent[valid] @ turn.T, atol=1e-12)
    assert not later.seen[7].any()
    assert later.seen[valid].sum() > 0.95 * scene.seen[valid].sum()
    assert not (later.seen & ~scene.seen).any()
    for surface, interior in zip(later.surface, later.interior, strict=True):
        seen = surface[interior > 0].astype(float)
        back = (seen - [8e-4, -5e-4, 4e-4]) @ turn
        # Facets of 5 px, a diagonal of up to 2.3 mm, hang 2.3^2 / 8 / 60 mm below the arch; their
        # corners hang up to 4.5 um below it themselves.
        gap = example().height(back[:, 0], back[:, 1]) - back[:, 2]
        assert (gap > -1e-6).all()
        assert (gap < 1.6e-5).all()

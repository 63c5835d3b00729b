"""What pixels see of a surface, against closed forms, brute force, OpenCV and rendered truth."""

import tomllib
from dataclasses import replace

import cv2
import numba
import numpy as np
import pytest
from surfaces import box, joined, sphere

from palpate.errors import CalibrationError
from palpate.geometry import TriangleMesh, read_mesh
from palpate.records import Camera
from palpate.vision.projection import pixel_grid
from palpate.vision.surface_map import surface_map, visible

SHAPE = (48, 64)
# Strong: 4 px at the corners of this picture, barrel, tangential and rational terms.
LENS = np.array([-0.3, 0.1, 2e-3, -1e-3, 0.02, 0.05, 0.01, -0.02])


def _camera(*, lens=None, focal=70.0, distance=3.0, turn=(0.1, -0.2, 0.3), size=SHAPE[::-1]):
    """A camera that looks at the origin of the object frame from some distance."""
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.array(turn))[0]
    pose[:3, 3] = [0.02, -0.03, distance]
    matrix = np.array([[focal, 0.4, 31.2], [0.0, 1.05 * focal, 24.3], [0.0, 0.0, 1.0]])
    terms = np.zeros(8)
    if lens is not None:
        terms[: len(lens)] = lens
    return Camera("c0", size, matrix, terms, pose)


def _reprojected(camera, points):
    pose = camera.T_camera_object
    turn, k = cv2.Rodrigues(pose[:3, :3])[0], camera.matrix
    pixel = cv2.projectPoints(points, turn, pose[:3, 3], k, camera.distortion)[0].reshape(-1, 2)
    # OpenCV passes over the skew.
    return pixel + k[0, 1] / k[1, 1] * np.stack([pixel[:, 1] - k[1, 2], 0 * pixel[:, 1]], axis=1)


def _sheet(depth, half, *, slope=(0.0, 0.0)):
    """Two triangles of the plane z = depth + slope . (x, y), from -half to half."""
    xy = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    z = depth + xy @ np.asarray(slope)
    return TriangleMesh(np.hstack([xy, z[:, None]]), np.array([[0, 1, 2], [0, 2, 3]]))


def _mapped(camera, mesh):
    return surface_map(camera, SHAPE, mesh.vertices, mesh.triangles)


@pytest.mark.parametrize("lens", [None, LENS[:5], LENS])
def test_hits_of_a_plane_lie_on_it_and_project_to_their_pixel(lens):
    """Both together fix the hit; OpenCV is the judge of the projection."""
    camera = _camera(lens=lens)
    seen = _mapped(camera, _sheet(0.1, 3.5, slope=(0.2, -0.3)))
    assert (seen.triangle >= 0).all()
    points = seen.point.reshape(-1, 3)
    # A metre in double precision.
    off = points[:, 2] - 0.1 - points[:, :2] @ [0.2, -0.3]
    np.testing.assert_allclose(off, 0.0, atol=1e-13)
    column, row = np.meshgrid(np.arange(64.0), np.arange(48.0))
    centres = np.stack([column, row], axis=-1).reshape(-1, 2)
    # The inverse of the distortion is good to 1e-9 px.
    np.testing.assert_allclose(_reprojected(camera, points), centres, atol=1e-8)


def test_a_fine_sphere_is_hit_where_the_round_one_is():
    camera = _camera(focal=55.0)
    mesh = sphere(5)
    seen = _mapped(camera, mesh)
    x, y = pixel_grid(camera, SHAPE)
    ray = np.stack([x, y, np.ones(SHAPE)], axis=-1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    pose = camera.T_camera_object
    middle = pose[:3, 3]
    along = ray @ middle
    square = along**2 - middle @ middle + 1.0
    # Facets are inside the sphere by the sagitta at most: R - sqrt(R^2 - c^2), c circumradius.
    edge = np.linalg.norm(np.diff(mesh.vertices[mesh.triangles][:, [0, 1, 2, 0]], axis=1), axis=2)
    sagitta = 1.0 - np.sqrt(1.0 - (edge.max() ** 2) / 3.0)
    # Off the outline: there the ray is parallel to the surface and the hit anywhere near it.
    clear = square > 0.05
    distance = along - np.sqrt(np.where(clear, square, 0.0))
    truth = (distance[..., None] * ray - middle) @ pose[:3, :3]
    gap = np.linalg.norm(seen.point - truth, axis=-1)
    cosine = np.sqrt(np.where(clear, square, 1.0))
    assert clear.sum() > 700
    assert (gap * cosine)[clear].max() < 1.05 * sagitta
    assert np.median((gap * cosine)[clear]) > 0.1 * sagitta
    assert not (seen.triangle[square < -0.05] >= 0).any()
    assert np.array_equal(np.isnan(seen.point).all(axis=-1), seen.triangle < 0)


@pytest.mark.parametrize("lens", [None, LENS])
def test_any_heap_of_triangles_is_hit_as_by_brute_force(lens):
    """Every ray against every triangle by Moeller and Trumbore's formula, nearest kept."""
    rng = np.random.default_rng(3)
    camera = _camera(lens=lens)
    middle = rng.uniform(-1.0, 1.0, (60, 1, 3)) * [1.6, 1.2, 0.8]
    corner = middle + rng.normal(size=(60, 3, 3)) * rng.choice([0.02, 0.1, 0.5], (60, 1, 1))
    seen = surface_map(camera, SHAPE, corner.reshape(-1, 3), np.arange(180).reshape(-1, 3))
    pose = camera.T_camera_object
    grid = pixel_grid(camera, SHAPE).reshape(2, -1).T
    ray = np.hstack([grid, np.ones((len(grid), 1))]) @ pose[:3, :3]
    eye = -pose[:3, 3] @ pose[:3, :3]
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    p = np.cross(ray[:, None], second)
    scale = 1.0 / np.einsum("rea,ea->re", p, first)
    u = np.einsum("rea,ea->re", p, eye - corner[:, 0]) * scale
    q = np.cross(eye - corner[:, 0], first)
    v = ray @ q.T * scale
    depth = np.einsum("ea,ea->e", q, second) * scale
    depth[(u < 0.0) | (v < 0.0) | (u + v > 1.0)] = np.inf
    nearest = depth.argmin(axis=1)
    hit = np.isfinite(depth.min(axis=1))
    assert 500 < hit.sum() < hit.size - 500
    assert np.array_equal(seen.triangle.ravel(), np.where(hit, nearest, -1))
    points = eye + depth.min(axis=1)[hit, None] * ray[hit]
    # Some triangles are seen almost edge on: their depth loses digits.
    np.testing.assert_allclose(seen.point.reshape(-1, 3)[hit], points, atol=1e-10)


def test_no_ray_slips_through_a_shared_edge():
    """Pixel centres exactly on edges and vertices of a grid of squares cut in two."""
    camera = Camera(
        "c0",
        None,
        np.array([[64.0, 0.0, 32.0], [0.0, 64.0, 24.0], [0.0, 0.0, 1.0]]),
        np.zeros(8),
        np.eye(4),
    )
    mesh = box(size=(0.9, 0.9, 0.3), cells=9, origin=(-0.5, -0.4, 1.0))
    assert (_mapped(camera, mesh).triangle[5:48, 10:50] >= 0).all()
    third = sphere(3, radius=0.4)
    moved = TriangleMesh(third.vertices / 3.0 + [0.0, 0.0, 1.0], third.triangles)
    inside = np.hypot(*np.ogrid[-24:24, -32:32]) < 8.0
    assert (_mapped(camera, moved).triangle[inside] >= 0).all()


def test_the_nearer_of_two_sheets_is_seen_and_hides_the_other():
    camera = _camera(turn=(0.0, 0.0, 0.0))
    near, far = _sheet(-0.5, 0.3), _sheet(0.4, 1.2)
    both = joined(far, near)
    seen = _mapped(camera, both)
    assert set(np.unique(seen.triangle)) == {-1, 0, 1, 2, 3}
    alone = _mapped(camera, near)
    assert np.array_equal(seen.triangle >= 2, alone.triangle >= 0)
    line = np.linspace(-1.0, 1.0, 81)
    x, y = (grid.ravel() for grid in np.meshgrid(line, line))
    on_far = np.stack([x, y, np.full_like(x, 0.4)], axis=1)
    # The shadow of the near sheet on the far one, from the camera's centre.
    eye = -camera.T_camera_object[:3, 3]
    scale = (-0.5 - eye[2]) / (0.4 - eye[2])
    shadow = eye + scale * (on_far - eye)
    depth = np.abs(shadow[:, :2]).max(axis=1)
    pixel = 2.5 / 70.0
    is_visible = visible(seen, camera, on_far, tolerance=1e-3)
    inside = (_reprojected(camera, on_far) >= 0).all(axis=1)
    inside &= (_reprojected(camera, on_far) <= [63, 47]).all(axis=1)
    assert (inside & (depth > 0.3 + pixel)).sum() > 1000
    assert np.array_equal(is_visible[depth > 0.3 + pixel], inside[depth > 0.3 + pixel])
    assert not is_visible[depth < 0.3 - pixel].any()
    # Beside the near sheet, less than a pixel off: hidden as well.
    assert not is_visible[depth < 0.3].any()
    on_near = np.stack([0.29 * x, 0.29 * y, np.full_like(x, -0.5)], axis=1)
    assert visible(seen, camera, on_near, tolerance=1e-9).all()


def test_tolerance_is_the_depth_along_the_ray():
    camera = _camera()
    seen = _mapped(camera, _sheet(0.0, 4.0))
    pose = camera.T_camera_object
    grid = pixel_grid(camera, SHAPE)[:, ::7, ::9].reshape(2, -1).T
    ray = np.hstack([grid, np.ones((len(grid), 1))])
    ray = ray / np.linalg.norm(ray, axis=1)[:, None] @ pose[:3, :3]
    points = seen.point[::7, ::9].reshape(-1, 3)
    assert visible(seen, camera, points + 0.9e-3 * ray, tolerance=1e-3).all()
    assert not visible(seen, camera, points + 1.1e-3 * ray, tolerance=1e-3).any()
    assert visible(seen, camera, points - 0.5 * ray, tolerance=1e-3).all()


def test_only_points_in_front_and_in_the_picture_are_visible():
    camera = _camera(turn=(0.0, 0.0, 0.0))
    far = _sheet(50.0, 1.0)
    seen = _mapped(camera, far)
    pose = camera.T_camera_object
    pixel = np.array(
        [[0.01, 0.01], [62.99, 46.99], [-0.01, 9.0], [63.01, 9.0], [9.0, -0.01], [9.0, 47.01]]
    )
    x, y, z = np.linalg.inv(camera.matrix) @ np.hstack([pixel, np.ones((6, 1))]).T
    points = 2.0 * np.stack([x, y, z], axis=1) - pose[:3, 3]
    # On the same line behind the camera, and nowhere.
    points = np.concatenate([points, -4.0 * points[:1] - 5.0 * pose[:3, 3], [[np.nan, 0.0, 0.0]]])
    is_visible = visible(seen, camera, points, tolerance=0.0)
    assert is_visible.tolist() == [True, True, False, False, False, False, False, False]
    assert visible(seen, camera, np.zeros((0, 3)), tolerance=0.0).shape == (0,)


def test_a_fold_of_the_lens_model_does_no_harm():
    """k1 = -0.3 turns back at x / z of 1.05: what lies farther out projects into the picture."""
    camera = _camera(lens=np.array([-0.3]), focal=40.0, turn=(0.0, 0.0, 0.0))
    outside = np.array([[5.4, 0.1, 0.0], [5.4, -0.1, 0.0], [5.6, 0.0, 0.0]])
    assert (np.abs(_reprojected(camera, outside) - [31, 24]) < 10.0).all()
    wide = np.concatenate([outside, _sheet(0.0, 0.8).vertices])
    triangles = np.array([[0, 1, 2], [3, 4, 5], [3, 5, 6]])
    seen = surface_map(camera, SHAPE, wide, triangles)
    assert not (seen.triangle == 0).any()
    alone = _mapped(camera, _sheet(0.0, 0.8))
    np.testing.assert_array_equal(seen.point, alone.point)
    nearer = outside - 0.5 * (outside + camera.T_camera_object[:3, 3])
    assert not visible(seen, camera, nearer, tolerance=1.0).any()


def test_a_large_triangle_bulges_with_the_lens():
    """Its edges are curved by several pixels; every pixel decides by its own ray."""
    camera = _camera(lens=LENS, focal=40.0)
    corner = np.array([[-1.5, -1.1, 0.0], [1.6, -1.2, 0.1], [0.1, 1.5, -0.2]])
    seen = surface_map(camera, SHAPE, corner, np.array([[0, 1, 2]]))
    line = np.linspace(0.0, 1.0, 201)[:, None]
    edges = np.concatenate([corner[i] + line * (corner[(i + 1) % 3] - corner[i]) for i in range(3)])
    outline = _reprojected(camera, edges).astype(np.float32)
    for row in range(0, 48, 3):
        for column in range(0, 64, 3):
            side = cv2.pointPolygonTest(outline, (float(column), float(row)), measureDist=True)
            # 201 points an edge and float32: the polygon is good to 1e-3 px.
            if abs(side) > 0.01:
                assert (seen.triangle[row, column] == 0) == (side > 0.0)


def test_the_order_of_triangles_and_the_threads_do_not_matter():
    camera = _camera(lens=LENS)
    mesh = sphere(3)
    first = _mapped(camera, mesh)
    order = np.random.default_rng(0).permutation(len(mesh.triangles))
    other = surface_map(camera, SHAPE, mesh.vertices, mesh.triangles[order])
    np.testing.assert_allclose(other.point, first.point, atol=1e-12)
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        single = _mapped(camera, mesh)
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(single.point, first.point)
    np.testing.assert_array_equal(single.triangle, first.triangle)


def test_both_sides_of_an_open_surface_are_seen_and_flat_triangles_are_passed_over():
    camera = _camera()
    sheet = _sheet(0.0, 0.6)
    front = _mapped(camera, sheet)
    back = surface_map(camera, SHAPE, sheet.vertices, sheet.triangles[:, ::-1])
    np.testing.assert_array_equal(front.triangle, back.triangle)
    assert (front.triangle >= 0).sum() > 300
    degenerate = np.concatenate([sheet.triangles, [[0, 0, 1], [0, 2, 2]]])
    # Vertices of no triangle may be anywhere, even in the camera's own plane.
    vertices = np.concatenate([sheet.vertices, -camera.T_camera_object[None, :3, 3] @ np.eye(3)])
    with_flat = surface_map(camera, SHAPE, vertices, degenerate)
    np.testing.assert_array_equal(with_flat.triangle, front.triangle)


def test_any_size_will_do_where_the_camera_does_not_say():
    camera = replace(_camera(lens=LENS), size=None)
    mesh = sphere(2)
    small = surface_map(camera, (29, 37), mesh.vertices, mesh.triangles)
    np.testing.assert_array_equal(small.point, _mapped(camera, mesh).point[:29, :37])


@pytest.mark.parametrize("distance", [0.5, -3.0])
def test_a_surface_beside_or_behind_the_camera_is_refused(distance):
    with pytest.raises(CalibrationError, match=r"'c0': \d+ of 128 triangles .* beside or behind"):
        _mapped(_camera(distance=distance), sphere(2))


def test_rendered_truth_of_the_half_ball(shared_data):
    """Needs ../shared. Truth: points of the smooth ball behind each pixel, what hides them."""
    folder = shared_data / "halfball_images"
    mesh = read_mesh(folder / "mesh.ply", metres_per_unit=1.0)
    truth = np.load(folder / "truth_n01.npz")
    points = truth["X"].astype(np.float64)
    edge = np.linalg.norm(np.diff(mesh.vertices[mesh.triangles][:, [0, 1, 2, 0]], axis=1), axis=2)
    dome = (mesh.vertices[mesh.triangles][..., 2] > 1e-6).any(axis=1)
    sagitta = 0.04 - np.sqrt(0.04**2 - edge[dome].max() ** 2 / 3.0)
    for i, table in enumerate(tomllib.loads((folder / "rig.toml").read_text())["camera"]):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = table["R"], table["t"]
        camera = Camera(
            table["name"], tuple(table["size"]), np.array(table["K"]), np.zeros(8), pose
        )
        seen = surface_map(camera, (480, 640), mesh.vertices, mesh.triangles)
        if i == 0:
            hit = seen.point.reshape(-1, 3)[truth["pixel"]]
            met = np.isfinite(hit).all(axis=1)
            # The smooth ball reaches past the outline of its facets by a fraction of a pixel.
            assert met.mean() > 0.998
            toward = np.linalg.inv(pose)[:3, 3] - points[met]
            normal = points[met] / 0.04
            cosine = np.einsum("na,na->n", toward, normal) / np.linalg.norm(toward, axis=1)
            gap = np.linalg.norm(hit[met] - points[met], axis=1) * cosine
            # 1 um: truth in float32 and the gap measured along the chord of a curved surface.
            assert gap.max() < sagitta + 1e-6
        hidden = (truth["hidden_rest"] >> i & 1).astype(bool)
        agree = visible(seen, camera, points, tolerance=1e-4) == ~hidden
        # What is left: points turned away from c1 within one pixel of its outline.
        assert agree.mean() > 0.99

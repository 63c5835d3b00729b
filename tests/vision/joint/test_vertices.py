"""Displacement of vertices from range flow measured on analytic scenes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from surfaces import box, sphere
from vision.scenes import (
    LENS,
    MOTIONS,
    PITCH,
    SHAPE,
    STILL,
    bump,
    example,
    example_views,
    first_instant,
    followed,
    noisy_views,
    projected,
)

from palpate.geometry import TriangleMesh, vertex_normals
from palpate.vision import JointFlow
from palpate.vision.joint import vertices as averaging
from palpate.vision.joint.vertices import (
    LocalFits,
    coefficient_operators,
    local_fits,
    vertex_displacement,
)
from palpate.vision.matching.local_regression import Scatter, local_field
from palpate.vision.projection import pixel_sizes
from palpate.vision.range_flow import Outcome, is_valid

NOISE = 3.0
# Windows of 6.3 mm on a bump of this width.
BUMP = bump((4e-4, -2e-4, -6e-4), 0.007)
REACH = 6e-3
RADIUS = 0.04


def _flow(name, *, noise=NOISE, method=JointFlow(), lens=(), seed=1):
    stage = example(3, lens)
    still = noisy_views(example_views("still", 3, lens), noise, seed)
    later = noisy_views(example_views(name, 3, lens), noise, seed + 50)
    return next(followed(first_instant(stage, still, method), [later], method))


def _camera():
    return example().rig.cameras[0]


def _inside(vertices, margin):
    """Vertices that all cameras see so far within their pictures, at rest."""
    keep = np.ones(len(vertices), dtype=bool)
    for camera in example().rig.cameras:
        pixel = projected(camera, vertices)
        keep &= ((pixel > margin) & (pixel < np.array(SHAPE[::-1]) - 1.0 - margin)).all(axis=1)
    return keep


@pytest.fixture(scope="module")
def mesh():
    return example().mesh(2e-3, 0.034)


@pytest.mark.parametrize("name", ["still", "turn", "strain", "bump"])
def test_errors_are_small_and_as_large_as_claimed(mesh, name):
    vertices, triangles = mesh
    motion = MOTIONS[name]
    square = []
    for seed in (1, 2):
        vertex_motion = vertex_displacement(_flow(name, seed=seed), _camera(), vertices, triangles)
        measured = np.isfinite(vertex_motion.displacement).all(axis=1)
        inside = _inside(vertices, 22.0)
        assert measured[inside].all()
        error = (vertex_motion.displacement - motion(vertices))[measured]
        square.append(
            np.einsum(
                "ni,nij,nj->n", error, np.linalg.inv(vertex_motion.covariance[measured]), error
            )
            / 3.0
        )
        sigma = np.sqrt(np.einsum("nii->ni", vertex_motion.covariance[measured]))
        assert np.abs(error / sigma)[inside[measured]].max() < 6.0
        # Beyond the last points quadratics are extrapolated: the claim is itself a guess.
        assert np.abs(error / sigma).max() < 10.0
        # Twice the noise of the usual 1.5: 0.014 px, three times that in depth, less by smoothing.
        within = error[inside[measured]]
        assert np.sqrt((within[:, :2] ** 2).mean()) < 0.016 * PITCH
        assert np.sqrt((within[:, 2] ** 2).mean()) < 0.05 * PITCH
    # 5 % from chance; a bias of 0.005 px is claimed on top of the noise that is really there, and
    # analytic pictures have none: 0.7 for an object at rest.
    assert 0.65 < np.sqrt(np.mean(np.concatenate(square))) < 1.25


def test_without_noise_vertices_are_exact_through_lenses_too(mesh):
    vertices, triangles = mesh
    flow = _flow("turn", noise=0.0, lens=LENS)
    camera = example(3, LENS).rig.cameras[0]
    vertex_motion = vertex_displacement(flow, camera, vertices, triangles)
    measured = np.isfinite(vertex_motion.displacement).all(axis=1)
    measured &= _inside(vertices, 22.0)
    error = (vertex_motion.displacement - MOTIONS["turn"](vertices))[measured]
    # A thousandth of a pixel, three in depth; rigid motion is exact on the dome.
    assert np.sqrt((error**2).mean(axis=0)).max() < 3e-3 * PITCH


def test_only_vertices_among_points_are_measured_and_all_are_counted(mesh):
    vertices, triangles = mesh
    flow = _flow("shift")
    vertex_motion = vertex_displacement(flow, _camera(), vertices, triangles)
    measured = np.isfinite(vertex_motion.displacement).all(axis=1)
    np.testing.assert_array_equal(measured, np.isfinite(vertex_motion.covariance).all(axis=(1, 2)))
    valid = flow.point[is_valid(flow)]
    assert (vertex_motion.count[measured] >= 12).all()
    # The radius, 12 px, may double where there are few.
    nearest = np.linalg.norm(vertices[:, None] - valid, axis=2).min(axis=1)
    assert not measured[nearest > 25.0 * PITCH].any()
    assert not vertex_motion.count[nearest > 25.0 * PITCH].any()
    near = (np.linalg.norm(vertices[:, None] - valid, axis=2) < 12.0 * PITCH).sum(axis=1)
    inside = _inside(vertices, 25.0)
    np.testing.assert_allclose(vertex_motion.count[inside].mean(), near[inside].mean(), rtol=0.15)


def test_vertices_that_face_away_are_not_measured(mesh):
    vertices, triangles = mesh
    flow = _flow("shift")
    vertex_motion = vertex_displacement(flow, _camera(), vertices, triangles[:, ::-1])
    assert np.isnan(vertex_motion.displacement).all()
    assert np.isnan(vertex_motion.covariance).all()
    assert not vertex_motion.count.any()


def test_rejected_points_do_not_count(mesh):
    vertices, triangles = mesh
    flow = _flow("shift")
    plain = vertex_displacement(flow, _camera(), vertices, triangles)
    middle = np.linalg.norm(flow.point[:, :2], axis=1) < 0.009
    outcome = flow.outcome.copy()
    outcome[middle] = Outcome.SCORE
    wild = np.where(middle[:, None], 1.0, flow.displacement)
    other = vertex_displacement(
        replace(flow, outcome=outcome, displacement=wild), _camera(), vertices, triangles
    )
    far = (np.linalg.norm(vertices[:, :2], axis=1) > 0.009 + 26.0 * PITCH) & _inside(vertices, 25.0)
    assert far.sum() > 50
    # The radius goes with the median depth of the points, which changes a little.
    np.testing.assert_allclose(other.displacement[far], plain.displacement[far], atol=2e-7)
    assert np.isnan(other.displacement[np.linalg.norm(vertices[:, :2], axis=1) < 0.002]).all()
    nothing = replace(flow, outcome=np.full_like(flow.outcome, Outcome.LOST))
    empty = vertex_displacement(nothing, _camera(), vertices, triangles)
    assert np.isnan(empty.displacement).all()


@pytest.mark.parametrize("settings", [{"step": 8}, {"subset": 11}])
def test_sparse_points_and_small_windows_reach_the_vertices_too(mesh, settings):
    """The radius must hold enough points whatever their spacing."""
    vertices, triangles = mesh
    flow = _flow("shift", noise=1.0, method=JointFlow(**settings))
    assert is_valid(flow).mean() > 0.5
    vertex_motion = vertex_displacement(flow, _camera(), vertices, triangles)
    measured = np.isfinite(vertex_motion.displacement).all(axis=1)
    assert measured[_inside(vertices, 30.0)].all()


def test_normals_of_a_sphere_are_its_radii():
    ball = sphere(4)
    normal = vertex_normals(ball.vertices, ball.triangles)
    # Facets of 0.1 radius, some with twice the area of their neighbours.
    np.testing.assert_allclose(normal, ball.vertices, atol=0.02)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-14)
    lone = np.vstack([ball.vertices, [[9.0, 9.0, 9.0]]])
    np.testing.assert_array_equal(vertex_normals(lone, ball.triangles)[-1], 0.0)


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
        vertex_motion = method.vertices(flow, stage.rig, _mesh())
        yield method.averaged(vertex_motion, flow, stage.rig, _mesh())


def _averaged(vertex_motion, motion):
    average = vertex_motion.average
    moved = (average.weights @ motion(average.points).ravel()).reshape(-1, 3)
    moved[~average.has_weights] = np.nan
    return moved


def test_the_average_is_what_windows_find():
    vertices = _mesh().vertices
    measured = list(_measured(BUMP, (1, 2, 3)))
    # Each texture has errors of its own, 0.005 px; their mean shows what all windows share.
    error = np.mean([measured_one.displacement for measured_one in measured], axis=0) - BUMP(
        vertices
    )
    expected = np.mean([_averaged(measured_one, BUMP) for measured_one in measured], axis=0) - BUMP(
        vertices
    )
    chosen = np.linalg.norm(vertices[:, :2], axis=1) < 0.016
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
    vertices = _mesh().vertices
    (vertex_motion,) = _measured(STILL, (1,), JointFlow(shape=shape))
    given = vertex_motion.average.has_weights
    assert given[np.isfinite(vertex_motion.displacement).all(axis=1)].mean() > 0.9

    def turned(points):
        return np.cross([0.01, -0.02, 0.03], points) + np.array([1e-3, 0.0, -1e-3])

    # Points are seen on finer facets, 1e-7 of a window's place apart; times a turn of 0.04.
    np.testing.assert_allclose(
        _averaged(vertex_motion, turned)[given], turned(vertices)[given], atol=2e-8
    )


@pytest.mark.slow
def test_quadratic_windows_leave_less_of_a_bend():
    dent, vertices = bump((0.0, 0.0, -1e-3), 0.007), _mesh().vertices

    def bias(shape):
        (vertex_motion,) = _measured(dent, (1,), JointFlow(shape=shape))
        away = (_averaged(vertex_motion, dent) - dent(vertices))[
            np.linalg.norm(vertices[:, :2], axis=1) < 0.016
        ]
        return np.sqrt(np.nanmean(away[:, 2] ** 2))

    assert bias("quadratic") < 0.5 * bias("affine")


def test_shifted_windows_say_nothing_of_their_average():
    (vertex_motion,) = _measured(STILL, (1,), JointFlow(shape="shift"))
    assert vertex_motion.average is None


def test_windows_hold_the_pixels_of_all_cameras():
    stage, mesh = example(), _mesh()
    inside = np.flatnonzero(np.linalg.norm(mesh.vertices[:, :2], axis=1) < 0.012)
    position = mesh.vertices[inside]
    tangent = np.tile(np.eye(3)[:2], (len(position), 1, 1))
    nothing = np.zeros(0, dtype=np.int64)
    points = LocalFits(
        position, tangent, np.ones(len(position)), position, nothing, nothing, np.zeros(0)
    )
    extent = 10.0 * pixel_sizes(stage.rig.cameras[0], position)
    windows = averaging._windows(
        21, stage.rig, averaging._cut(mesh, 1.5e-3, position), points, extent
    )
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
    position = np.concatenate([vertices[inside], far[:1]])
    tangent = np.tile(np.eye(3)[:2], (len(position), 1, 1))
    nothing = np.zeros(0, dtype=np.int64)
    points = LocalFits(
        position, tangent, np.ones(len(position)), position, nothing, nothing, np.zeros(0)
    )
    # Each triangle in nine: few pieces make the wall, with some before the cameras, some behind.
    pieces = averaging._cut(TriangleMesh(vertices, triangles), 0.15, position)
    beyond = pieces.middle[pieces.middle[:, 0] > 0.1, 2]
    assert beyond.min() < 0.25
    assert beyond.max() > 0.4
    windows = averaging._windows(21, stage.rig, pieces, points, np.full(len(position), 3e-3))
    assert set(windows.first.tolist()) == set(range(len(inside)))


def _scatter(seed=0):
    """Points of a paraboloid, each known to a little less or more."""
    rng = np.random.default_rng(seed)
    flat = rng.uniform(-0.02, 0.02, (900, 2))
    point = np.column_stack([flat, -(flat**2).sum(axis=1) / (2.0 * RADIUS)])
    # Claimed far worse than any polynomial fits, so that no point is an outlier.
    variance = rng.uniform(1.0, 2.0, 900)[:, None, None] * 1e-4 * np.eye(3)
    return Scatter(point, flat / 3e-4, _motion(point), variance, 0.0 * variance, 21)


def _motion(point):
    """A small motion that no quadratic holds, with a turn about every axis."""
    turn = np.cross([2e-3, -3e-3, 1e-3], point)
    return turn + 1e-5 * np.sin(point @ np.array([[200.0, 90.0, 0.0], [0, 240, 70], [160, 0, 50]]))


def _places():
    flat = np.random.default_rng(1).uniform(-0.012, 0.012, (30, 2))
    position = np.column_stack([flat, -(flat**2).sum(axis=1) / (2.0 * RADIUS)])
    normal = np.column_stack([flat / RADIUS, np.ones(30)])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    first = np.cross(normal, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first, axis=1)[:, None]
    return position, np.stack([first, np.cross(normal, first)], axis=1)


@pytest.mark.parametrize("order", [1, 2])
def test_operators_give_the_coefficients_of_the_field(order):
    scatter, (position, tangent) = _scatter(), _places()
    field = local_field(scatter, position, tangent, reach=REACH, order=order)
    fits = local_fits(scatter, position, tangent, reach=REACH)
    operators, determined = coefficient_operators(fits, order, range(3 * order))
    assert determined.all()
    coefficients = [
        (operator @ scatter.displacement.ravel()).reshape(-1, 3) for operator in operators
    ]
    # The field turns its normal by the turn itself, an operator by its first order: their square.
    turn = (5e-3 * REACH) * 5e-3
    np.testing.assert_allclose(coefficients[0], field.displacement, atol=0.1 * turn)
    for k in range(2):
        np.testing.assert_allclose(coefficients[1 + k] / REACH, field.gradient[:, k], atol=5e-3**2)
    for k in range(3 * (order - 1)):
        expected = field.curvature[:, k] * REACH**2
        np.testing.assert_allclose(coefficients[3 + k], expected, atol=turn)
        assert np.abs(expected).max() > 20.0 * turn


def test_rigid_motions_are_exact_on_a_curved_surface():
    scatter, (position, tangent) = _scatter(), _places()
    (value,), _ = coefficient_operators(
        local_fits(scatter, position, tangent, reach=REACH), 2, (0,)
    )
    for turn in 1e3 * np.eye(3):
        moved = (value @ np.cross(turn, scatter.point).ravel()).reshape(-1, 3)
        # Heights over the tangent plane are no quadratics, but they turn along.
        np.testing.assert_allclose(moved, np.cross(turn, position), atol=1e-7)


def test_points_on_a_line_determine_nothing():
    line = np.linspace(-0.01, 0.01, 60)
    point = np.column_stack([line, 0.0 * line, 0.0 * line])
    noise = np.tile(1e-12 * np.eye(3), (60, 1, 1))
    scatter = Scatter(point, point[:, :2] / 3e-4, point, noise, 0.0 * noise, 21)
    fits = local_fits(scatter, np.zeros((1, 3)), np.eye(3)[None, :2], reach=REACH)
    (value,), determined = coefficient_operators(fits, 2, (0,))
    assert not determined.any()
    assert abs(value).sum() == 0.0


def test_a_place_without_points_has_no_weights():
    scatter = _scatter()
    fits = local_fits(scatter, np.full((1, 3), 0.5), np.eye(3)[None, :2], reach=REACH)
    (value,), determined = coefficient_operators(fits, 1, (0,))
    assert value.shape == (3, 2700)
    assert not determined.any()
    assert abs(value).sum() == 0.0

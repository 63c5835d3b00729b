"""Registration of points to a mesh: known motions, repeated noise, what a shape cannot tell."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from surfaces import box, sphere

from palpate.errors import CalibrationError, InputError
from palpate.geometry import TriangleMesh, read_mesh, refined_surface
from palpate.geometry.registration import (
    check_registration,
    free_motions_text,
    register,
)

SIZE = np.array([0.07, 0.045, 0.03])
NOISE = 3e-5
# The start is known so well that nothing is searched: for tests of what comes after.
NEAR = {"angle": 1e-3, "distance": 5e-4}


def _pose(turn, shift, about=(0.0, 0.0, 0.0)):
    """A turn (rad) about a point, then a shift (m)."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    pose[:3, 3] = np.asarray(about) - pose[:3, :3] @ np.asarray(about) + shift
    return pose


def _moved(pose, points):
    return points @ pose[:3, :3].T + pose[:3, 3]


def _worst_guess(rng, about):
    """5 degrees and 20 mm in random directions."""
    turn, shift = rng.normal(size=(2, 3))
    turn *= np.radians(5.0) / np.linalg.norm(turn)
    return _pose(turn, 0.02 * shift / np.linalg.norm(shift), about)


def _error(registration, truth):
    """Turn (rad) and shift (m) of the centroid by which a registration misses."""
    left = registration.T_mesh_points @ truth
    turn = Rotation.from_matrix(left[:3, :3]).as_rotvec()
    return np.concatenate([turn, _moved(left, registration.centre) - registration.centre])


def _mahalanobis(registration, truth):
    error = _error(registration, truth)
    return float(error @ np.linalg.solve(registration.covariance, error))


def _seen(mesh, eye, count, rng):
    """Points spread over the triangles that turn their outside to an eye."""
    corner = mesh.vertices[mesh.triangles]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    facing = np.einsum("ma,ma->m", area, eye - corner.mean(axis=1)) > 0.0
    share = np.where(facing, np.linalg.norm(area, axis=1), 0.0)
    triangle = rng.choice(len(corner), count, p=share / share.sum())
    a, b = rng.uniform(size=(2, count))
    a, b = np.where(a + b > 1.0, 1.0 - a, a), np.where(a + b > 1.0, 1.0 - b, b)
    weight = np.stack([1.0 - a - b, a, b], axis=1)
    return np.einsum("nv,nva->na", weight, corner[triangle])


def _three_faces(count, rng):
    """Points of three faces of the box that share a corner."""
    points = rng.uniform(size=(count, 3)) * SIZE
    axis = rng.integers(0, 3, count)
    points[np.arange(count), axis] = SIZE[axis]
    return points


def _ball(count, rng, lowest=-0.2):
    points = rng.normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    return 0.03 * points[points[:, 2] > lowest]


@pytest.mark.parametrize("outliers", [0.0, 0.2])
def test_one_side_of_a_solid_is_found_from_a_rough_guess(shared_data, outliers):
    """Box with half cylinder and cap, seen from one side, 5 degrees and 20 mm off."""
    mesh = TriangleMesh(
        *refined_surface(read_mesh(shared_data / "rigid_translation_x" / "mesh.ply"), pieces=2)
    )
    rng = np.random.default_rng(3 + int(10 * outliers))
    eye = np.array([-0.34, -0.49, 0.55])
    points = _seen(mesh, eye, 900, rng)
    truth = _worst_guess(rng, points.mean(axis=0))
    measured = _moved(truth, points) + rng.normal(scale=NOISE, size=points.shape)
    wrong = rng.uniform(size=len(points)) < outliers
    measured[wrong] += rng.normal(scale=0.01, size=(int(wrong.sum()), 3))
    registration = register(measured, None, mesh, viewpoint=_moved(truth, eye[None])[0])
    check_registration(registration)
    # 27.9 is the 99.99 % point of chi-squared with six degrees of freedom.
    assert _mahalanobis(registration, truth) < 27.9
    assert registration.residual == pytest.approx(NOISE, rel=0.1)
    # Some of the wrong points lie near the surface by chance.
    assert 1.0 - outliers - 0.02 < registration.inliers < 1.0 - 0.7 * outliers + 1e-9
    # Without an eye the back of the solid may be taken for its front, and is not.
    blind = register(measured, None, mesh)
    assert np.linalg.norm(_error(blind, truth)[3:]) < 1e-5


def test_covariance_is_that_of_repeated_measurements():
    rng = np.random.default_rng(0)
    mesh, points = box(SIZE), _three_faces(250, rng)
    errors, claimed = [], []
    for _ in range(24):
        truth = _pose(rng.normal(scale=1e-4, size=3), rng.normal(scale=1e-5, size=3))
        measured = _moved(truth, points) + rng.normal(scale=NOISE, size=points.shape)
        registration = register(measured, None, mesh, **NEAR)
        errors.append(_error(registration, truth))
        claimed.append(registration.covariance)
    whitened = np.linalg.solve(np.linalg.cholesky(np.mean(claimed, axis=0)), np.transpose(errors))
    # 144 numbers of unit variance: their mean square scatters by sqrt(2 / 144) = 0.12. The factor
    # for correlation, never below one, widens by some per cent what needs no widening.
    assert 0.7 < (whitened**2).mean() < 1.25


def test_noise_shared_by_neighbours_widens_the_covariance():
    """Every noise value serves ten points side by side: ten say no more than one."""
    rng = np.random.default_rng(1)
    mesh = box(SIZE)
    spots = _three_faces(200, rng)
    spots = np.clip(spots, 2e-3, SIZE - 2e-3) * (spots < SIZE) + SIZE * (spots == SIZE)
    points = np.repeat(spots, 10, axis=0)
    inner = points < SIZE
    points = points + np.where(inner, rng.uniform(-1e-3, 1e-3, points.shape), 0.0)
    alone = register(points + rng.normal(scale=NOISE, size=points.shape), None, mesh, **NEAR)
    shared = np.repeat(rng.normal(scale=NOISE, size=spots.shape), 10, axis=0)
    together = register(points + shared, None, mesh, **NEAR)
    assert alone.variance_inflation < 1.5
    # Ten; 64 groups give it to sqrt(2 / (64 * 6)) = 7 %, and cut some of the tens in two.
    assert together.variance_inflation == pytest.approx(10.0, rel=0.25)


def test_precise_points_decide_where_noise_is_given():
    """Half of the points are ten times noisier: weights make them harmless."""
    rng = np.random.default_rng(2)
    mesh, points = box(SIZE), _three_faces(600, rng)
    std = np.where(np.arange(600) % 2, NOISE, 10.0 * NOISE)
    measured = points + std[:, None] * rng.normal(size=points.shape)
    weighted = register(measured, std, mesh, **NEAR)
    precise = register(measured[1::2], None, mesh, **NEAR)
    plain = register(measured, None, mesh, **NEAR)
    spread = [
        np.sqrt(np.trace(registration.covariance[3:, 3:]))
        for registration in (weighted, precise, plain)
    ]
    assert spread[0] < 1.1 * spread[1]
    assert spread[0] < 0.8 * spread[2]
    full = register(measured, std[:, None, None] ** 2 * np.eye(3), mesh, **NEAR)
    np.testing.assert_allclose(full.T_mesh_points, weighted.T_mesh_points, atol=1e-12)


def test_depth_noise_counts_only_across_the_surface():
    """Noise along x blurs the face across x and no other."""
    rng = np.random.default_rng(4)
    mesh, points = box(SIZE), _three_faces(600, rng)
    covariance = np.diag([100.0, 1.0, 1.0]) * NOISE**2
    measured = points + rng.normal(size=points.shape) @ np.sqrt(covariance)
    registration = register(measured, np.broadcast_to(covariance, (600, 3, 3)).copy(), mesh, **NEAR)
    std = np.sqrt(np.diag(registration.covariance))[3:]
    assert std[0] > 4.0 * max(std[1], std[2])
    assert _mahalanobis(registration, np.eye(4)) < 27.9


def test_result_does_not_depend_on_the_frame_of_the_points():
    rng = np.random.default_rng(5)
    mesh, points = box(SIZE, cells=2), _three_faces(500, rng)
    points = points + rng.normal(scale=NOISE, size=points.shape)
    start = _pose((0.02, -0.03, 0.01), (0.004, 0.003, -0.002))
    other = _pose((1.0, 0.5, -2.0), (0.3, -0.2, 0.5))
    first = register(points, None, mesh, start=start)
    second = register(_moved(other, points), None, mesh, start=start @ np.linalg.inv(other))
    # Both iterations end within a tenth of a standard deviation.
    gap = _error(second, np.linalg.inv(first.T_mesh_points @ np.linalg.inv(other)))
    assert gap @ np.linalg.solve(first.covariance, gap) < 0.1**2
    np.testing.assert_allclose(second.covariance, first.covariance, rtol=0.02, atol=1e-14)


def test_free_motions_stay_as_the_start_has_them():
    """The dome of a ball: its centre is found, its direction is the start's."""
    rng = np.random.default_rng(6)
    mesh = TriangleMesh(*refined_surface(sphere(2, radius=0.03), pieces=3))
    points = _ball(900, rng, lowest=0.0)
    start = _pose((0.03, -0.05, 0.04), (0.006, -0.004, 0.003))
    registration = register(
        points + rng.normal(scale=NOISE, size=points.shape), None, mesh, start=start
    )
    assert len(registration.free) == 3
    turn = Rotation.from_matrix(registration.T_mesh_points[:3, :3] @ start[:3, :3].T).magnitude()
    # To second order in the steps of the last fit; the start is turned by 0.07.
    assert turn < 1e-3
    # What is left of the facets, two hundredths of a millimetre, moves the centre by twice as much.
    np.testing.assert_allclose(registration.T_mesh_points[:3, 3], 0.0, atol=6e-5)
    # A free turn about the ball's centre carries the centroid of the points along.
    pivot = registration.centre
    for motion in registration.free:
        np.testing.assert_allclose(motion[3:], np.cross(motion[:3], pivot), atol=0.03)


@pytest.mark.parametrize("subdivisions", [2, 3])
@pytest.mark.parametrize("noise", [1e-6, NOISE])
def test_turns_of_a_ball_are_free_however_fine_its_facets(subdivisions, noise):
    rng = np.random.default_rng(7)
    points = _ball(900, rng)
    measured = points + rng.normal(scale=noise, size=points.shape)
    registration = register(measured, None, sphere(subdivisions, radius=0.03), **NEAR)
    check_registration(registration)
    assert "turning about any axis through" in free_motions_text(registration)


def test_turns_of_a_dome_are_free(shared_data):
    """Half ball of the rendered sets: its rim is not seen as such."""
    mesh = TriangleMesh(*refined_surface(read_mesh(shared_data / "halfball_images" / "mesh.ply")))
    rng = np.random.default_rng(8)
    points = _seen(mesh, np.array([0.1, -0.2, 0.4]), 800, rng)
    points = points[points[:, 2] > 0.002]
    points *= 0.04 / np.linalg.norm(points, axis=1)[:, None]
    measured = points + rng.normal(scale=NOISE, size=points.shape)
    registration = register(measured, None, mesh, **NEAR)
    check_registration(registration)
    assert re.match(
        r"turning about any axis through \((-?0\.\d|0), (-?0\.\d|0), (-?0\.\d|0)\) mm",
        free_motions_text(registration),
    )


def _cylinder(around=40, along=12, radius=0.02, length=0.06):
    angle = 2.0 * np.pi * np.arange(around) / around
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    height = np.linspace(0.0, length, along + 1)
    vertices = np.concatenate([np.column_stack([ring, np.full(around, z)]) for z in height])
    vertices = np.concatenate([vertices, [[0.0, 0.0, 0.0], [0.0, 0.0, length]]])
    j, k = np.arange(around), (np.arange(around) + 1) % around
    triangles = [np.stack([j, np.full(around, len(vertices) - 2), k], axis=1)[:, [0, 1, 2]]]
    for i in range(along):
        a, b = i * around, (i + 1) * around
        triangles += [np.stack([a + j, a + k, b + k], 1), np.stack([a + j, b + k, b + j], 1)]
    triangles.append(
        np.stack([along * around + j, along * around + k, 0 * j + len(vertices) - 1], 1)
    )
    return TriangleMesh(vertices, np.concatenate(triangles))


def _lateral(count, rng):
    angle = rng.uniform(0.0, np.pi, count)
    height = rng.uniform(0.005, 0.055, count)
    return np.stack([0.02 * np.cos(angle), 0.02 * np.sin(angle), height], axis=1)


def test_free_motions_are_named():
    rng = np.random.default_rng(9)
    noise = rng.normal(scale=NOISE, size=(800, 3))
    side = _lateral(800, rng)
    top = side[:250] * [1.0, 1.0, 0.0] * np.sqrt(rng.uniform(size=(250, 1))) + [0.0, 0.0, 0.06]
    plate = rng.uniform(0.1, 0.9, size=(800, 3)) * SIZE
    plate[:, 2] = SIZE[2]
    slab = _three_faces(800, rng) * [0.8, 1.0, 1.0] + [0.007, 0.0, 0.0]
    slab = slab[slab[:, 0] < 0.0629]
    about_z = r"turning about the axis \(0\.00, 0\.00, 1\.00\) through"
    cases = [
        (_cylinder(), side, r"sliding along \(0\.00, 0\.00, 1\.00\) and " + about_z),
        (_cylinder(), np.concatenate([side, top])[-800:], about_z),
        (box(SIZE), plate, r"sliding across \(0\.00, 0\.00, 1\.00\) and " + about_z),
        (box(SIZE), slab, r"sliding along \(1\.00, 0\.00, 0\.00\)$"),
    ]
    for mesh, points, text in cases:
        registration = register(points + noise[: len(points)], None, mesh, **NEAR)
        check_registration(registration)
        assert re.match(text, free_motions_text(registration))


def test_a_plate_beyond_its_edge_says_nothing_of_the_place():
    """Points that overhang an edge lie on the wrong face; they must not fix the sliding."""
    rng = np.random.default_rng(10)
    plate = rng.uniform(0.0, 1.0, size=(800, 3)) * SIZE
    plate[:, 2] = SIZE[2]
    plate += rng.normal(scale=NOISE, size=plate.shape) + np.array([0.01, 0.004, 0.0])
    registration = register(plate, None, box(SIZE), distance=1e-3)
    assert len(registration.free) == 3


def _sheet(height, thickness=2e-3, cells=(24, 6)):
    """Closed sheet of 100 x 25 mm whose top is at z = height(x, y)."""
    x, y = (
        np.linspace(-0.5, 0.5, n + 1) * side for n, side in zip(cells, (0.1, 0.025), strict=True)
    )
    x, y = np.meshgrid(x, y, indexing="ij")
    top = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    a = np.arange(x.size).reshape(x.shape)
    quads = np.stack([a[:-1, :-1], a[1:, :-1], a[1:, 1:], a[:-1, 1:]], axis=-1).reshape(-1, 4)
    face = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    rim = np.concatenate([a[:, 0], a[-1, 1:], a[-2::-1, -1], a[0, -2:0:-1]])
    after = np.roll(rim, -1)
    side = [np.stack([rim, rim + x.size, after + x.size], 1)]
    side += [np.stack([rim, after + x.size, after], 1)]
    vertices = np.concatenate([top, top - [0.0, 0.0, thickness]])
    return TriangleMesh(vertices, np.concatenate([face, face[:, ::-1] + x.size, *side]))


def _flat(x, y):
    return 0.0 * x


def _rough(x, y):
    """A mesh made from measured points, say."""
    return np.random.default_rng(x.shape[0]).normal(scale=5e-6, size=x.shape)


def _bowed(x, y):
    return 2e-5 * np.sin(60.0 * x) * np.cos(100.0 * y)


def _arched(x, y):
    return 3e-4 * (1.0 - (x / 0.05) ** 2)


@pytest.mark.parametrize(
    ("of_mesh", "of_points", "over", "noise"),
    [
        (_flat, _flat, -3e-3, 5e-6),
        (_flat, _flat, 5e-3, NOISE),
        (_flat, _bowed, 0.0, 5e-6),
        (_rough, _flat, 0.0, NOISE),
        (_rough, _flat, 5e-3, 5e-6),
        (_bowed, _flat, -3e-3, NOISE),
        (_arched, _arched, 0.0, 5e-6),
        (_arched, _arched, 5e-3, NOISE),
    ],
)
def test_a_sheet_does_not_slide(of_mesh, of_points, over, noise):
    """Its height is found, and along itself it stays, rough, bowed or arched, seen with its edges,
    without them, or with grips that go on in its plane."""
    rng = np.random.default_rng(15)
    plate = rng.uniform(-1.0, 1.0, size=(1500, 2)) * [0.05 + over, 0.0125]
    points = np.column_stack([plate, of_points(*plate.T)])
    offset = np.array([0.0, 0.0, 5e-4])
    measured = points + rng.normal(scale=noise, size=points.shape) + offset
    eye = np.array([0.02, 0.01, 0.4])
    mesh = TriangleMesh(*refined_surface(_sheet(of_mesh), pieces=2))
    registration = register(measured, None, mesh, viewpoint=eye, angle=0.01, distance=2e-3)
    check_registration(registration)
    moved = _moved(registration.T_mesh_points, points.mean(axis=0) + offset) - points.mean(axis=0)
    # An arch fixes the place along it to two thousandths of its diagonal, 1 sigma, or not at all.
    assert np.abs(moved[:2]).max() < (6e-4 if of_mesh is _arched else 2e-5)
    # The bow's mean, and the rest of the noise.
    assert abs(moved[2]) < 1e-5
    assert len(registration.free) >= (2 if of_mesh is _arched else 3)
    assert registration.weakest_std < 1e-3


def test_a_long_ball_is_fixed_where_its_length_exceeds_the_facets():
    """Axes of 0.7 to 1.3 radii: no turn is free. One per cent is less than the facets pretend."""
    rng = np.random.default_rng(11)
    ball, points = sphere(3, radius=0.03), _ball(900, rng, lowest=-1.0)
    noise = rng.normal(scale=NOISE, size=points.shape)
    for stretch, free in ((1.3, 0), (1.01, 3)):
        axes = np.array([stretch, 1.0, 1.0 / stretch])
        mesh = TriangleMesh(ball.vertices * axes, ball.triangles)
        registration = register(points * axes + noise, None, mesh, **NEAR)
        assert len(registration.free) == free


def test_the_wrong_mesh_is_refused():
    rng = np.random.default_rng(12)
    points = _three_faces(300, rng)
    registration = register(points, None, sphere(2, radius=0.05))
    with pytest.raises(CalibrationError, match="cannot be brought onto the mesh"):
        check_registration(registration)


def test_exact_points_are_brought_to_rest():
    """No noise: the pose is exact, not only as good as the noise asks for."""
    points = _three_faces(300, np.random.default_rng(13))
    truth = _pose((1e-3, -2e-3, 1e-3), (1e-4, 2e-4, -1e-4))
    registration = register(_moved(truth, points), None, box(SIZE), angle=0.01, distance=1e-3)
    # A tenth of what 1e-7 of the diagonal (8.8 cm) lets them know, 9 nm.
    assert np.abs(_error(registration, truth)[3:]).max() < 1e-9


def test_input_is_checked():
    rng = np.random.default_rng(14)
    mesh, points = box(SIZE), _three_faces(100, rng)
    with pytest.raises(InputError, match="there are 20 points; a pose needs 24"):
        register(points[:20], None, mesh)
    with pytest.raises(InputError, match="on one line"):
        register(np.linspace(0.0, 1.0, 100)[:, None] * [1.0, 2.0, 3.0], None, mesh)
    for size in (1e-3, 1e3):
        beside_line = np.linspace(0.0, 1.0, 100)[:, None] * [1.0, 2.0, 3.0]
        beside_line += 1e-7 * rng.normal(size=(100, 3))
        with pytest.raises(InputError, match="on one line"):
            register(size * beside_line, None, mesh)
    with pytest.raises(InputError, match="std goes down to 0"):
        register(points, np.zeros(100), mesh)
    with pytest.raises(InputError, match="has the eigenvalue"):
        register(points, np.zeros((100, 3, 3)), mesh)

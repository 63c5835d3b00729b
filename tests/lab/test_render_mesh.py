"""The mesh for the pictures: fine where seen, closed, smooth; contrast of its textures."""

import numpy as np
import pytest
from surfaces import box, sphere

from palpate.errors import InputError
from palpate.geometry import TriangleMesh, enclosed_volume, vertex_normals, welded
from palpate.lab.render_mesh import RIM, make_render_mesh, natural, speckle, texture
from palpate.records import Camera
from palpate.vision import project

RADIUS = 0.04


def _camera(direction=(0.0, 0.0, 1.0), size=(160, 120), focal=300.0):
    """A camera 0.4 m from the origin that looks at it."""
    z = -np.array(direction) / np.linalg.norm(direction)
    x = np.cross([0.1, 1.0, 0.05], z)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z])
    pose[2, 3] = 0.4
    matrix = np.array([[focal, 0.0, 80.0], [0.0, focal, 60.0], [0.0, 0.0, 1.0]])
    return Camera("c0", size, matrix, np.zeros(8), pose)


def _edge_lengths(fine, camera):
    """Longest edge of each triangle in a camera's picture [px]."""
    pixel = project(camera, fine.vertices)[fine.triangles]
    return np.linalg.norm(pixel - np.roll(pixel, -1, axis=1), axis=2).max(axis=1)


def _facing(fine, camera):
    pose = camera.T_camera_object
    corner = fine.vertices[fine.triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    toward = -pose[:3, :3].T @ pose[:3, 3] - corner.mean(axis=1)
    return np.einsum("ma,ma->m", normal, toward) > 0.0


def _is_closed(fine):
    """Every edge between two triangles, in opposite senses, once twin vertices are welded."""
    mesh = welded(fine)
    tail, head = mesh.triangles.ravel(), np.roll(mesh.triangles, -1, axis=1).ravel()
    there = set(zip(tail.tolist(), head.tolist(), strict=True))
    return len(there) == tail.size and {(b, a) for a, b in there} == there


@pytest.mark.parametrize("mesh", [sphere(2, RADIUS), box((0.04, 0.05, 0.06), 3)])
def test_edges_that_are_seen_are_short_and_the_surface_stays_closed(mesh):
    cameras = [_camera((0.3, 0.2, 1.0)), _camera((-0.6, 0.1, 1.0), focal=400.0)]
    fine = make_render_mesh(mesh, cameras, edge=1.5)
    for camera in cameras:
        length = _edge_lengths(fine, camera)[_facing(fine, camera)]
        assert length.max() <= 1.5
        # Halving leaves none far shorter than it must be; those seen at a slant are.
        assert np.median(length) > 0.5
    assert _is_closed(fine)


def test_what_no_camera_sees_stays_coarse():
    mesh = sphere(2, RADIUS)
    fine = make_render_mesh(mesh, [_camera()], edge=1.0)
    behind = fine.vertices[:, 2] < -0.6 * RADIUS
    assert behind.sum() == (mesh.vertices[:, 2] < -0.6 * RADIUS).sum()
    beside = make_render_mesh(mesh, [_camera(size=(81, 120))], edge=1.0)
    assert len(beside.vertices) < 0.7 * len(fine.vertices)


def test_vertices_lie_on_the_smooth_surface():
    """A ball of 258 vertices: 25 times nearer than its flat triangles, whose error is of second
    order."""
    error = []
    for subdivisions in (2, 3):
        mesh = sphere(subdivisions, RADIUS)
        fine = make_render_mesh(mesh, [_camera()], edge=2.0)
        error.append(np.abs(np.linalg.norm(fine.vertices, axis=1) - RADIUS).max())
    flat = RADIUS - np.linalg.norm(mesh.vertices[mesh.triangles].mean(axis=1), axis=1).min()
    assert error[1] < 0.05 * flat
    assert np.log2(error[0] / error[1]) > 3.0
    assert enclosed_volume(fine) > enclosed_volume(mesh)


def test_creases_are_kept_and_smooth_parts_are_smooth():
    cube = make_render_mesh(box((0.05, 0.05, 0.05), 2), [_camera((0.4, 0.3, 1.0))], edge=2.0)
    normals = vertex_normals(cube.vertices, cube.triangles)
    assert np.abs(np.abs(normals).max(axis=1) - 1.0).max() < 1e-12
    ball = make_render_mesh(sphere(3, RADIUS), [_camera()], edge=2.0)
    normals = vertex_normals(ball.vertices, ball.triangles)
    assert np.abs(np.linalg.norm(normals, axis=1) - 1.0).max() < 1e-12
    seen = ball.vertices[:, 2] > 0.4 * RADIUS
    radial = ball.vertices / np.linalg.norm(ball.vertices, axis=1)[:, None]
    turn = np.degrees(np.arccos(np.einsum("va,va->v", normals, radial)[seen]))
    # Flat triangles of a ball of 258 vertices lean by up to 10 degrees, its quadratic pieces by up
    # to 5, where only four triangles meet, and by 1 on average.
    assert turn.max() < 6.0
    assert turn.mean() < 1.5


def test_normals_are_weighted_with_the_areas():
    vertices = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 1], [9, 9, 9]], dtype=float)
    normals = vertex_normals(vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    # Areas 2 along z and 1 along x.
    assert normals[0] == pytest.approx(np.array([1.0, 0.0, 2.0]) / np.sqrt(5.0))
    assert normals[1] == pytest.approx([0.0, 0.0, 1.0])
    assert (normals[4] == 0.0).all()


def test_too_few_vertices_go_where_edges_are_longest():
    mesh = sphere(2, RADIUS)
    fine = make_render_mesh(mesh, [_camera()], edge=0.5, max_vertices=3000)
    assert 2900 <= len(fine.vertices) <= 3000
    longest = _edge_lengths(fine, _camera())[_facing(fine, _camera())].max()
    # As many vertices go where they do without a limit and with that edge.
    enough = make_render_mesh(mesh, [_camera()], edge=1.05 * longest)
    assert len(enough.vertices) <= 3000
    assert _is_closed(fine)
    # Both sides of a crease are halved or none, wherever the vertices run out.
    for limit in range(200, 208):
        cube = make_render_mesh(
            box(3 * (0.05,), 2), [_camera((0.4, 0.3, 1.0))], edge=0.5, max_vertices=limit
        )
        assert len(cube.vertices) >= limit - 1
        assert _is_closed(cube)


def test_refusals():
    mesh = box(3 * (0.05,), 1)
    with pytest.raises(InputError, match="edge is 0 px"):
        make_render_mesh(mesh, [_camera()], edge=0.0)
    with pytest.raises(InputError, match="at least the 24 of the mesh"):
        make_render_mesh(mesh, [_camera()], max_vertices=23)
    with pytest.raises(InputError, match="has no size"):
        make_render_mesh(mesh, [_camera(size=None)])


def _box(side=0.1):
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    triangles = np.array([
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ])  # fmt: skip
    return TriangleMesh(side * corners, triangles)


def _face(n=400, side=0.1):
    """Points of the face z = side, row by row, and their spacing."""
    line = np.linspace(0.0, side, n, endpoint=False)
    x, y = np.meshgrid(line, line)
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, side)]), side / n


def _rng(seed=0):
    return np.random.default_rng(seed)


def _power_beyond(values, spacing, wavelength):
    """Share of the variance in waves shorter than a wavelength."""
    n = int(np.sqrt(values.size))
    window = np.hanning(n)
    picture = (values.reshape(n, n) - values.mean()) * window * window[:, None]
    power = np.abs(np.fft.fft2(picture)) ** 2
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(n, spacing), np.fft.fftfreq(n, spacing)))
    return power[frequency > 1.0 / wavelength].sum() / power.sum()


def test_speckle_covers_half_of_the_surface_between_its_two_greys():
    points, _ = _face()
    grey = speckle(points, _box(), size=1.5e-3, rng=_rng())
    assert grey.min() == pytest.approx(0.1, abs=1e-9)
    assert grey.max() == pytest.approx(0.9, abs=1e-9)
    # Some 4000 dots on this face: the covered share varies by 0.006.
    assert (grey < 0.5).mean() == pytest.approx(0.5, abs=0.02)


def test_dots_have_their_size():
    """The power spectrum of dots of diameter D has its first zero where J1(pi D f) = 0."""
    points, spacing = _face()
    size = 3e-3
    power = np.zeros((400, 400))
    for seed in range(4):
        grey = speckle(points, _box(), size=size, rng=_rng(seed)).reshape(400, 400)
        window = np.hanning(400)
        power += np.abs(np.fft.fft2((grey - grey.mean()) * window * window[:, None])) ** 2
    frequency = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(400, spacing)]))
    edges = np.linspace(0.0, 2.0 / size, 41)
    ring = np.digitize(frequency.ravel(), edges)
    mean = np.bincount(ring, power.ravel())[1:41] / np.bincount(ring)[1:41]
    # 3.8317 / pi = 1.22 for a lone disc; overlaps and the soft rim leave the dip where it is.
    dip = edges[10 + mean[10:34].argmin()] + 0.5 * edges[1]
    # The mean over rings 0.05 wide, and the valley's bottom is flat.
    assert dip * size == pytest.approx(1.22, abs=0.15)


def test_speckle_is_smooth_to_its_stated_rim():
    points, spacing = _face()
    size = 3e-3
    grey = speckle(points, _box(), size=size, rng=_rng())
    # Steepest: 1.5 over the rim, times the step between the greys.
    slope = np.abs(np.diff(grey.reshape(400, 400), axis=1)).max() / spacing
    assert slope <= 1.5 * 0.8 / (RIM * size) * (1.0 + 1e-9)
    assert _power_beyond(grey, spacing, RIM * size) < 0.003


def test_speckle_goes_around_corners_and_does_not_depend_on_the_points():
    points, _ = _face(100)
    options = {"size": 3e-3}
    whole = speckle(points, _box(), rng=_rng(3), **options)
    part = speckle(points[::7], _box(), rng=_rng(3), **options)
    assert np.array_equal(whole[::7], part)
    assert not np.array_equal(whole, speckle(points, _box(), rng=_rng(4), **options))
    shares = [
        (speckle(np.roll(points, k, axis=1), _box(), rng=_rng(3), **options) < 0.5).mean()
        for k in range(3)
    ]
    assert shares == pytest.approx([0.5] * 3, abs=0.06)


def test_a_surface_smaller_than_a_dot_may_have_none():
    points, _ = _face(10)
    grey = speckle(points, _box(1e-5), size=5e-3, rng=_rng())
    assert (grey == 0.9).all()


def test_natural_texture_has_its_mean_contrast_and_band():
    values = []
    for seed in range(8):
        points, spacing = _face(120)
        grey = natural(points, coarsest=0.02, finest=0.0025, contrast=0.12, rng=_rng(seed))
        assert grey.min() >= 0.5 - 0.24
        assert grey.max() <= 0.5 + 0.24
        # What is bent at two standard deviations has overtones: a per cent of the variance.
        assert _power_beyond(grey, spacing, 0.9 * 0.0025) < 0.01
        values.append(grey)
    # The face is five of the longest waves wide: a mean varies by a tenth of the contrast, and
    # bending takes a seventh of it.
    assert np.mean(values) == pytest.approx(0.5, abs=0.02)
    assert np.std(values) == pytest.approx(0.12 * 0.86, rel=0.1)


@pytest.mark.parametrize(
    ("coarsest", "finest", "octaves"),
    [
        (0.016, 0.002, [(0.002, 0.004, 1.0), (0.004, 0.008, 2.0), (0.008, 0.016, 4.0)]),
        (0.006, 0.005, [(0.005, 0.006, 1.0)]),
        (0.010, 0.004, [(0.004, 0.008, 1.0), (0.008, 0.010, 2.0)]),
    ],
)
def test_natural_texture_is_correlated_as_waves_of_all_directions(coarsest, finest, octaves):
    """sin(k d) / (k d) at a distance d, averaged over the wavelengths, weighted by their power."""
    distance = np.array([0.001, 0.002, 0.003, 0.005])
    start = np.random.default_rng(9).uniform(0.0, 0.2, (200, 3))
    moved = start + distance[:, None, None] * np.array([0.6, 0.0, 0.8])
    correlations = []
    for seed in range(100):
        points = np.concatenate([start[None], moved]).reshape(-1, 3)
        grey = natural(points, coarsest=coarsest, finest=finest, contrast=0.02, rng=_rng(seed))
        first, *others = (grey - 0.5).reshape(5, -1)
        correlations.append([(first * other).mean() / (first**2).mean() for other in others])
    expected = np.zeros(4)
    for low, high, power in octaves:
        length = low * (high / low) ** ((np.arange(200) + 0.5) / 200)
        expected += power * np.sinc(2.0 * distance / length[:, None]).mean(axis=0)
    expected /= sum(power for _, _, power in octaves)
    # 48 waves in each of 100 textures of an octave, and 200 places: 0.01 of chance.
    assert np.abs(np.mean(correlations, axis=0) - expected).max() < 0.03


def test_natural_texture_is_a_function_of_the_place():
    points, _ = _face(40)
    options = {"coarsest": 0.02, "finest": 0.005, "contrast": 0.15}
    whole = natural(points, rng=_rng(1), **options)
    part = natural(points[::-3].copy(), rng=_rng(1), **options)
    assert np.abs(whole[::-3] - part).max() < 1e-12
    assert np.abs(natural(points, rng=_rng(2), **options) - whole).max() > 0.1


@pytest.mark.parametrize(("kind", "longest", "contrast"), [("poor", 4, 0.02), ("natural", 8, 0.15)])
def test_kinds_of_texture_have_their_waves_and_their_contrast(kind, longest, contrast):
    points, spacing = _face(200)
    grey = texture(kind, points, _box(), size=0.005, rng=_rng())
    same = natural(points, coarsest=longest * 0.005, finest=0.005, contrast=contrast, rng=_rng())
    np.testing.assert_array_equal(grey, same)
    assert grey.mean() == pytest.approx(0.5, abs=0.05)
    assert _power_beyond(grey, spacing, 0.0045) < 0.01


def test_a_speckle_is_one_of_the_textures():
    points, _ = _face(40)
    grey = texture("speckle", points, _box(), size=0.005, rng=_rng())
    np.testing.assert_array_equal(grey, speckle(points, _box(), size=0.005, rng=_rng()))


def test_more_dots_than_can_be_drawn_are_refused():
    with pytest.raises(InputError, match=r"at most 5e[+]06 are drawn"):
        speckle(_face(4)[0], _box(), size=1e-6, rng=_rng())

"""The paper's range flow and vertex displacement: closed forms, brute force, rendered sequences."""

from dataclasses import replace

import cv2
import numba
import numpy as np
import pytest
from vision.scenes import followed
from vision.textures import Speckle, Warp

from palpate.errors import CalibrationError, InputError
from palpate.geometry import TriangleMesh, read_mesh
from palpate.records import Camera, Rig, read_rig
from palpate.vision import LangPaiFlow
from palpate.vision.lang_pai import flow as flow_file
from palpate.vision.lang_pai.disparity import head_disparity, head_points, make_head
from palpate.vision.lang_pai.flow import lang_pai_vertices
from palpate.vision.projection import project
from palpate.vision.range_flow import Outcome, RangeFlow, is_valid

SHAPE = (110, 120)
FOCAL, DEPTH, BASELINE = 400.0, 0.5, 0.02
# Of a pixel on the sheet; a whole number of pixels of disparity, 16.
PITCH = DEPTH / FOCAL
MATRIX = np.array([[FOCAL, 0.0, 54.5], [0.0, FOCAL, 44.5], [0.0, 0.0, 1.0]])
# Centres of the cameras: the reference, one to its left, one above it; y points down.
CENTRES = ((0.0, 0.0, 0.0), (-BASELINE, 0.0, 0.0), (0.0, -BASELINE, 0.0))


def _camera(name, centre, turn=(0.0, 0.0, 0.0)):
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.array(turn))[0]
    pose[:3, 3] = -pose[:3, :3] @ np.array(centre)
    return Camera(name, SHAPE[::-1], MATRIX, np.zeros(8), pose)


def _rig(count=3, *, reference=0):
    cameras = tuple(_camera(f"c{k}", centre) for k, centre in enumerate(CENTRES[:count]))
    return Rig(cameras, reference, "rig")


def _pictures(rig, motion=(0.0, 0.0)):
    """A speckled sheet at DEPTH, parallel to the pictures, moved by columns and rows of pixels."""
    texture = Speckle(SHAPE, 11)
    pictures = []
    for camera in rig.cameras:
        shift = np.array(motion) + FOCAL / DEPTH * camera.T_camera_object[:2, 3]
        pictures.append(texture.image(Warp(lambda pixel, shift=shift: pixel - shift)))
    return tuple(pictures)


def _sheet(half=0.035, depth=DEPTH, cells=14):
    """A square in the middle of the picture, seen 56 pixels wide."""
    line = np.linspace(-half, half, cells + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(line, line))
    corner = np.arange(len(x)).reshape(cells + 1, cells + 1)
    a, b, c, d = (
        corner[:-1, :-1].ravel(), corner[:-1, 1:].ravel(),
        corner[1:, 1:].ravel(), corner[1:, :-1].ravel(),
    )  # fmt: skip
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([x, y, np.full_like(x, depth)], axis=1), triangles


def _flows(rig, pictures, vertices, triangles, method=LangPaiFlow()):
    state = method.start(rig, pictures[0], TriangleMesh(vertices, triangles))
    return list(followed(state, pictures[1:], method))


def test_disparity_and_points_of_a_head_belong_together():
    """Any L, any partner: a point projects where the views say, and comes back from there."""
    cameras = tuple(
        replace(
            _camera(f"c{k}", centre, turn), distortion=np.array([-0.1, 0.02, 1e-3, 0, 0, 0, 0, 0])
        )
        for k, (centre, turn) in enumerate(
            [
                ((0.02, -0.01, 0.0), (0.02, 0.01, -0.03)),
                ((0.01, -0.09, 0.01), (-0.15, 0.02, 0.05)),
                ((0.1, -0.02, 0.01), (0.02, 0.15, 0.02)),
            ]
        )
    )
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.03, 0.03, (50, 3)) + np.array([0.02, 0.0, 0.5])
    for reference in (0, 1, 2):
        head = make_head(Rig(cameras, reference, "rig"), SHAPE)
        assert head.order[0] == reference
        disparity = head_disparity(head, points)
        start = project(head.rectified.cameras[0], points)
        for k, camera in enumerate(head.rectified.cameras):
            shift = np.zeros_like(start)
            shift[:, head.views.along[k]] = head.views.offset[k] + head.views.ratio[k] * disparity
            # Inverse distortion plays no part; half a metre in double precision.
            np.testing.assert_allclose(project(camera, points), start + shift, atol=1e-9)
        pixel = np.rint(start).astype(int)
        back = head_points(head, pixel, disparity)
        np.testing.assert_allclose(head_disparity(head, back), disparity, rtol=1e-12)
        np.testing.assert_allclose(project(head.rectified.cameras[0], back), pixel, atol=1e-9)
        assert np.abs(head.views.ratio).max() == 1.0


def test_the_partners_are_those_that_make_an_l():
    """Left along the rows, top along the columns, whatever their order; of four the best two."""
    rig = _rig()
    turned = replace(rig, cameras=tuple(rig.cameras[k] for k in (2, 0, 1)), reference=1)
    assert make_head(rig, SHAPE).order == (0, 1, 2)
    assert make_head(turned, SHAPE).order == (1, 2, 0)
    oblique = _camera("c3", (0.03, 0.02, 0.0))
    four = replace(rig, cameras=(rig.cameras[0], oblique, rig.cameras[2], rig.cameras[1]))
    assert make_head(four, SHAPE).order == (0, 3, 2)
    assert make_head(_rig(2, reference=1), SHAPE).order == (1, 0)
    line = _camera("c2", (0.05, 0.0, 0.0))
    with pytest.raises(CalibrationError, match="an L needs 30 to 150"):
        make_head(replace(rig, cameras=(*rig.cameras[:2], line)), SHAPE)


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("reference", [0, 1])
def test_a_sheet_that_moves_by_whole_pixels(count, reference):
    """Displacement, pixel, covariance in closed form: pixels over focal length times depth."""
    rig = _rig(count, reference=reference)
    vertices, triangles = _sheet()
    steps = [(0.0, 0.0), (4.0, -2.0), (7.0, -5.0)]
    flows = _flows(rig, [_pictures(rig, step) for step in steps], vertices, triangles)
    assert len(flows) == 2
    for k, (flow, step) in enumerate(zip(flows, steps[1:], strict=True), start=1):
        valid = is_valid(flow)
        assert valid.mean() > 0.97
        off = flow.displacement[valid] / PITCH - [*step, 0.0]
        # Whole pixels have no lateral error but through the depth, of a hundredth at the edges.
        depth = DEPTH**2 / (FOCAL * BASELINE)
        assert np.abs(np.median(off[:, :2], axis=0)).max() < 0.02
        assert np.std(off[:, 2]) * PITCH < 0.25 * depth
        assert (flow.cameras[valid] == count).all()
        assert not flow.reprojection[valid].any()
        assert flow.score[valid].min() > 0.95
        # Rounding of k steps alike, k^2 / 12 square pixels along the sheet; at an L of 45 degrees
        # pixels are sheared.
        matrix = make_head(rig, SHAPE).rectified.cameras[0].matrix
        side = DEPTH * np.linalg.inv(matrix)[:, :2]
        expected = k**2 / 12.0 * side @ side.T
        bias = np.broadcast_to(expected, (int(valid.sum()), 3, 3))
        np.testing.assert_allclose(flow.bias[valid], bias, atol=1e-9 * PITCH**2)
        if reference == 0 or count == 2:
            np.testing.assert_allclose(side[:2], PITCH * np.eye(2), atol=1e-12)
        assert np.isnan(flow.covariance[~valid]).all()
        assert np.isnan(flow.displacement[~valid]).all()
        assert (flow.subset, flow.step, flow.shape) == (7, 1, SHAPE)
        assert np.isnan(flow.noise).all()
        assert np.isnan(flow.gradient).all()
        np.testing.assert_allclose(project(rig.cameras[reference], flow.point), flow.pixel)


def test_rounding_on_a_slope_is_rounding_of_depth_as_well(monkeypatch):
    """Rays half a pixel to either side meet the plane of the mesh; only the mesh is tilted here."""
    rig = _rig()
    vertices, triangles = _sheet()
    vertices[:, 2] += 0.4 * vertices[:, 0] - 0.7 * vertices[:, 1]
    pictures = [_pictures(rig), _pictures(rig, (1.0, 0.0))]
    # The texture stays in one plane: it is as far from the mesh as the slope says.
    monkeypatch.setattr(flow_file, "_MAX_SURFACE_MISS_PX", 20.0)
    (flow,) = _flows(rig, pictures, vertices, triangles)
    valid = is_valid(flow)
    assert valid.mean() > 0.9
    pixel = flow.pixel[valid]

    def hit(offset):
        ray = np.column_stack([pixel + offset, np.ones(len(pixel))]) @ np.linalg.inv(MATRIX).T
        return ray * (DEPTH / (ray @ [-0.4, 0.7, 1.0]))[:, None]

    side = [hit(half) - hit(-half) for half in 0.5 * np.eye(2)]
    expected = sum(np.einsum("ni,nj->nij", ray, ray) for ray in side) / 12.0
    # Differences over a pixel against derivatives: (slope / focal length)^2.
    np.testing.assert_allclose(flow.bias[valid], expected, atol=1e-5 * PITCH**2)


def test_covariance_of_depth_is_the_scatter_of_disparity():
    rig = _rig()
    vertices, triangles = _sheet()
    pictures = [_pictures(rig), _pictures(rig, (1.0, 1.0))]
    (flow,) = _flows(rig, pictures, vertices, triangles)
    valid = is_valid(flow)
    off = flow.point[valid, 2] - DEPTH
    scatter = 1.4826 * np.median(np.abs(off))
    noise = (flow.covariance - flow.bias)[valid]
    # Depth over disparity is not quite linear over the scatter, 1 % of the depth.
    np.testing.assert_allclose(noise[:, 2, 2], 2.0 * scatter**2, rtol=0.05)
    # The error lies along the ray.
    ray = flow.point[valid] / flow.point[valid, 2:]
    whole = noise[:, 2, 2, None, None] * np.einsum("ni,nj->nij", ray, ray)
    np.testing.assert_allclose(noise, whole, atol=1e-3 * scatter**2)


def test_what_is_not_on_the_mesh_is_no_surface_flow():
    """On the left the mesh is where the sheet is; on the right it is 1.5 px of disparity off."""
    rig = _rig()
    vertices, triangles = _sheet()
    off = vertices[:, 0] > 0.004
    vertices = vertices.copy()
    vertices[off, :] *= 16.0 / 14.5
    pictures = [_pictures(rig), _pictures(rig, (2.0, 0.0))]
    (flow,) = _flows(rig, pictures, vertices, triangles)
    right, left = flow.pixel[:, 0] > 60.0, flow.pixel[:, 0] < 54.0
    assert (flow.outcome[right] == Outcome.REPROJECTION).mean() > 0.98
    assert (flow.outcome[left] == Outcome.VALID).mean() > 0.95
    # 0.8 px off is within what whole pixels are good for.
    vertices[off, :] *= 14.5 / 15.2
    (near,) = _flows(rig, pictures, vertices, triangles)
    assert is_valid(near).mean() > 0.95


def test_points_without_texture_or_partner_are_rejected_and_stay_rejected():
    rig = _rig()
    vertices, triangles = _sheet()
    pictures = [[p.copy() for p in _pictures(rig, (k, 0.0))] for k in (0.0, 1.0, 2.0)]
    # No texture in the reference; none in its partner; something else in the second instant.
    pictures[0][0][30:50, 35:55] = 90.0
    pictures[0][1][60:, :] = 110.0
    pictures[1][0][20:36, 61:75] = Speckle(SHAPE, 5).image()[20:36, 61:75]
    flows = _flows(rig, pictures, vertices, triangles)
    column, row = np.rint(flows[0].pixel).astype(int).T
    # Three pixels for the window, two for the interpolation of rectified pictures.
    flat = (column >= 40) & (column < 50) & (row >= 35) & (row < 45)
    alone = row >= 65
    covered = (column >= 65) & (column < 71) & (row >= 24) & (row < 32)
    assert min(flat.sum(), alone.sum(), covered.sum()) > 30
    for flow in flows:
        assert (flow.outcome[flat] == Outcome.TEXTURE).all()
        assert np.isin(flow.outcome[alone], (Outcome.HIDDEN, Outcome.REPROJECTION)).all()
        # By chance one in twenty wrong maxima is within one pixel of the others'.
        assert is_valid(flow)[covered].mean() < 0.2
    # A point that is lost is not taken up again.
    assert not (is_valid(flows[1]) & ~is_valid(flows[0])).any()
    assert is_valid(flows[1]).sum() > 0.4 * len(column)


def test_a_coarser_grid_is_a_part_of_the_finer_one_and_threads_do_not_matter():
    rig = _rig()
    vertices, triangles = _sheet()
    pictures = [_pictures(rig), _pictures(rig, (2.0, 1.0))]
    (fine,) = _flows(rig, pictures, vertices, triangles)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        (coarse,) = _flows(rig, pictures, vertices, triangles, LangPaiFlow(step=3))
    finally:
        numba.set_num_threads(threads)
    assert 8.5 < len(fine.pixel) / len(coarse.pixel) < 9.5
    row_of = {tuple(np.rint(p).astype(int)): k for k, p in enumerate(fine.pixel)}
    rows = [row_of[tuple(np.rint(p).astype(int))] for p in coarse.pixel]
    np.testing.assert_array_equal(coarse.displacement, fine.displacement[rows])
    np.testing.assert_array_equal(coarse.outcome, fine.outcome[rows])


def test_bad_input_is_refused():
    rig = _rig()
    vertices, triangles = _sheet()
    pictures = _pictures(rig)
    state = LangPaiFlow().start(rig, pictures, TriangleMesh(vertices, triangles))
    with pytest.raises(InputError, match="an instant has 2 pictures; must be one of each camera"):
        LangPaiFlow().follow(state, pictures[:2])
    small = tuple(picture[:70] for picture in pictures)
    with pytest.raises(InputError, match=r"pictures are of 2 sizes .*: 70 x 120, 110 x 120"):
        LangPaiFlow().follow(state, small)
    with pytest.raises(InputError, match="pictures are of 2 sizes"):
        _flows(rig, [(*pictures[:2], small[2]), pictures], vertices, triangles)
    with pytest.raises(CalibrationError, match="beside or behind"):
        _flows(rig, [pictures, pictures], -vertices, triangles)
    for name, value in {"subset": 6, "search": 1, "step": 0}.items():
        with pytest.raises(InputError, match=f"{name} is {value}; must be"):
            LangPaiFlow(**{name: value})


# Vertices ---------------------------------------------------------------------------------------


def _flow(point, displacement, *, outcome=None, subset=1, bias=0.0):
    n = len(point)
    return RangeFlow(
        pixel=np.zeros((n, 2)),
        point=point,
        tangent=np.zeros((n, 2, 3)),
        displacement=displacement,
        gradient=np.full((n, 2, 3), np.nan),
        covariance=np.zeros((n, 3, 3)),
        bias=np.broadcast_to(bias * np.eye(3), (n, 3, 3)).copy(),
        score=np.ones(n),
        reprojection=np.zeros(n),
        cameras=np.full(n, 3),
        outcome=np.zeros(n, dtype=np.int64) if outcome is None else outcome,
        through_last=np.zeros(n, dtype=bool),
        drift=float("nan"),
        noise=np.full(3, np.nan),
        subset=subset,
        step=1,
        shape=SHAPE,
    )


def _cloud(n=400, seed=0):
    """Points in a cube around two vertices; motions of which a third are outliers."""
    rng = np.random.default_rng(seed)
    point = rng.uniform(-0.015, 0.015, (n, 3))
    motion = np.array([1e-3, -2e-3, 5e-4]) + rng.normal(0.0, 1e-4, (n, 3)) + 0.02 * point
    wrong = rng.uniform(size=n) < 0.33
    motion[wrong] += rng.uniform(-1e-2, 1e-2, (wrong.sum(), 3))
    return point, motion, wrong


def _brute_vertex(point, motion, vertex):
    """The paper's text, line by line, for one vertex."""
    distance = np.linalg.norm(point - vertex, axis=1)
    near = distance <= 0.01
    u, d = motion[near], distance[near]
    square = ((u[:, None] - u[None]) ** 2).sum(axis=2)
    median = np.sort(square, axis=1)[:, len(u) // 2]
    sigma = 1.4826 * (1.0 + 5.0 / (len(u) - 1)) * np.sqrt(median.min())
    inlier = np.linalg.norm(u - u[median.argmin()], axis=1) <= 3.0 * sigma
    weight = 1.0 / (1.0 + d[inlier] / 0.01)
    mean = np.average(u[inlier], axis=0, weights=weight)
    # numpy's own: reliability weights, the unbiased scatter; times the share of the mean.
    scatter = np.cov(u[inlier].T, aweights=weight)
    return mean, scatter * (weight**2).sum() / weight.sum() ** 2, int(inlier.sum())


def test_vertices_are_the_papers_mean():
    # Fewer than a hundred motions around a vertex: every one is tried as the least median.
    point, motion, _ = _cloud(n=500)
    vertices = np.array(
        [[0.0, 0.0, 0.0], [0.004, -0.003, 0.002], [0.5, 0.0, 0.0], [0.0, 0.0, 1e-3]]
    )
    measured = lang_pai_vertices(_flow(point, motion), vertices, np.array([[0, 1, 2]]))
    for v in (0, 1):
        mean, covariance, count = _brute_vertex(point, motion, vertices[v])
        assert 30 < count < 100
        np.testing.assert_allclose(measured.displacement[v], mean, rtol=1e-12)
        np.testing.assert_allclose(measured.covariance[v], covariance, rtol=1e-9, atol=1e-20)
        assert measured.count[v] == count
    # Too far from all flow; of no triangle.
    assert np.isnan(measured.displacement[2:]).all()
    assert np.isnan(measured.covariance[2:]).all()
    assert not measured.count[2:].any()


def test_the_limit_of_outliers_is_wider_where_there_are_few_motions():
    """Six motions of a heavy tail around each of 200 vertices, against the same text in numpy."""
    rng = np.random.default_rng(8)
    vertices = np.repeat(0.1 * np.arange(201.0)[:, None], 3, axis=1)
    point = (vertices[:, None] + rng.uniform(-0.005, 0.005, (201, 6, 3))).reshape(-1, 3)
    motion = 1e-4 * rng.standard_t(1.0, (1206, 3))
    triangles = np.arange(201).reshape(-1, 3)
    measured = lang_pai_vertices(_flow(point, motion), vertices, triangles)
    counts = [_brute_vertex(point, motion, vertex)[2] for vertex in vertices]
    np.testing.assert_array_equal(measured.count, counts)
    assert {4, 5, 6} <= set(counts)


def test_a_third_of_outliers_does_no_harm():
    point, motion, wrong = _cloud(3000)
    vertices = np.array([[0.0, 0.0, 0.0], [0.002, 0.0, 0.0], [0.0, 0.003, 0.0]])
    triangles = np.array([[0, 1, 2]])
    all_of_it = lang_pai_vertices(_flow(point, motion), vertices, triangles)
    clean = lang_pai_vertices(_flow(point[~wrong], motion[~wrong]), vertices, triangles)
    truth = np.array([1e-3, -2e-3, 5e-4]) + 0.02 * vertices
    # Scatter 1e-4 plus the gradient's 1e-4 over 300 points and more: 1e-5.
    assert np.abs(clean.displacement - truth).max() < 3e-5
    assert np.abs(all_of_it.displacement - truth).max() < 5e-5


def test_covariance_covers_the_error_of_independent_motions():
    """2000 draws: the mean of squares over the covariance is 3, good to 6 %."""
    rng = np.random.default_rng(1)
    point = rng.uniform(-0.005, 0.005, (2000, 50, 3)) + 0.1 * np.arange(2000)[:, None, None]
    motion = rng.normal(0.0, 1e-4, (2000, 50, 3))
    vertices = np.repeat(0.1 * np.arange(2000.0)[:, None], 3, axis=1)
    triangles = np.arange(1998).reshape(-1, 3)
    # The corners of each cube are 0.87 cm away; the limit is at 7 of a component's sigmas.
    measured = lang_pai_vertices(
        _flow(point.reshape(-1, 3), motion.reshape(-1, 3)), vertices, triangles
    )
    error, covariance = measured.displacement[:1998], measured.covariance[:1998]
    square = np.einsum("vi,vij,vj->v", error, np.linalg.inv(covariance), error)
    # Few samples: Hotelling's T^2 of 50 draws has the mean 3 * 49 / (49 - 3 - 1).
    assert abs(square.mean() / (3.0 * 49 / 45) - 1.0) < 0.08


def test_overlapping_windows_and_shared_rounding_are_not_averaged_away():
    point, motion, _ = _cloud(3000)
    vertices = np.array([[0.0, 0.0, 0.0], [0.002, 0.0, 0.0], [0.0, 0.003, 0.0]])
    triangles = np.array([[0, 1, 2]])
    alone = lang_pai_vertices(_flow(point, motion), vertices, triangles).covariance
    wide = lang_pai_vertices(_flow(point, motion, subset=7), vertices, triangles).covariance
    np.testing.assert_allclose(wide, 49.0 * alone, rtol=1e-9)
    shared = lang_pai_vertices(_flow(point, motion, bias=1e-8), vertices, triangles).covariance
    np.testing.assert_allclose(shared, alone + 1e-8 * np.eye(3), rtol=1e-9, atol=1e-20)


def test_rejected_flow_and_too_little_of_it_say_nothing():
    point, motion, wrong = _cloud(600)
    outcome = np.where(wrong, int(Outcome.SCORE), 0)
    vertices = np.array([[0.0, 0.0, 0.0], [0.002, 0.0, 0.0], [0.0, 0.003, 0.0]])
    triangles = np.array([[0, 1, 2]])
    lost = motion.copy()
    lost[wrong] = np.nan
    some = lang_pai_vertices(_flow(point, lost, outcome=outcome), vertices, triangles)
    only = lang_pai_vertices(_flow(point[~wrong], motion[~wrong]), vertices, triangles)
    np.testing.assert_array_equal(some.displacement, only.displacement)
    for n in (0, 3):
        few = lang_pai_vertices(_flow(0.1 * point[:n], motion[:n]), vertices, triangles)
        assert np.isnan(few.displacement).all()
        assert not few.count.any()
    same = np.full((4, 3), 1e-3)
    equal = lang_pai_vertices(_flow(0.1 * point[:4], same), vertices, triangles)
    np.testing.assert_allclose(equal.displacement, 1e-3, rtol=1e-12)
    np.testing.assert_allclose(equal.covariance, 0.0, atol=1e-20)


# Rendered ---------------------------------------------------------------------------------------


def test_rendered_translation(shared_data):
    """Needs ../shared. Two steps of 2.5 mm, 4.3 px each; the truth is the same everywhere."""
    folder = shared_data / "rigid_translation_x"
    rig = read_rig(folder / "rig.toml")
    mesh = read_mesh(folder / "mesh.ply", metres_per_unit=1.0)
    pictures = [
        tuple(
            cv2.imread(
                str(folder / "images" / f"s{k}_{camera.name}.png"), cv2.IMREAD_GRAYSCALE
            ).astype(np.float32)
            for camera in rig.cameras
        )
        for k in range(3)
    ]
    flows = _flows(rig, pictures, mesh.vertices, mesh.triangles, LangPaiFlow(step=2))
    axis = rig.cameras[0].T_camera_object[2, :3]
    for k, flow in enumerate(flows, start=1):
        valid = is_valid(flow)
        assert valid.mean() > 0.95
        truth = np.array([0.0025 * k, 0.0, 0.0])
        error = flow.displacement[valid] - truth
        depth = error @ axis
        lateral = np.linalg.norm(error - depth[:, None] * axis, axis=1)
        # A pixel is 0.54 mm there. Rounding to whole ones leaves 0.29 px a component where it is
        # evenly spread, k times that where every step rounds alike; much less would be too good.
        pixel = 0.54e-3
        rms = np.sqrt((lateral**2).mean() / 2.0)
        assert 0.5 * 0.29 * k * pixel < rms < 1.5 * 0.29 * k * pixel
        # The paper: half a millimetre. Depth: 0.13 px of disparity at both ends, 4.4 mm a pixel,
        # and the slope of the surface times the rounding.
        length = np.linalg.norm(flow.displacement[valid], axis=1) - 0.0025 * k
        assert np.sqrt((length**2).mean()) < 0.5e-3
        assert np.sqrt((depth**2).mean()) < 1e-3
        whole = np.einsum("ni,nij,nj->n", error, np.linalg.inv(flow.covariance[valid]), error)
        # Median of chi square with three degrees of freedom: 2.37.
        assert 0.7 < np.sqrt(np.median(whole) / 2.37) < 1.4
    measured = lang_pai_vertices(flows[0], mesh.vertices, mesh.triangles)
    good = np.isfinite(measured.displacement).all(axis=1)
    error = measured.displacement[good] - [0.0025, 0.0, 0.0]
    assert good.sum() > 900
    # Steps of the rounding are shared by neighbours: averaging over a centimetre leaves them.
    assert 0.1e-3 < np.sqrt((error**2).sum(axis=1).mean()) < 0.4e-3

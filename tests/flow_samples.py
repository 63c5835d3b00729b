"""Motion of a cube that two cameras see from above: everything about it in closed form."""

from functools import cache
from types import SimpleNamespace

import numpy as np
from surfaces import box

from palpate.geometry import closest_points
from palpate.records import Camera, Rig
from palpate.vision import Outcome, RangeFlow, SurfaceMap, VertexDisplacement

SIDE = 0.04  # m
ABOVE = 0.4  # of the cameras over the upper face [m]
FOCAL = 1000.0  # px: 2.5 px a millimetre on the upper face
SHAPE = (120, 160)  # rows, columns
STEP, SUBSET = 4, 13
SIGMA = np.array([3e-6, 4e-6, 2e-5])  # along x, y, z of the object [m]


def camera(name="c0", x=0.5 * SIDE):
    """A camera over the cube that looks straight down: columns along x, rows against y."""
    matrix = np.array([[FOCAL, 0.0, 79.5], [0.0, FOCAL, 59.5], [0.0, 0.0, 1.0]])
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = -pose[:3, :3] @ [x, 0.5 * SIDE, SIDE + ABOVE]
    return Camera(name, SHAPE[::-1], matrix, np.zeros(8), pose)


def rig():
    """Two such cameras, the first is the reference."""
    return Rig((camera(), camera("c1", x=0.06)), 0, "rig.toml")


def motion(points, along=(1.0, 0.0, 0.0)):
    """Displacement that grows linearly with x, from 0.1 mm at x = 0 to 0.3 mm at the other end."""
    return (1e-4 + 5e-3 * points[:, :1]) * np.asarray(along)


def sample(*, reject=None, along=(1.0, 0.0, 0.0)):
    """The cube with its surface map, range flow, vertices and picture.

    `reject` maps an `Outcome` to the indices of points that have it; their vertices stay.
    """
    mesh, surface = _surface()
    row, column = np.nonzero(surface.triangle >= 0)
    on_grid = (row % STEP == 0) & (column % STEP == 0)
    row, column = row[on_grid], column[on_grid]
    point = surface.point[row, column]
    moved, outcome = motion(point, along), np.zeros(len(point), dtype=np.int64)
    covariance = np.tile(np.diag(SIGMA**2), (len(point), 1, 1))
    for cause, which in (reject or {}).items():
        outcome[which] = cause
    bad = outcome != Outcome.VALID
    moved[bad], covariance[bad] = np.nan, np.nan
    flow = RangeFlow(
        pixel=np.stack([column, row], axis=1).astype(np.float64),
        point=point,
        tangent=np.tile(np.eye(3)[:2], (len(point), 1, 1)),
        displacement=moved,
        gradient=np.full((len(point), 2, 3), np.nan),
        covariance=covariance,
        bias=0.1 * covariance,
        score=np.where(bad, 0.4, 0.98),
        reprojection=np.where(bad, np.nan, np.linspace(0.01, 0.03, len(point))),
        cameras=np.where(bad, 1, 2),
        outcome=outcome,
        through_last=np.arange(len(point)) == 0,
        drift=3e-6,
        noise=np.array([1.5, 1.75]),
        subset=SUBSET,
        step=STEP,
        shape=SHAPE,
    )
    random = np.random.default_rng(3)
    picture = np.where(surface.triangle >= 0, random.uniform(40, 200, SHAPE), 8.0)
    return SimpleNamespace(
        mesh=mesh,
        rig=rig(),
        camera=camera(),
        surface=surface,
        flow=flow,
        vertices=_vertices(mesh, along),
        picture=picture.astype(np.float32),
    )


@cache
def _surface():
    """Rays through pixel centres cut with the upper face; nothing else of the cube is seen."""
    mesh = box(size=(SIDE, SIDE, SIDE), cells=6)
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    x = 0.5 * SIDE + ABOVE * (column - 79.5) / FOCAL
    y = 0.5 * SIDE - ABOVE * (row - 59.5) / FOCAL
    point = np.stack([x, y, np.full(SHAPE, SIDE)], axis=2)
    inside = ((point[..., :2] > 0.0) & (point[..., :2] < SIDE)).all(axis=2)
    point[~inside] = np.nan
    triangle = np.full(SHAPE, -1)
    triangle[inside] = closest_points(mesh, point[inside]).triangle
    return mesh, SurfaceMap(point, triangle)


def _vertices(mesh, along):
    """Vertices of the upper face, but for its rim, which no window covers."""
    inner = (mesh.vertices[:, :2] > 0.1 * SIDE) & (mesh.vertices[:, :2] < 0.9 * SIDE)
    known = inner.all(axis=1) & (mesh.vertices[:, 2] > 0.9 * SIDE)
    moved = np.full(mesh.vertices.shape, np.nan)
    moved[known] = motion(mesh.vertices[known], along)
    covariance = np.full((len(moved), 3, 3), np.nan)
    covariance[known] = np.diag((0.5 * SIGMA) ** 2)
    return VertexDisplacement(moved, covariance, np.where(known, 9, 0))

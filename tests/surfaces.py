"""Closed triangle surfaces for tests, made by hand: no mesh program, no file."""

import numpy as np
from scipy.spatial import ConvexHull

from palpate.geometry import TriangleMesh, welded


def box(size=(1.0, 1.0, 1.0), cells=1, origin=(0.0, 0.0, 0.0)) -> TriangleMesh:
    """Box from `origin`, edges cut into `cells`, all alike or by axis, every square cut in two."""
    cells = np.broadcast_to(cells, 3)
    vertices, triangles = [], []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        steps = [np.linspace(0.0, 1.0, cells[i] + 1) for i in (first, second)]
        u, v = (grid.ravel() for grid in np.meshgrid(*steps, indexing="ij"))
        a = np.arange(len(u)).reshape(cells[first] + 1, cells[second] + 1)
        corners = [a[:-1, :-1], a[1:, :-1], a[1:, 1:], a[:-1, 1:]]
        quads = np.stack(corners, axis=-1).reshape(-1, 4)
        flat = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        for side in (0.0, 1.0):
            face = np.zeros((len(u), 3))
            face[:, axis] = side
            face[:, first], face[:, second] = u, v
            triangles.append((flat if side else flat[:, ::-1]) + sum(map(len, vertices)))
            vertices.append(face * np.asarray(size) + np.asarray(origin))
    return welded(TriangleMesh(np.concatenate(vertices), np.concatenate(triangles)))


def sphere(subdivisions=2, radius=1.0) -> TriangleMesh:
    """Octahedron, every triangle cut in four `subdivisions` times, vertices on the sphere."""
    vertices = np.concatenate([np.eye(3), -np.eye(3)])
    triangles = np.array(
        [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    )
    for _ in range(subdivisions):
        corner = vertices[triangles]
        middle = 0.5 * (corner + np.roll(corner, -1, axis=1))
        points = np.concatenate([corner, middle], axis=1).reshape(-1, 3)
        base = 6 * np.arange(len(triangles))[:, None, None]
        cut = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
        mesh = welded(TriangleMesh(points, (base + cut).reshape(-1, 3)))
        vertices, triangles = mesh.vertices, mesh.triangles
        vertices = vertices / np.linalg.norm(vertices, axis=1)[:, None]
    return TriangleMesh(radius * vertices, triangles)


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    """Several surfaces in one mesh, vertices kept apart."""
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    return TriangleMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([m.triangles + s for m, s in zip(meshes, starts, strict=False)]),
    )


def hull_mesh(vertices: np.ndarray) -> TriangleMesh:
    """Convex hull of points as an outward mesh."""
    hull = ConvexHull(vertices)
    used, triangles = np.unique(hull.simplices, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    corner = vertices[used][triangles]
    inward = np.einsum(
        "ta,ta->t", np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]),
        hull.equations[:, :3],
    ) < 0.0  # fmt: skip
    triangles[inward] = triangles[inward][:, ::-1]
    return TriangleMesh(vertices[used], triangles)


def ball_mesh(axes: np.ndarray, count: int = 8000) -> TriangleMesh:
    """Ellipsoid of these half axes, with its lowest point at the origin."""
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - z**2)
    unit = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    return hull_mesh(unit * axes + np.array([0.0, 0.0, axes[2]]))

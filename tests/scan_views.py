"""What a range camera that goes around an object sees: exact points and their noise."""

from functools import cache

import numpy as np

from palpate.geometry import TriangleMesh
from palpate.lab import SHAPES
from palpate.records import Camera
from palpate.scanning.scan_file import View, make_view
from palpate.vision import surface_map

NOISE = 5e-5
SIZE = (160, 120)


@cache
def toy(edge=2.5e-3):
    return SHAPES["toy"].make(radius=0.035, edge=edge)


def camera_at(azimuth, elevation=0.35, distance=0.8, target=(0.0, 0.0, 0.03)):
    """A camera that looks at the object from an azimuth and an elevation [rad]."""
    level = np.cos(elevation)
    eye = distance * np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    z = np.asarray(target) - eye
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z])
    pose[:3, 3] = -pose[:3, :3] @ eye
    matrix = np.array([[700.0, 0.0, 80.0], [0.0, 700.0, 60.0], [0.0, 0.0, 1.0]])
    return Camera("depth", SIZE, matrix, np.zeros(5), pose)


def seen_points(mesh: TriangleMesh, camera: Camera, rng, *, noise=NOISE):
    """Points in the camera's frame, noisy along their rays."""
    surface = surface_map(camera, SIZE[::-1], mesh.vertices, mesh.triangles)
    pose = camera.T_camera_object
    points = surface.point[surface.triangle >= 0] @ pose[:3, :3].T + pose[:3, 3]
    return points * (1.0 + rng.normal(0.0, noise, len(points)) / points[:, 2])[:, None]


def views_around(mesh: TriangleMesh, count=8, *, known=True, noise=NOISE, seen=None) -> list[View]:
    """Views from all around, or the first `seen` of them; their poses given or not."""
    return list(_views(mesh, count, known, noise, count if seen is None else seen))


@cache
def _views(mesh, count, known, noise, seen):
    """A view takes a third of a second: those of one mesh are made once a run."""
    rng = np.random.default_rng(7)
    views = []
    for k in range(seen):
        camera = camera_at(2.0 * np.pi * k / count)
        points = seen_points(mesh, camera, rng, noise=noise)
        pose = np.linalg.inv(camera.T_camera_object) if known else None
        views.append(make_view(f"v{k:02d}", points, sigma=noise, pose=pose))
    return views

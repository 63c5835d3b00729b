"""What the scenes of all pages have: cameras, arrows, light, and a view that the object fills.

Lengths in a scene are in millimetres.
"""

from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float
from matplotlib.colors import to_rgb

from palpate.figures import BLUE
from palpate.geometry import TriangleMesh, bounding_diagonal
from palpate.records import Camera
from palpate.shapes import Vector3

# Columns and rows assumed for cameras whose calibration does not give them.
_IMAGE_SIZE = (640, 480)
_FOV = np.pi / 3
# Share of the view that the object fills.
_FILLED = 0.75
# Thickness of arrows, and size of cameras, as fractions of the object's size.
_TIP, _FRUSTUM = 0.006, 0.12


def rgb(colour: str) -> tuple[int, int, int]:
    """A matplotlib colour as three bytes, 0 to 255."""
    red, green, blue = (round(255 * share) for share in to_rgb(colour))
    return red, green, blue


def camera_view_pose(camera: Camera) -> tuple[Float[np.ndarray, "4"], Vector3, float]:
    """Orientation, position and field of view of a camera, in viser's conventions.

    Parameters
    ----------
    camera : Camera

    Returns
    -------
    (4,) float                      quaternion w, x, y, z of the rotation from its frame to the
                                    object's
    (3,) float [mm]                 position in the object frame
    float [rad]                     vertical field of view
    """
    pose = camera.T_camera_object
    orientation = trimesh.transformations.quaternion_from_matrix(np.linalg.inv(pose))
    rows = (camera.size or _IMAGE_SIZE)[1]
    position = -1e3 * pose[:3, :3].T @ pose[:3, 3]
    return orientation, position, float(2 * np.arctan(0.5 * rows / camera.matrix[1, 1]))


def draw_camera(scene: Any, camera: Camera, size: float, picture: Any = None) -> None:
    """Draw a camera, with what it sees.

    Parameters
    ----------
    scene : SceneApi of viser
    camera : Camera
    size : float [mm]               of the object
    picture : (rows, columns, 3) uint8 or None
    """
    orientation, position, fov = camera_view_pose(camera)
    columns, rows = camera.size or _IMAGE_SIZE
    scene.add_camera_frustum(
        f"/cameras/{camera.name}", fov=fov, aspect=columns / rows, scale=_FRUSTUM * size,
        thickness=0.002 * size, color=rgb(BLUE), image=picture, wxyz=orientation,
        position=position,
    )  # fmt: skip


def draw_arrows(
    scene: Any, name: str, start: np.ndarray, end: np.ndarray, colour: Any, size: float
) -> Any:
    """Draw arrows.

    Parameters
    ----------
    scene : SceneApi of viser
    name : str                      in the scene
    start, end : (n, 3) float [mm]
    colour : three int              red, green, blue, 0 to 255
    size : float [mm]               of the object, to which they are as thick as fits

    Returns
    -------
    ArrowsHandle
    """
    unit = _TIP * size
    return scene.add_arrows(
        name, np.stack([start, end], axis=1), colour,
        shaft_radius=0.5 * unit, head_radius=1.5 * unit, head_length=3.0 * unit,
    )  # fmt: skip


def light(scene: Any) -> None:
    """Default lights and a little ambient light."""
    scene.configure_default_lights(enabled=True, cast_shadow=False)
    scene.add_light_ambient("/light", intensity=0.15)


def look(client: Any, mesh: TriangleMesh, toward: Vector3) -> None:
    """Set a tab's view so that the object fills it.

    Parameters
    ----------
    client : ClientHandle of viser
    mesh : TriangleMesh             the object
    toward : (3,) float             unit vector toward the viewer, not vertical
    """
    corners, size = 1e3 * mesh.vertices, 1e3 * bounding_diagonal(mesh)
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    camera = client.camera
    across = np.cross((0.0, 0.0, 1.0), toward)
    across /= np.linalg.norm(across)
    axes = np.stack([across, np.cross(toward, across)])
    half = _FILLED * np.tan(0.5 * _FOV) * np.array([camera.aspect, 1.0])
    reach = np.abs((corners - middle) @ axes.T) / half
    distance = float((reach.max(axis=1) + (corners - middle) @ toward).max())
    camera.near, camera.far, camera.fov = 0.01 * size, 100.0 * size, _FOV
    camera.up_direction = (0.0, 0.0, 1.0)
    camera.position = tuple(middle + distance * toward)
    camera.look_at = tuple(middle)

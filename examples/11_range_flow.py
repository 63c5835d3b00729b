"""Displacement in three dimensions from two pictures of each of two cameras.

python examples/11_range_flow.py
"""

import numpy as np

from palpate.records import Camera, Rig
from palpate.vision import JointFlow, is_valid

SHAPE = (120, 150)  # rows, columns
FOCAL, DISTANCE = 1000.0, 0.30  # px, m
MOTION = np.array([2e-4, -1e-4, 3e-4])  # of a flat plate at z = 0, truth [m]


def camera(name: str, angle: float) -> Camera:
    """A camera that looks at the origin from `angle` [rad] beside the z axis."""
    c, s = np.cos(angle), np.sin(angle)
    pose = np.array([[c, 0, -s, 0], [0, -1, 0, 0], [-s, 0, -c, DISTANCE], [0, 0, 0, 1.0]])
    middle = 0.5 * (np.array(SHAPE) - 1)
    matrix = np.array([[FOCAL, 0, middle[1]], [0, FOCAL, middle[0]], [0, 0, 1.0]])
    return Camera(name, SHAPE[::-1], matrix, np.zeros(8), pose)


def picture(view: Camera, motion: np.ndarray, waves: np.ndarray) -> np.ndarray:
    """Grey levels of a patterned plate after a shift, each pixel's ray cut with the plate."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    pixel = np.stack([column, row, np.ones(SHAPE)], axis=-1)
    turn, shift = view.T_camera_object[:3, :3], view.T_camera_object[:3, 3]
    centre = -turn.T @ shift
    ray = pixel @ np.linalg.inv(view.matrix).T @ turn
    position = centre + ray * ((motion[2] - centre[2]) / ray[..., 2])[..., None] - motion
    # Some hundred waves in all directions, of random phases, are as good as speckles.
    return 120 + 4 * np.cos(position[..., :2] @ waves[:, :2].T + waves[:, 2]).sum(axis=-1)


def main() -> np.ndarray:
    """Follow the plate; gives the median displacement [m]."""
    rng = np.random.default_rng(2)
    waves = np.column_stack([rng.normal(0.0, 2e3, (100, 2)), rng.uniform(0.0, 2 * np.pi, 100)])
    rig = Rig((camera("left", -0.15), camera("right", 0.15)), 0, "example")
    still, moved = (
        [picture(view, motion, waves) for view in rig.cameras] for motion in (0 * MOTION, MOTION)
    )
    corners = 0.025 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    method = JointFlow()
    state = method.start_on(rig, still, corners, np.array([[0, 1, 2], [0, 2, 3]]))
    _, flow = method.follow(state, moved)
    valid = is_valid(flow)
    displacement = np.median(flow.displacement[valid], axis=0)
    sigma = np.sqrt(np.median(np.einsum("nii->ni", flow.covariance[valid]), axis=0))
    print(f"{valid.sum()} of {len(valid)} points followed")
    print(f"truth {1e3 * MOTION} mm, median {np.round(1e3 * displacement, 4)} mm")
    print(f"one point is known to {np.round(1e6 * sigma, 2)} micrometres (1 sigma)")
    return displacement


if __name__ == "__main__":
    main()

"""A flat sheet in tension before two cameras: its pose, and 60 000 points of its motion.

    python -m benchmarks.sheet

The pictures are computed: a plane that moves affinely is seen through an exact inverse, so nothing
of the package has a part in the truth. The mesh is rough, as one made from measured points is.
"""

import time

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from palpate.geometry import TriangleMesh
from palpate.pipeline.motion.sequences import posed_rig
from palpate.records import Camera, Rig
from palpate.vision import JointFlow, is_valid

# Columns and rows; of the sheet as much is in view, and more than the mesh in its plane: the grips.
SHAPE = (480, 640)
SIDES = np.array([0.100, 0.060])
DISTANCE, FOCAL = 0.4, 2400.0
ROUGH, THICK = 5e-6, 1e-3
# 2 % along, Poisson's ratio 0.45 across, and the grips shift and tilt.
STRETCH = np.array([[0.020, 0.001, 0.0], [-0.001, -0.009, 0.0], [0.0005, 0.001, 0.0]])
SHIFT = np.array([3e-4, -1e-4, 2e-4])
# Pixels of the texture for one of the pictures', and its speckles' standard deviation.
FINE, BLOB, NOISE = 4, 1.7, 1.5


def make_cameras() -> Rig:
    """Two cameras 25 degrees apart, above the sheet's plane z = 0."""
    cameras = []
    for k, angle in enumerate((-12.5, 12.5)):
        turn = cv2.Rodrigues(np.deg2rad([180.0, 0.0, 0.0]))[0]
        turn = cv2.Rodrigues(np.deg2rad([0.0, angle, 0.0]))[0] @ turn
        pose = np.eye(4)
        pose[:3, :3], pose[2, 3] = turn, DISTANCE
        middle = (SHAPE[1] / 2 - 0.5, SHAPE[0] / 2 - 0.5)
        matrix = np.array([[FOCAL, 0.0, middle[0]], [0.0, FOCAL, middle[1]], [0.0, 0.0, 1.0]])
        cameras.append(Camera(f"c{k}", SHAPE[::-1], matrix, np.zeros(8), pose))
    return Rig(tuple(cameras), 0, "sheet")


def make_sheet(rng: np.random.Generator, cells: tuple[int, int] = (50, 30)) -> TriangleMesh:
    """A closed sheet whose top lies at z = 0 but for the roughness."""
    x, y = (np.linspace(-0.5, 0.5, n + 1) * side for n, side in zip(cells, SIDES, strict=True))
    x, y = np.meshgrid(x, y, indexing="ij")
    top = np.stack([x, y, rng.normal(scale=ROUGH, size=x.shape)], axis=-1).reshape(-1, 3)
    a = np.arange(x.size).reshape(x.shape)
    quads = np.stack([a[:-1, :-1], a[1:, :-1], a[1:, 1:], a[:-1, 1:]], axis=-1).reshape(-1, 4)
    face = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    rim = np.concatenate([a[:, 0], a[-1, 1:], a[-2::-1, -1], a[0, -2:0:-1]])
    after = np.roll(rim, -1)
    side = [np.stack([rim, rim + x.size, after + x.size], 1)]
    side += [np.stack([rim, after + x.size, after], 1)]
    vertices = np.concatenate([top, top - [0.0, 0.0, THICK]])
    return TriangleMesh(vertices, np.concatenate([face, face[:, ::-1] + x.size, *side]))


def picture(
    camera: Camera, texture: np.ndarray, gradient: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    """What a camera sees of the plane z = 0 after u = gradient X + shift, without noise."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].reshape(2, -1)
    pose = camera.T_camera_object
    sight = np.linalg.solve(camera.matrix, np.stack([column, row, np.ones(row.size)]))
    # depth * sight = R ((1 + gradient) X + shift) + t with X = (x, y, 0), for depth, x and y.
    moved = pose[:3, :3] @ (np.eye(3) + gradient)[:, :2]
    right = -(pose[:3, :3] @ shift + pose[:3, 3])
    system = np.empty((row.size, 3, 3))
    system[:, :, :2], system[:, :, 2] = moved, -sight.T
    flat = np.linalg.solve(system, np.broadcast_to(right[:, None], (row.size, 3, 1)))[:, :2, 0]
    position = flat / (DISTANCE / FOCAL / FINE) + 0.5 * np.array(texture.shape[::-1])
    seen = map_coordinates(texture, position.T[::-1], order=3, mode="mirror")
    return seen.reshape(SHAPE)


def main() -> None:
    """Print what becomes of the pose and of the points."""
    rng = np.random.default_rng(0)
    rig, mesh = make_cameras(), make_sheet(rng)
    size = (FINE * SHAPE[0] * 3 // 2, FINE * SHAPE[1] * 3 // 2)
    texture = gaussian_filter(rng.normal(size=size).astype(np.float32), FINE * BLOB)
    texture = 120.0 + 40.0 * texture / texture.std()
    rest, loaded = (
        tuple(
            (picture(camera, texture, *motion) + rng.normal(scale=NOISE, size=SHAPE)).clip(0, 255)
            for camera in rig.cameras
        )
        for motion in ((np.zeros((3, 3)), np.zeros(3)), (STRETCH, SHIFT))
    )
    for choice in ("auto", "register"):
        begun = time.perf_counter()
        posed, notes = posed_rig(rig, rest, mesh, choice)
        left = posed.cameras[0].T_camera_object @ np.linalg.inv(rig.cameras[0].T_camera_object)
        moved = np.linalg.inv(rig.cameras[0].T_camera_object) @ left @ [0.0, 0.0, DISTANCE, 1.0]
        print(f"--pose {choice}: moved by {1e6 * np.round(moved[:3], 9)} um,"
              f" {time.perf_counter() - begun:.1f} s; {'; '.join(notes)}")  # fmt: skip
    begun = time.perf_counter()
    method = JointFlow(step=2)
    _, flow = method.follow(method.start(rig, rest, mesh), loaded)
    seconds = time.perf_counter() - begun
    valid = is_valid(flow)
    flat = flow.point * [1.0, 1.0, 0.0]
    error = (flow.displacement - (flat @ STRETCH.T + SHIFT))[valid]
    inverse = np.linalg.inv(flow.covariance[valid])
    claimed = np.sqrt(np.einsum("ni,nij,nj->n", error, inverse, error).mean() / 3.0)
    rms = 1e6 * np.sqrt((error**2).mean(axis=0))
    print(
        f"{len(valid)} points, {100 * valid.mean():.1f} % valid, {seconds:.0f} s; rms error"
        f" {rms[0]:.2f}, {rms[1]:.2f}, {rms[2]:.2f} um; error over claimed sigma {claimed:.2f}"
    )


if __name__ == "__main__":
    main()

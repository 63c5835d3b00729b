"""Analytic scenes: a textured surface seen by several cameras, at rest and after a smooth motion.

The surface is z = h(x, y) with a texture given in (x, y). What a pixel of the moved picture shows
is found by Newton's method on the exact projection, written out here, so that nothing of the
package has a part in the truth.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
from jaxtyping import Float
from vision.textures import Speckle, Warp, pixel_grid

from palpate.records import Camera, Rig
from palpate.vision import FlowMethod, JointFlow, RangeFlow
from palpate.vision.joint.flow import JointState

SHAPE = (150, 190)
# Cameras stand this far from the origin, a pixel is PITCH wide there [m].
DISTANCE = 0.3
PITCH = 3e-4
# Barrel of 1.5 px at the corners, tangential terms of half a pixel.
LENS = (-0.4, 0.3, 2e-3, -3e-3, 0.1)
# Direction of the cameras from the object: column and row of the angle off the z axis [degrees].
_PLACES = ((0.0, 0.0), (-20.0, 0.0), (0.0, -18.0), (16.0, 14.0))

Motion = Callable[[np.ndarray], np.ndarray]


def STILL(points: np.ndarray) -> np.ndarray:
    """No motion."""
    return np.zeros_like(points)


def rigid(turn: tuple[float, ...], shift: tuple[float, ...]) -> Motion:
    """Turn about the origin by a rotation vector [rad], then shift [m]."""
    matrix = cv2.Rodrigues(np.array(turn, dtype=float))[0]
    return lambda points: points @ matrix.T + np.array(shift) - points


def strain(gradient: Float[np.ndarray, "3 3"], shift: tuple[float, ...] = (0, 0, 0)) -> Motion:
    """u = gradient X + shift."""
    return lambda points: points @ np.asarray(gradient).T + np.array(shift)


def bump(peak: tuple[float, ...], width: float, centre: tuple[float, float] = (0, 0)) -> Motion:
    """A displacement `peak` [m] that falls off as a Gaussian of `width` [m] in x and y."""

    def motion(points: np.ndarray) -> np.ndarray:
        away = ((points[:, :2] - np.array(centre)) ** 2).sum(axis=1) / width**2
        return np.exp(-0.5 * away)[:, None] * np.array(peak)

    return motion


def dome(radius: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Height of a paraboloid with this radius of curvature at the top [m]."""
    return lambda x, y: -(x * x + y * y) / (2.0 * radius)


def tilted(slope: tuple[float, float]) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Height of a plane through the origin."""
    return lambda x, y: slope[0] * x + slope[1] * y


def make_rig(
    count: int = 3, *, lens: tuple[float, ...] = (), reference: int = 0, order: tuple = ()
) -> Rig:
    """Cameras that look at the origin from about the z axis, the first straight down on it.

    Parameters
    ----------
    count : int                     2 to 4
    lens : terms of the distortion
    reference : int                 after reordering
    order : permutation of the cameras
    """
    terms = np.zeros(8)
    terms[: len(lens)] = lens
    focal = DISTANCE / PITCH
    rows, columns = SHAPE
    cameras = []
    for k in range(count):
        # x to the right, y down, z away from the camera: half a turn about x, then the place.
        half = cv2.Rodrigues(np.array([np.pi, 0.0, 0.0]))[0]
        about = cv2.Rodrigues(np.deg2rad(np.array([_PLACES[k][1], _PLACES[k][0], 3.0 * k])))[0]
        pose = np.eye(4)
        pose[:3, :3] = about @ half
        pose[:3, 3] = [5e-4 * k, -3e-4 * k, DISTANCE * (1.0 + 0.03 * k)]
        matrix = np.array([
            [focal * (1.0 + 0.02 * k), 0.0, columns / 2 - 0.5 + k],
            [0.0, focal * (1.01 + 0.02 * k), rows / 2 - 0.5 - k],
            [0.0, 0.0, 1.0],
        ])  # fmt: skip
        cameras.append(Camera(f"c{k}", (columns, rows), matrix, terms, pose))
    chosen = tuple(cameras[k] for k in (order or range(count)))
    return Rig(chosen, reference, "scene")


def moved_frame(rig: Rig, turn: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"]) -> Rig:
    """The same cameras in another object frame, X' = turn X + shift."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn.T, -turn.T @ shift
    return replace(
        rig,
        cameras=tuple(
            replace(camera, T_camera_object=camera.T_camera_object @ pose) for camera in rig.cameras
        ),
    )


@dataclass(frozen=True, eq=False)
class Stage:
    """A textured surface before cameras.

    Attributes
    ----------
    rig : Rig
    height : (x, y) -> z [m]
    seed : int                      of the texture
    blob : float [px]               standard deviation of a speckle
    """

    rig: Rig
    height: Callable[[np.ndarray, np.ndarray], np.ndarray]
    seed: int = 0
    blob: float = 1.7

    def views(self, motion: Motion = STILL) -> list[np.ndarray]:
        """Pictures of all cameras after a motion, without noise, (rows, columns) each."""
        return self.textured_views(motion, self.seed)[0]

    def textured_views(self, motion: Motion, *seeds: int) -> list[list[np.ndarray]]:
        """The same with each of some textures; what moves where is found once for all of them."""
        textures = [Speckle(SHAPE, seed, self.blob) for seed in seeds]
        warps = [self._warp(camera, motion) for camera in self.rig.cameras]
        return [[texture.image(warp) for warp in warps] for texture in textures]

    def mesh(self, spacing: float = 1e-3, half: float = 0.06) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and triangles of the surface over a square, normals up."""
        line = np.arange(-half, half + 0.5 * spacing, spacing)
        x, y = (grid.ravel() for grid in np.meshgrid(line, line, indexing="ij"))
        n = len(line)
        corner = np.arange(n * n).reshape(n, n)
        a, b, c, d = (
            corner[:-1, :-1].ravel(), corner[1:, :-1].ravel(),
            corner[1:, 1:].ravel(), corner[:-1, 1:].ravel(),
        )  # fmt: skip
        triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
        return np.stack([x, y, self.height(x, y)], axis=1), triangles

    def points(self, flat: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """Points of the surface at rest over (x, y)."""
        return np.column_stack([flat, self.height(*flat.T)])

    def rest_points(
        self, camera: Camera, pixels: Float[np.ndarray, "n 2"], motion: Motion
    ) -> Float[np.ndarray, "n 2"]:
        """(x, y) at rest of what pixels of the moved picture show, by Newton's method."""
        flat, _ = self._solved(camera, pixels, motion)
        return flat

    def _seen(self, camera: Camera, flat: np.ndarray, motion: Motion) -> np.ndarray:
        """Pixel of the moved surface point over (x, y) at rest."""
        rest = self.points(flat)
        return projected(camera, rest + motion(rest))

    def _solved(
        self, camera: Camera, pixels: np.ndarray, motion: Motion
    ) -> tuple[np.ndarray, np.ndarray]:
        """(x, y) at rest behind pixels, and its derivative by the pixel, (n, 2, 2)."""
        flat = np.zeros((len(pixels), 2))
        h, inverse = 1e-6, None
        for _ in range(30):
            off = pixels - self._seen(camera, flat, motion)
            # Near the end the slope stays as it is.
            if inverse is None or np.abs(off).max() > 1e-3:
                (a, c), (b, d) = (
                    (self._seen(camera, flat + h * e, motion)
                     - self._seen(camera, flat - h * e, motion)).T / (2.0 * h)
                    for e in np.eye(2)
                )  # fmt: skip
                inverse = (np.array([[d, -b], [-c, a]]) / (a * d - b * c)).transpose(2, 0, 1)
            step = _turned(inverse, off)
            # A tenth of the object at most, so that no step passes behind a camera.
            long = np.linalg.norm(step, axis=1, keepdims=True)
            flat += step * np.minimum(1.0, 0.03 / np.maximum(long, 1e-12))
            if np.abs(off).max() < 1e-8:
                return flat, inverse
        raise RuntimeError("a pixel of the scene shows no point of the surface")

    def _warp(self, camera: Camera, motion: Motion) -> Warp:
        """The texture's places behind the places that `Speckle.image` asks for.

        Solved at pixel centres, linear over the third of a pixel around them: what bends there is
        below 1e-4 px and the same on both sides.
        """
        rows, columns = SHAPE
        cached: list[np.ndarray] = []

        def inverse(pixel: np.ndarray) -> np.ndarray:
            # Every texture asks for the same places.
            if not cached:
                pixel = pixel.reshape(rows * columns, -1, 2)
                centre = pixel_grid(SHAPE).reshape(-1, 2)
                flat, slope = self._solved(camera, centre, motion)
                source = flat[:, None] + _turned(slope[:, None], pixel - centre[:, None])
                middle = np.array([columns / 2 - 0.5, rows / 2 - 0.5])
                cached.append((source / PITCH + middle).reshape(-1, 2))
            return cached[0]

        return Warp(inverse)


def _turned(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Products of many (2, 2) matrices with vectors; einsum takes three times as long."""
    x, y = vector[..., 0], vector[..., 1]
    rows = [matrix[..., i, 0] * x + matrix[..., i, 1] * y for i in range(2)]
    return np.stack(rows, axis=-1)


def projected(camera: Camera, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Pixels of points, by OpenCV's formula without the rational terms and without skew."""
    pose, (k1, k2, p1, p2, k3) = camera.T_camera_object, camera.distortion[:5]
    x, y, z = (points @ pose[:3, :3].T + pose[:3, 3]).T
    a, b = x / z, y / z
    r2 = a * a + b * b
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    column = a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)
    row = b * radial + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b
    k = camera.matrix
    return np.stack([k[0, 0] * column + k[0, 2], k[1, 1] * row + k[1, 2]], axis=1)


def noisy_views(views: list[np.ndarray], sigma: float, seed: int) -> list[np.ndarray]:
    """Pictures with white noise [grey levels], another in each."""
    rng = np.random.default_rng(seed)
    return [(view + rng.normal(0.0, sigma, view.shape)).astype(np.float32) for view in views]


def first_instant(
    stage: "Stage", views: list[np.ndarray], method: JointFlow = JointFlow()
) -> JointState:
    """The first instant of a stage for the method `joint`, on the stage's own mesh."""
    return method.start_on(stage.rig, views, *stage.mesh())


def followed(
    state: object, series: Iterable[list[np.ndarray]], method: FlowMethod = JointFlow()
) -> Iterator[RangeFlow]:
    """Range flow to each instant of a series."""
    for views in series:
        state, flow = method.follow(state, views)
        yield flow


# Motions of two to seven pixels; the bump bends by 0.05 px over half a window.
MOTIONS = {
    "still": STILL,
    "shift": rigid((0.0, 0.0, 0.0), (4e-4, 3e-4, -5e-4)),
    "turn": rigid((0.02, -0.03, 0.04), (1e-3, -5e-4, 8e-4)),
    "strain": strain(
        np.array([[0.02, 0.01, 0.0], [-0.005, -0.015, 0.0], [0.01, 0.02, 0.01]]),
        (3e-4, 2e-4, -4e-4),
    ),
    "bump": bump((2e-4, -1e-4, -1.5e-3), 0.012),
}


@cache
def example(count: int = 3, lens: tuple[float, ...] = ()) -> Stage:
    """A dome with a radius of 60 mm before 2, 3 or 4 cameras."""
    return Stage(make_rig(count, lens=lens), dome(0.06), seed=count)


@cache
def example_views(name: str, count: int = 3, lens: tuple[float, ...] = ()) -> list[np.ndarray]:
    """Pictures of the example after one of `MOTIONS`, without noise; made once a run."""
    return example(count, lens).views(MOTIONS[name])

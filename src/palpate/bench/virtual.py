"""The virtual bench as a bench: its arm presses a body of finite elements, its gauge reads the
force, and its cameras render what they would see.

It has a clock of its own, which moves of the arm and pictures advance: nobody waits for a virtual
second. Pictures are rendered where the arm stands still; the tool is drawn, and casts its shadow.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from palpate.bench.arms import ArmLimits, GuardedArm
from palpate.bench.devices import Picture
from palpate.geometry import TriangleMesh, ray_intersection
from palpate.lab import (
    Film,
    LabConfig,
    Print,
    Probe,
    SolvedPress,
    Variant,
    aim,
    board_picture,
    board_pose,
    make_studio,
    photograph,
    rod_at,
    solve_press,
)
from palpate.records import Rig
from palpate.shapes import Points, Vector3, Vertices
from palpate.solids import surface_values

# Rates of cameras and gauge [Hz].
_FRAMES, _READINGS = 15.0, 100.0
# Of the gauge: the weight of the tool [N], and the noise where the configuration has none, over the
# wanted force.
_WEIGHT, _NOISE = 0.2, 0.002
# Limits of the arm: how many times the wanted force; depth, speed in a second, and room around the
# object, over its size.
_MOST_FORCE, _DEEPEST, _SPEED, _ROOM = 1.3, 0.3, 0.1, 2.0
# Time for which a board is held at a place [s], and the blur of its pictures [px].
_SHOWN, _BLUR = 0.8, 0.6
# What the cameras see of a surface, with a tool or without: a picture of each, without noise.
Draw = Callable[[Vertices, TriangleMesh | None], tuple[Float[np.ndarray, "_ _"], ...]]


@dataclass(frozen=True, slots=True, eq=False)
class DrawnBody:
    """The rendered surface of a virtual object, and what draws it.

    Attributes
    ----------
    vertices : (v, 3) float [m]     at rest
    draw : Draw
    """

    vertices: Vertices
    draw: Draw


def rendered_body(config: LabConfig, rig: Rig, variant: Variant) -> DrawnBody:
    """The object of a configuration as Mitsuba renders it.

    Parameters
    ----------
    config : LabConfig
    rig : Rig                       the true one
    variant : Variant               of Mitsuba

    Returns
    -------
    DrawnBody
    """
    quiet = replace(config.pictures, noise=0.0, full_well=None, gain_drift=0.0, bits=12)
    rng = np.random.default_rng(config.seed)
    studio = make_studio(replace(config, pictures=quiet), rig, variant, rng=rng)

    def draw(vertices: Vertices, rod: TriangleMesh | None) -> tuple[np.ndarray, ...]:
        taken = photograph(studio, [vertices], rod, rng=rng)
        return tuple(picture.astype(np.float32) / np.float32(257.0) for picture in taken)

    return DrawnBody(studio.mesh.vertices, draw)


class VirtualWorld:
    """What the devices of a virtual bench share: the object, the tool, and the time.

    Parameters
    ----------
    config : LabConfig              its probings are left out
    rig : Rig                       the true one
    body : DrawnBody
    force : float [N]               that pushes are to have
    """

    def __init__(self, config: LabConfig, rig: Rig, body: DrawnBody, force: float) -> None:
        self.config, self.rig, self.body, self.force = config, rig, body, force
        self.rng = np.random.default_rng([config.seed, 1])
        self.time = 0.0
        middle = config.specimen.mesh.vertices.mean(axis=0)
        self.size = float(np.ptp(config.specimen.mesh.vertices, axis=0).max())
        self.position = middle + np.array([0.0, 0.0, 1.5 * self.size])
        self.pushes = 0
        # A board that is held before the cameras, at another place every second.
        self.shown: Print | None = None
        self._press: SolvedPress | None = None
        self._surface: CubicSpline | None = None
        self._path = [(0.0, -1.0)]
        self._drawn: tuple[float, tuple[np.ndarray, ...]] | None = None

    @property
    def depth(self) -> float:
        """Travel of the tool beyond first contact over that under the largest force; below zero
        without contact."""
        if self._press is None:
            return -1.0
        away, along = self.position - self._press.point, self._press.tip.direction
        if np.linalg.norm(np.cross(away, along)) > self.config.arm.radius:
            # Above another place, and perhaps deeper along this direction than this one.
            return -1.0
        return min(float(away @ along) / self._press.depth, 1.0)

    def go(self, position: Vector3, seconds: float) -> None:
        """Move the tool so that it arrives at a position after some seconds."""
        self.position = position
        self.wait(seconds)

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.time += seconds
        self._path.append((self.time, self.depth))

    def aim_at(self, point: Vector3, inward: Vector3) -> None:
        """Solve the push at a place, once the tool is above it."""
        self.pushes += 1
        probe = Probe(f"push {self.pushes}", point, inward, force=_MOST_FORCE * self.force)
        config = replace(self.config, probes=(probe,))
        tip = aim(probe, config.arm, config.specimen.mesh, rng=self.rng)
        self._press = solve_press(config, tip, 0, Film(1))
        rest = self.body.vertices
        moved = surface_values(self._press.solid, rest)
        states = np.stack([moved @ u for u in self._press.displacements])
        self._surface = CubicSpline(self._press.depth_fraction, states)

    def readings(self, since: float) -> tuple[np.ndarray, np.ndarray]:
        """Times and readings of the gauge since a time, until now."""
        time = np.arange(since + 1.0 / _READINGS, self.time + 1e-9, 1.0 / _READINGS)
        depth = np.interp(time, *np.array(self._path).T)
        self._path = self._path[-2:]
        force = self.force_at(depth)
        sensor = self.config.force_sensor
        noise = np.hypot(sensor.noise or _NOISE * self.force, sensor.relative_noise * force)
        return time, force + _WEIGHT + noise * self.rng.standard_normal(len(time))

    def force_at(self, depth: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Force of the push that was solved last, at depths as `depth` counts them [N]."""
        if self._press is None:
            return np.zeros(len(depth))
        return np.asarray(self._press.force_at(depth) @ self._press.tip.direction)

    def picture(self, camera: int) -> Picture:
        """What a camera sees now, with noise."""
        # A place of the board counts as a depth above the object.
        board = self.shown
        depth = max(self.depth, 0.0) if board is None else -1.0 - self.time // _SHOWN
        if self._drawn is None or self._drawn[0] != depth:
            self._drawn = depth, self._board(board, int(-depth)) if board else self.drawn(depth)
        grey = self._drawn[1][camera]
        noisy = grey + self.config.pictures.noise * self.rng.standard_normal(grey.shape)
        return np.clip(np.rint(noisy), 0.0, 255.0).astype(np.uint8)

    def _board(self, board: Print, number: int) -> tuple[np.ndarray, ...]:
        """The board at one of its places, from 1; that is the table."""
        rng = np.random.default_rng([self.config.seed, 4, number])
        pose = board_pose(self.rig, board, self.config, number - 1, rng)
        return tuple(
            board_picture(camera, pose, *board, rng=rng, noise=0.0, blur=_BLUR)
            for camera in self.rig.cameras
        )

    def drawn(self, depth: float) -> tuple[np.ndarray, ...]:
        """What all cameras see at a depth of the push that was solved last, without noise."""
        rest, press = self.body.vertices, self._press
        if press is None or self._surface is None or depth == 0.0:
            return self.body.draw(rest, None)
        rod = rod_at(press.tip, press.tip_position(depth, 0.0), self.rig.cameras)
        return self.body.draw(rest + self._surface(depth), rod)


class VirtualCamera:
    """One camera of a virtual bench."""

    def __init__(self, world: VirtualWorld, number: int) -> None:
        self._world, self._number = world, number
        self.name = world.rig.cameras[number].name
        self._last = -1.0

    def start(self) -> None:
        """As in `Camera`."""

    def grab(self) -> tuple[Picture, float]:
        """As in `Camera`; all cameras expose at the same time."""
        if self._last >= self._world.time:
            self._world.wait(1.0 / _FRAMES)
        self._last = self._world.time
        return self._world.picture(self._number), self._last

    @property
    def settings(self) -> Mapping[str, str]:
        """Size of the pictures."""
        columns, rows = self._world.rig.cameras[self._number].size or (0, 0)
        return {"source": "virtual", "size": f"{columns} x {rows}"}

    def close(self) -> None:
        """As in `Camera`."""


class VirtualGauge:
    """The gauge of a virtual bench, in line with the tool."""

    typed = False
    limit: float | None = None

    def __init__(self, world: VirtualWorld) -> None:
        self._world, self._last = world, 0.0

    def start(self) -> None:
        """As in `ForceSource`."""
        self._last = self._world.time

    def read(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """As in `ForceSource`."""
        time, force = self._world.readings(self._last)
        self._last = float(time[-1]) if len(time) else self._last
        return time, force

    def close(self) -> None:
        """As in `ForceSource`."""


class VirtualArm:
    """The arm of a virtual bench."""

    def __init__(self, world: VirtualWorld) -> None:
        self._world = world
        self._aimed: Points = np.zeros((2, 3))

    def start(self) -> None:
        """As in `Arm`."""

    def pose(self) -> Vector3:
        """As in `Arm`."""
        return self._world.position.copy()

    def move(self, position: Vector3, direction: Vector3, speed: float) -> None:
        """As in `Arm`; the push is solved where a move first comes down on the object."""
        world = self._world
        way = position - world.position
        length = float(np.linalg.norm(way))
        if length > 0.0 and way @ direction > 0.999 * length and not self._on_line(direction):
            point = ray_intersection(world.config.specimen.mesh, world.position, direction)
            if point is not None:
                self._aimed = np.stack([point, direction])
                world.aim_at(point, direction)
        world.go(position, length / speed)

    def _on_line(self, direction: Vector3) -> bool:
        """Whether the push that was solved last is on the way."""
        point, inward = self._aimed
        beside = np.cross(self._world.position - point, inward)
        return bool(direction @ inward > 1.0 - 1e-9 and np.linalg.norm(beside) < 1e-6)

    def stop(self) -> None:
        """As in `Arm`: no move is under way between two calls."""

    def close(self) -> None:
        """As in `Arm`."""


def virtual_devices(
    world: VirtualWorld,
) -> tuple[tuple[VirtualCamera, ...], VirtualGauge, GuardedArm]:
    """Cameras, gauge and arm of a virtual bench.

    Parameters
    ----------
    world : VirtualWorld

    Returns
    -------
    cameras, gauge, arm             the arm within limits that leave room for its pushes
    """
    low, high = (f(world.config.specimen.mesh.vertices, axis=0) for f in (np.min, np.max))
    limits = ArmLimits(
        _MOST_FORCE * world.force, _DEEPEST * world.size, _SPEED * world.size,
        low - _ROOM * world.size, high + _ROOM * world.size,
    )  # fmt: skip
    cameras = tuple(VirtualCamera(world, k) for k in range(len(world.rig.cameras)))
    return cameras, VirtualGauge(world), GuardedArm(VirtualArm(world), limits, asks=False)

"""Arms of Universal Robots, by ur-rtde.

Tried against a stand-in with the same calls, not with a robot. Where the connection breaks, the
robot's program ends and it stops where it is, by its controller; nothing retracts it.
"""

import time
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from palpate.bench.devices import DeviceError
from palpate.optional_imports import late_import
from palpate.records import TomlTable, read_import_pose
from palpate.shapes import Vector3

# Acceleration, and deceleration when it is stopped [m/s^2]; the controller's set point has arrived
# within so much [m]; time between two looks, and beyond that of the way [s].
_ACCELERATION, _BRAKE, _THERE, _LOOK, _SPARE = 0.1, 1.0, 1e-5, 4e-3, 3.0
_TURN = 1e-3
_STOPPED = {
    "isEmergencyStopped": "its emergency stop is pressed: release it",
    "isProtectiveStopped": "it has stopped to protect something: see what, and acknowledge",
}


class UniversalRobot:
    """A robot whose tool's end is its TCP, with z along the tool.

    Parameters
    ----------
    host : str                      its address
    key : int                       digital input of the dead man's key: it moves while that is on
    T_object_base : (4, 4) float [m]    x_object = T x_base
    """

    def __init__(self, host: str, key: int, T_object_base: Float[np.ndarray, "4 4"]) -> None:
        self.host, self.key, self.base = host, key, T_object_base
        self._control: Any = None
        self._receive: Any = None

    def start(self) -> None:
        """As in `Arm`."""
        control, receive = (
            late_import(name, extra="ur", purpose="an arm of Universal Robots")
            for name in ("rtde_control", "rtde_receive")
        )
        self.close()
        try:
            self._receive = receive.RTDEReceiveInterface(self.host)
            self._control = control.RTDEControlInterface(self.host)
        except RuntimeError as error:
            raise self._error(f"{error}; is it on, and in remote control?") from error

    def pose(self) -> Vector3:
        """As in `Arm`."""
        here = np.array(self._receive.getActualTCPPose()[:3])
        return np.asarray(self.base[:3, :3] @ here + self.base[:3, 3])

    def move(self, position: Vector3, direction: Vector3, speed: float) -> None:
        """As in `Arm`; stopped in its way where the key is let go, and where it does not arrive.

        Raises
        ------
        DeviceError                 it is not where it was to go
        """
        turn = self.base[:3, :3].T
        here = np.array(self._receive.getTargetTCPPose())
        goal = turn @ (position - self.base[:3, 3])
        wanted, axis = Rotation.from_rotvec(here[3:]), turn @ direction
        # The least turn that brings the tool's z onto the direction.
        wanted = Rotation.align_vectors(axis[None], wanted.apply([[0.0, 0.0, 1.0]]))[0] * wanted
        self._check()
        pose = [*goal.tolist(), *wanted.as_rotvec().tolist()]
        if not self._control.moveL(pose, speed, _ACCELERATION, True):
            raise self._error("it refuses to move; is the program on its panel running?")
        latest = time.monotonic() + float(np.linalg.norm(goal - here[:3])) / speed + _SPARE
        while not self._is_at(goal, wanted):
            time.sleep(_LOOK)
            self._check()
            if time.monotonic() > latest:
                self.stop()
                raise self._error("it has not arrived; is its speed limited on its panel?")

    def stop(self) -> None:
        """As in `Arm`."""
        self._control.stopL(_BRAKE)

    def close(self) -> None:
        """As in `Arm`."""
        if self._control is not None:
            self._control.stopScript()
            self._control.disconnect()
        if self._receive is not None:
            self._receive.disconnect()
        self._control = self._receive = None

    def _is_at(self, goal: Vector3, wanted: Rotation) -> bool:
        now = np.array(self._receive.getTargetTCPPose())
        off = (Rotation.from_rotvec(now[3:]) * wanted.inv()).magnitude()
        return bool(np.linalg.norm(now[:3] - goal) < _THERE and off < _TURN)

    def _check(self) -> None:
        """Stop it where the key is let go; see that it is there."""
        if not self._receive.isConnected():
            raise self._error("the connection broke: its controller stops it where it is")
        for name, what in _STOPPED.items():
            if getattr(self._receive, name)():
                raise self._error(what)
        if not self._receive.getDigitalInState(self.key):
            self.stop()
            raise self._error(f"the dead man's key, digital input {self.key}, is not held")

    def _error(self, what: str) -> DeviceError:
        return DeviceError(f"the arm at {self.host}: {what}; then go on")


def universal_robot(table: TomlTable) -> UniversalRobot:
    """The arm of its table in bench.toml."""
    table.check_keys(("driver", "host", "key", "base", "limits"))
    base, _ = read_import_pose(table.existing_file("base"))
    return UniversalRobot(table.text("host"), table.count("key"), base)

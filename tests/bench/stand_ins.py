"""Modules with the calls of the makers' libraries that the drivers use; nothing is behind them."""

import sys
from types import ModuleType

import numpy as np

# Two modules in which a child process finds a camera that counts its pictures.
HARVESTERS = """
import itertools, numpy as np
from contextlib import contextmanager
from types import SimpleNamespace as N
count = itertools.count()
class Camera:
    remote_device = N(node_map=N(PixelFormat=N(value="BayerRG8"), ExposureAuto=N(value="On")))
    def start(self):
        nodes = vars(self.remote_device.node_map)
        assert {name: node.value for name, node in nodes.items()} == {
            "PixelFormat": "Mono8", "ExposureAuto": "Off"}
    @contextmanager
    def fetch(self, *, timeout):
        data = np.full(48 * 64, next(count) % 250, np.uint8)
        yield N(payload=N(components=[N(data=data, height=48, width=64)]))
        data[:] = 0
class Harvester:
    def add_file(self, path, check_existence=False): self.path = path
    def update(self): pass
    def create(self, search_key):
        assert self.path.endswith(".cti")
        if search_key != {"serial_number": "A7"}:
            raise ValueError("the device is not found")
        return Camera()
"""
REALSENSE = """
import itertools, numpy as np
from types import SimpleNamespace as N
stream, format, option = N(infrared="infrared"), N(y8="y8"), N(emitter_enabled="emitter")
count = itertools.count()
class config:
    def enable_device(self, serial): self.serial = serial
    def enable_stream(self, *what): self.what = what
class pipeline:
    def start(self, config):
        if config.serial != "A7":
            raise RuntimeError("No device connected")
        assert config.what == ("infrared", 1, 64, 48, "y8", 30)
        return N(get_device=lambda: N(first_depth_sensor=lambda: N(set_option=self.set)))
    def set(self, name, value): self.emitter = name, value
    def wait_for_frames(self, timeout):
        assert self.emitter == ("emitter", 0.0)
        data = np.full((48, 64), next(count) % 250, np.uint8)
        return N(get_infrared_frame=lambda index: N(get_data=lambda: data))
"""


class Robot:
    """A robot that arrives after some looks at it; its base is turned by 90 degrees about z."""

    def __init__(self):
        self.pose = [0.0, 0.0, 0.1, np.pi, 0.0, 0.0]
        self.goal, self.looks, self.held, self.connected = self.pose, 0, True, True
        self.calls, self.refuses, self.stuck = [], False, False

    def install(self, monkeypatch):
        def connected(host):
            if host != "10.0.0.9":
                raise RuntimeError(f"Could not connect to: {host} at 30004, verify the IP")
            return self

        for module, name in (
            ("rtde_control", "RTDEControlInterface"), ("rtde_receive", "RTDEReceiveInterface"),
        ):  # fmt: skip
            made = ModuleType(module)
            setattr(made, name, connected)
            monkeypatch.setitem(sys.modules, module, made)

    def moveL(self, pose, speed, acceleration, asynchronous):
        assert asynchronous
        self.calls.append(("moveL", speed))
        self.goal, self.looks = pose, 3
        return not self.refuses

    def getTargetTCPPose(self):
        self.looks -= 1
        if self.looks == 0 and not self.stuck:
            self.pose = self.goal
        return self.pose

    def getActualTCPPose(self):
        return self.pose

    def getDigitalInState(self, number):
        assert number == 3
        return self.held

    def isConnected(self):
        return self.connected

    def isEmergencyStopped(self):
        return False

    isProtectiveStopped = isEmergencyStopped

    def stopL(self, deceleration):
        self.calls.append(("stopL", deceleration))

    def stopScript(self):
        self.calls.append(("stopScript",))

    def disconnect(self):
        self.calls.append(("disconnect",))

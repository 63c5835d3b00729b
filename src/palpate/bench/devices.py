"""What a bench consists of: cameras, a source of forces, an arm; a protocol for each.

Times are those of `time.monotonic`, taken when a picture or a reading arrives: that is one clock
for all devices and processes of a machine. How long it took to arrive differs between devices;
a push is therefore measured where force and pictures have been still for longer than that.
"""

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Shaped

from palpate.errors import InputError
from palpate.shapes import Vector3

Picture = Shaped[np.ndarray, "_rows _columns"]


class DeviceError(InputError):
    """A device that is not there, is silent, or sends what cannot be used; the text says what to
    do. Measuring can go on once that is done."""


@runtime_checkable
class Camera(Protocol):
    """A camera that is recording.

    Attributes
    ----------
    name : str                      of its camera in the rig
    """

    name: str

    def start(self) -> None:
        """Begin to record; again after an interruption. `DeviceError` where it cannot."""

    def grab(self) -> tuple[Picture, float]:
        """The next picture: (rows, columns) grey levels, 255 is white, and its time [s]. No picture
        comes twice, and times increase. `DeviceError` where none comes."""

    @property
    def settings(self) -> Mapping[str, str]:
        """What a person would want to know: source, size, rate."""

    def close(self) -> None:
        """End recording; harmless where it has not begun."""


@runtime_checkable
class ForceSource(Protocol):
    """A gauge in line with the tool, or a scale under the object.

    Attributes
    ----------
    typed : bool                    a person reads it: there are no readings between pushes
    limit : float [N] or None       end of its range
    """

    typed: bool
    limit: float | None

    def start(self) -> None:
        """Begin to read; again after an interruption. `DeviceError` where it cannot."""

    def read(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """What has arrived since the last call: times [s], which do not decrease, and readings [N]
        of either sign, with the weight of the tool. `DeviceError` where it is silent."""

    def close(self) -> None:
        """End reading; harmless where it has not begun."""


@runtime_checkable
class Arm(Protocol):
    """What moves the tool."""

    def start(self) -> None:
        """Take hold of the arm. `DeviceError` where that fails."""

    def pose(self) -> Vector3:
        """Position of the tool's end [m], object frame."""

    def move(self, position: Vector3, direction: Vector3, speed: float) -> None:
        """Move the tool's end straight to a position [m] at a speed [m/s], its axis along a unit
        vector into the object; returns when it is there."""

    def stop(self) -> None:
        """Stop at once, and stay."""

    def close(self) -> None:
        """Let go of the arm; harmless where it is not held."""

"""How the guided way speaks to a person: what it asks, what it says, and what there is to see."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.progress import Progress
from palpate.records import Estimate, Rig, make_pose
from palpate.shapes import Indices, Vector3

Pictures = tuple[UInt8[np.ndarray, "_ _"], ...]
Dots = Sequence[Float[np.ndarray, "_ 2"]]
Pose = Float[np.ndarray, "4 4"]
DEVICES, CALIBRATION, OBJECT, REST, PUSHES = STEPS = (
    "Devices", "Calibration", "Object", "At rest", "Pushes"
)  # fmt: skip

# How a push stands before it begins.
AT_REST = "at rest"


def motion_about(mesh: TriangleMesh, shift: Vector3, turn: Float[np.ndarray, "3 3"]) -> Pose:
    """A motion (4, 4) [m]: a turn about the middle of a mesh, then a shift."""
    middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    return make_pose(turn, middle + shift - turn @ middle)


class Stopped(Exception):
    """The person has said that it is enough; any question, and `see`, may raise it."""


@runtime_checkable
class Questions(Protocol):
    """A person at the terminal, in the browser, or a script that answers.

    The first five ask and tell; those that show what there is to see do nothing at a terminal.
    """

    def tell(self, text: str) -> None:
        """Show a message."""

    def choose(self, text: str, options: list[str]) -> str:
        """One of some words; the first is the usual one."""

    def ask(self, text: str, usual: str) -> str:
        """A number or a word; empty: the usual one."""

    def wait(self, text: str) -> None:
        """Wait until the person has done something."""

    def working(self) -> AbstractContextManager[Progress]:
        """Show what is being done until the block ends; nothing is asked or told in it."""

    def face(
        self, mesh: TriangleMesh, faces: Mapping[str, Indices], ways: Sequence[str]
    ) -> tuple[Indices, str]:
        """Triangles that the object stands on or is held at [m], one of some faces with names, or
        as clicked; and in which of some ways."""
        if not faces:
            raise InputError(
                "the object has no flat side along an axis; say what is held as [support]"
            )
        face = self.choose("Which side does it stand on, or is it held at?", list(faces))
        return faces[face], self.choose("How does it stand there?", list(ways))

    def step(self, name: str) -> None:
        """Say which of `STEPS` begins."""
        return None

    def over(self, rig: Rig, mesh: TriangleMesh, drawing: Path) -> Pose | None:
        """Ask whether the mesh [m] lies on the object in the pictures, as the drawing shows. None:
        it does; else the rigid motion (4, 4) [m] that brings it nearer."""
        if self.choose(f"Does the outline in {drawing} lie on the object?", ["yes", "no"]) == "yes":
            return None
        text = "By how much is the outline to move along the mesh's x, y, z [mm], and to turn about"
        while True:
            words = self.ask(f"{text} them [degrees]: six numbers", "0 0 0 0 0 0").split()
            with suppress(ValueError):
                numbers = np.array([float(word) for word in words])
                if numbers.shape == (6,) and np.isfinite(numbers).all():
                    turn = Rotation.from_euler("xyz", numbers[3:], degrees=True).as_matrix()
                    return motion_about(mesh, 1e-3 * numbers[:3], turn)
            self.tell("These are not six numbers, such as 0 0 2.5 0 0 90")

    def watch(self, cameras: Sequence[str], look: Callable[[], Pictures]) -> None:
        """Say what shows the cameras' pictures while a question is open."""
        return None

    def known(self, rig: Rig) -> None:
        """Say where the cameras are, in the object's frame."""
        return None

    def see(
        self, pictures: Pictures, time: list[float], force: list[float], state: str, dots: Dots = ()
    ) -> None:
        """Show the newest pictures, with dots [px] in that of each camera, all readings [s, N] of
        the push in hand, and how it stands."""
        return None

    def body(self, mesh: TriangleMesh, held: Indices) -> None:
        """Show the object [m], and which triangles are held."""
        return None

    def place(self, point: Vector3, inward: Vector3, way: Sequence[Vector3] = ()) -> None:
        """Show where to press [m], the direction, and the way of an arm's tool there [m]."""
        return None

    def judged(self, estimate: Estimate) -> None:
        """Show the constants after a push."""
        return None

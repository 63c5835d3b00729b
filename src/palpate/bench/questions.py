"""How the guided way speaks to a person: what it asks, what it says, and what there is to see."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.progress import Progress
from palpate.records import Estimate, Rig
from palpate.shapes import Indices, Vector3

Pictures = tuple[UInt8[np.ndarray, "_ _"], ...]
DEVICES, OBJECT, REST, PUSHES = STEPS = ("Devices", "Object", "At rest", "Pushes")

# How a push stands before it begins.
AT_REST = "at rest"


class Stopped(Exception):
    """The person has said that it is enough; any question, and `see`, may raise it."""


@runtime_checkable
class Questions(Protocol):
    """A person at the terminal, in the browser, or a script that answers.

    The first five ask and tell; the others show what there is to see, which a terminal does not.
    """

    def tell(self, text: str) -> None:
        """Say something."""

    def choose(self, text: str, options: list[str]) -> str:
        """One of some words; the first is the usual one."""

    def ask(self, text: str, usual: str) -> str:
        """A number or a word; empty: the usual one."""

    def wait(self, text: str) -> None:
        """Until the person has done something."""

    def working(self) -> AbstractContextManager[Progress]:
        """Show what is being done until the block ends; nothing is asked or told in it."""

    def face(self, text: str, mesh: TriangleMesh, faces: Mapping[str, Indices]) -> Indices:
        """Triangles of a part of the surface [m]: one of some faces with names, or as clicked."""
        if not faces:
            raise InputError(
                "the object has no flat side along an axis; say what is held as [support]"
            )
        return faces[self.choose(text, list(faces))]

    def step(self, name: str) -> None:
        """Say which of `STEPS` begins."""
        return None

    def watch(self, rig: Rig, look: Callable[[], Pictures]) -> None:
        """Say what shows the cameras' pictures while a question is open."""
        return None

    def see(self, pictures: Pictures, time: list[float], force: list[float], state: str) -> None:
        """Show the newest pictures, all readings [s, N] of the push in hand, and how it stands."""
        return None

    def body(self, mesh: TriangleMesh, held: Indices) -> None:
        """Show the object [m], and which triangles are held."""
        return None

    def place(self, point: Vector3, inward: Vector3) -> None:
        """Show where to press [m], and the direction."""
        return None

    def judged(self, estimate: Estimate) -> None:
        """Show the constants after a push."""
        return None

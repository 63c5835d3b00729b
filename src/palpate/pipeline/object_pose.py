"""Where the object is in front of the cameras: believed, or registered from the first pictures."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float

from palpate.geometry import TriangleMesh
from palpate.records import Rig

__all__ = ["PoseChoice", "posed_rig"]

PoseChoice = Literal["auto", "given", "register"]


def posed_rig(
    rig: Rig,
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    mesh: TriangleMesh,
    choice: PoseChoice,
) -> tuple[Rig, tuple[str, ...]]:
    """The rig with the object's pose settled."""
    return rig, ()

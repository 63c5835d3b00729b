"""What holds the object, and how it moves."""

from dataclasses import dataclass

import numpy as np

from palpate.arrays import fixed_array
from palpate.errors import InputError
from palpate.shapes import Indices, Vector3

FIXED, GIVEN, FREE = MOTIONS = ("fixed", "given", "free")
# Turns beyond which the displacement of a rigid motion is no longer linear in it: cos differs from
# 1 by 1e-3.
_LARGEST_TURN = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """A part of the surface that is held as a whole.

    Parameters
    ----------
    triangles : (k,) int            sorted, distinct
    motion : str                    `FIXED`; `GIVEN` by every probing; or `FREE`: a rigid motion is
                                    estimated along with the constants, for every probing

    Raises
    ------
    InputError                      another motion
    """

    triangles: Indices
    motion: str = FIXED

    def __post_init__(self) -> None:
        triangles = fixed_array(self.triangles, name="triangles", shape=(None,), integer=True)
        object.__setattr__(self, "triangles", np.unique(triangles))
        if self.motion not in MOTIONS:
            raise InputError(f"motion is '{self.motion}'; must be one of {', '.join(MOTIONS)}")


@dataclass(frozen=True, slots=True, eq=False)
class RigidMotion:
    """A small rigid motion of a support.

    Parameters
    ----------
    translation : (3,) float [m]    of the middle of the support
    rotation : (3,) float [rad]     turn about the middle: axis times angle, right-handed

    Raises
    ------
    InputError                      a turn that is not small
    """

    translation: Vector3
    rotation: Vector3

    def __post_init__(self) -> None:
        for name in ("translation", "rotation"):
            value = fixed_array(getattr(self, name), name=name, shape=(3,))
            object.__setattr__(self, name, value)
        turn = float(np.linalg.norm(self.rotation))
        if turn > _LARGEST_TURN:
            raise InputError(
                f"rotation is {turn:.3g} rad; must be at most {_LARGEST_TURN} rad (3 degrees), as"
                " displacements are taken to be small; give radians, or turn the measured"
                " displacements back first"
            )

"""Supports: what is held, and how; their rigid motions."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.arrays import fix_fields, fixed_array
from palpate.errors import InputError
from palpate.shapes import Indices, Vector3

# How a support moves.
FIXED, GIVEN, FREE = MOTIONS = ("fixed", "given", "free")
# Smallest singular value of the directions over the largest, below which they are dependent.
_SAME_DIRECTION = 1e-3
# Range of foundation moduli [N/m^3]: a metre of the softest gel to a tenth of a millimetre of
# diamond.
_SOFTEST, _STIFFEST = 1.0, 1e16
# Largest rotation for which rigid displacements count as linear in it [rad]: cos is 1e-3 below 1.
_LARGEST_TURN = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """A part of the surface that is held and, if it moves, moves rigidly.

    Parameters
    ----------
    triangles : (k,) int            sorted, distinct
    motion : str                    `FIXED`; `GIVEN` for every probing; or `FREE`: a rigid motion
                                    that is estimated for every probing along with the constants
    directions : (d, 3) float or None    of a roller: only these directions are held, along the
                                    others the surface slides without friction; orthonormalised;
                                    None: all are held
    stiffness : float [N/m^3] or None    modulus of an elastic foundation, traction over
                                    displacement, 1 to 1e16; None: rigid

    Raises
    ------
    InputError                      unknown motion; a direction that is zero, or depends on others;
                                    a stiffness out of range
    """

    triangles: Indices
    motion: str = FIXED
    directions: Float[np.ndarray, "d 3"] | None = None
    stiffness: float | None = None

    def __post_init__(self) -> None:
        fix_fields(self, integer=True, triangles=(None,))
        object.__setattr__(self, "triangles", np.unique(self.triangles))
        if self.motion not in MOTIONS:
            raise InputError(f"motion is '{self.motion}'; must be one of {', '.join(MOTIONS)}")
        if self.directions is not None:
            object.__setattr__(self, "directions", _orthonormal(self.directions))
        if self.stiffness is not None and not (_SOFTEST <= self.stiffness <= _STIFFEST):
            raise InputError(
                f"stiffness is {self.stiffness:g} N/m^3; must be a traction over a displacement"
                f" from {_SOFTEST:g} to {_STIFFEST:g} N/m^3 (a foam 1 cm thick has about 5e6): for"
                " a rigid support leave it out"
            )

    @property
    def compliance(self) -> float:
        """Displacement over traction [m/Pa]; 0 if rigid."""
        return 0.0 if self.stiffness is None else 1.0 / self.stiffness

    @property
    def holding(self) -> Float[np.ndarray, "3 3"]:
        """Projector onto the span of the held directions, (3, 3)."""
        return np.eye(3) if self.directions is None else self.directions.T @ self.directions


def _orthonormal(directions: Float[np.ndarray, "d 3"]) -> Float[np.ndarray, "d 3"] | None:
    """Orthonormal basis of the same span; None if that is the whole space."""
    given = fixed_array(directions, name="directions", shape=(None, 3))
    length = np.linalg.norm(given, axis=1, keepdims=True)
    if not len(given) or not length.all():
        raise InputError(
            "directions has no direction, or one that is zero; give one or two that are held, e.g."
            " [[0, 0, 1]], or leave the key out: then all are"
        )
    _, size, found = np.linalg.svd(given / length, full_matrices=False)
    if len(given) > 3 or size[-1] < _SAME_DIRECTION:
        raise InputError(
            "directions holds one direction twice, or one that follows from the others; give each"
            " once"
        )
    return None if len(given) == 3 else fixed_array(found, name="directions", shape=(None, 3))


@dataclass(frozen=True, slots=True, eq=False)
class RigidMotion:
    """A small rigid motion of a support.

    Parameters
    ----------
    translation : (3,) float [m]    of the middle of the support
    rotation : (3,) float [rad]     rotation vector about the middle: axis times angle,
                                    right-handed, at most 0.05 rad

    Raises
    ------
    InputError                      a rotation that is not small
    """

    translation: Vector3
    rotation: Vector3

    def __post_init__(self) -> None:
        fix_fields(self, translation=(3,), rotation=(3,))
        turn = float(np.linalg.norm(self.rotation))
        if turn > _LARGEST_TURN:
            raise InputError(
                f"rotation is {turn:.3g} rad; must be at most {_LARGEST_TURN} rad (3 degrees), as"
                " displacements are taken to be small; give radians, or turn the measured"
                " displacements back first"
            )

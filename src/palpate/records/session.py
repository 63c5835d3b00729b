"""A session: one object, one support, any number of probings."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.errors import InputError
from palpate.geometry import TriangleMesh, fixed_array
from palpate.records.probing import Probing
from palpate.shapes import Indices, Vector3

__all__ = ["Session"]


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """Everything that is known before the elastic constants are; all of it in SI units.

    Parameters
    ----------
    name : str
    path : Path                     the session.toml it was read from
    mesh : TriangleMesh             closed, outward
    held_triangles : (k,) int       sorted, distinct indices of the triangles that do not move
    probings : tuple of Probing     at least one, names distinct
    density : float [kg/m^3] or None
    gravity : (3,) float [m/s^2] or None    only where it acts in the loaded state alone
    rig : Path or None              the camera file, where there are pictures
    notes : tuple of str            what was mended, converted or looks implausible, in sentences

    Raises
    ------
    InputError                      support empty or the whole surface, no or twin probings,
                                    gravity without density
    """

    name: str
    path: Path
    mesh: TriangleMesh
    held_triangles: Indices
    probings: tuple[Probing, ...]
    density: float | None
    gravity: Vector3 | None
    rig: Path | None
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        held = fixed_array(self.held_triangles, name="held_triangles", shape=(None,), integer=True)
        _check_support(held, len(self.mesh.triangles))
        held = np.unique(held)
        held.setflags(write=False)
        object.__setattr__(self, "held_triangles", held)
        names = [probing.name for probing in self.probings]
        if not names:
            raise InputError("the session has no probings; at least one is needed")
        if len(set(names)) < len(names):
            twins = sorted({name for name in names if names.count(name) > 1})
            raise InputError(f"probings share the names {twins}; names must be distinct")
        if self.density is not None and not (np.isfinite(self.density) and self.density > 0.0):
            raise InputError(f"density is {self.density}; must be positive, in kg/m^3")
        if self.gravity is not None:
            gravity = fixed_array(self.gravity, name="gravity", shape=(3,))
            object.__setattr__(self, "gravity", gravity)
            if self.density is None:
                raise InputError("gravity is given without a density; give it in kg/m^3")


def _check_support(held: Indices, triangle_count: int) -> None:
    """Refuse a support that is empty, out of range, or the whole surface."""
    if len(held) == 0:
        raise InputError(
            "the support is empty: no triangle is held, and the object would float away;"
            " choose the triangles that do not move"
        )
    if held.min() < 0 or held.max() >= triangle_count:
        raise InputError(
            f"the support names triangles {held.min()} to {held.max()}, but the mesh has"
            f" {triangle_count} (0 to {triangle_count - 1})"
        )
    if len(np.unique(held)) == triangle_count:
        raise InputError(
            f"the support is the whole surface (all {triangle_count} triangles); nothing could"
            " move: choose only the part that is held"
        )

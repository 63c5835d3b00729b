"""Misregistration of the mesh with the object on which the displacements were measured."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.estimation.nuisance.nuisance import LoadedResponse, NuisanceParameter

_POSE = "pose of the object"


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Pose of the mesh relative to the measured points: translation and rotation (`Nuisance`).

    Parameters
    ----------
    translation, rotation : float [m], [rad]    standard deviation along and about each axis; 0 =
                                                exact
    change : sparse arrays (3 n, 3 v)           one for each parameter: takes the displacement of
                                                the v vertices to its change at the n points, per
                                                standard deviation
    vertices : function                         Poisson's ratio -> (rows, c) float: response of all
                                                vertices, three rows each (`ResponseModel`)
    """

    translation: float
    rotation: float
    change: tuple[csr_array, ...]
    vertices: Callable[[float], Float[np.ndarray, "rows c"]]

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """Six, shared by all probings; three where one of the standard deviations is zero."""
        translations = (
            NuisanceParameter(f"shift of the object along {axis}", self.translation, "m", _POSE)
            for axis in "xyz"
        )
        rotations = (
            NuisanceParameter(f"turn of the object about {axis}", self.rotation, "rad", _POSE)
            for axis in "xyz"
        )
        return tuple(each for each in (*translations, *rotations) if each.std > 0.0)

    def columns(self, at: LoadedResponse) -> Float[np.ndarray, "r p"]:
        """Change in displacement as the points move within the field (`Nuisance.columns`)."""
        # Rows of a measured contact point follow those of the vertices.
        field = (self.vertices(at.poisson_ratio) @ at.load)[: self.change[0].shape[1]]
        moved = np.stack([change @ field for change in self.change], axis=1)
        # The contact point moves with the tool, not with the mesh.
        tip = np.zeros((3, len(self.change)))
        return np.concatenate([moved, tip])[at.rows]

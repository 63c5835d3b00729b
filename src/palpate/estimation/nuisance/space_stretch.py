"""Errors of the camera calibration: measured space is slightly stretched and sheared."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.nuisance.nuisance import LoadedResponse, NuisanceParameter


@dataclass(frozen=True, slots=True, eq=False)
class SpaceStretch:
    """Effect of calibration errors on measured displacements (`Nuisance`).

    Parameters
    ----------
    strains : (p, 3, 3) float [-]   symmetric strain per standard deviation of each of p independent
                                    errors
    points : int                    n; rows from 3 n on were not measured by the cameras
    """

    strains: Float[np.ndarray, "p 3 3"]
    points: int

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """One for each strain, shared by all probings; its std is the strain's Frobenius norm."""
        sizes = np.linalg.norm(self.strains, axis=(1, 2)).tolist()
        return tuple(
            NuisanceParameter(
                f"stretch {k} of space by the cameras' calibration", size, of="camera calibration"
            )
            for k, size in enumerate(sizes, start=1)
        )

    def columns(self, at: LoadedResponse) -> Float[np.ndarray, "r p"]:
        """Strains times displacement, with components that were not measured taken as zero
        (`Nuisance.columns`)."""
        displacement = np.zeros(3 * self.points + 3)
        displacement[at.rows] = at.displacement
        columns = np.einsum("pij,nj->nip", self.strains, displacement.reshape(-1, 3))
        columns[self.points :] = 0.0
        return columns.reshape(len(displacement), -1)[at.rows]

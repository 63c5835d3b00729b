"""Space as calibrated cameras see it: stretched and sheared a little where the object stands."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.estimation.nuisance.nuisance import NuisanceParameter


@dataclass(frozen=True, slots=True, eq=False)
class SpaceStretch:
    """Errors of a calibration as they show in measured displacements (`Nuisance`).

    Parameters
    ----------
    strains : (p, 3, 3) float [-]   symmetric; for one standard deviation of each of p errors that
                                    do not depend on each other
    points : int                    n: rows of the response beyond 3 n are not of the cameras
    """

    strains: Float[np.ndarray, "p 3 3"]
    points: int

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """One for each error, for all probings; its size is that of its strain."""
        sizes = np.linalg.norm(self.strains, axis=(1, 2)).tolist()
        return tuple(
            NuisanceParameter(
                f"stretch {k} of space by the cameras' calibration", size, of="camera calibration"
            )
            for k, size in enumerate(sizes, start=1)
        )

    def columns(
        self,
        rows: Int[np.ndarray, " r"],
        response: Float[np.ndarray, "r c"],
        load: Float[np.ndarray, " c"],
        poisson_ratio: float,
    ) -> Float[np.ndarray, "r p"]:
        """Each displacement stretched; a component that was not measured adds nothing to the others
        (`Nuisance.columns`)."""
        moved = np.zeros(3 * self.points + 3)
        moved[rows] = response @ load
        stretched = np.einsum("pij,nj->nip", self.strains, moved.reshape(-1, 3))
        stretched[self.points :] = 0.0
        return stretched.reshape(len(moved), -1)[rows]

"""Uncertainty of lengths measured by calibrated cameras, from the covariance of the rig."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from palpate.estimation import ProbeObservations
from palpate.pipeline.model.measurement_errors import space_stretch
from palpate.records import Session, covariance_file, read_rig, read_rig_covariance
from palpate.vision import space_strains


def calibration_strains(session: Session) -> Float[np.ndarray, "m 3 3"] | None:
    """Apparent strains of measured space at the object from errors of the camera calibration.

    Parameters
    ----------
    session : Session

    Returns
    -------
    (m, 3, 3) float [-] or None     as `space_strains`; None without a rig, or without the file of
                                    its covariance beside it

    Raises
    ------
    RecordError, CalibrationError   a rig or a covariance that cannot be read, or that do not belong
                                    together
    """
    file = None if session.rig is None else covariance_file(session.rig)
    if session.rig is None or file is None:
        return None
    return space_strains(read_rig(session.rig), read_rig_covariance(file), session.mesh.vertices)


def with_stretch(
    observations: Sequence[ProbeObservations], strains: Float[np.ndarray, "m 3 3"] | None
) -> list[ProbeObservations]:
    """Observations with calibration errors as further nuisance parameters.

    Parameters
    ----------
    observations : sequence of ProbeObservations
    strains : (m, 3, 3) float or None    of `calibration_strains`

    Returns
    -------
    list of ProbeObservations
    """
    if strains is None:
        return list(observations)
    return [
        replace(probe, nuisances=(*probe.nuisances, space_stretch(strains, len(probe.position))))
        for probe in observations
    ]


def length_error(session: Session, strains: Float[np.ndarray, "m 3 3"] | None) -> dict[str, object]:
    """Source and size of the relative error of lengths along x, y and z, for the result's settings.

    Parameters
    ----------
    session : Session
    strains : (m, 3, 3) float or None    of `calibration_strains`

    Returns
    -------
    dict                            source (text) and std (three floats)
    """
    if strains is None:
        return {"source": "[errors] length_scale", "std": [session.errors.length_scale] * 3}
    along = np.linalg.norm(np.einsum("mii->mi", strains), axis=0)
    total = np.hypot(along, session.errors.length_scale)
    return {"source": "rig_covariance.npz", "std": total.tolist()}

"""How well lengths are known that calibrated cameras measured on an object."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from palpate.estimation import ProbeObservations, SpaceStretch
from palpate.records import Session, covariance_file, read_rig, read_rig_covariance
from palpate.vision import space_strains


def calibration_strains(session: Session) -> Float[np.ndarray, "m 3 3"] | None:
    """Strains of the space about an object by the errors of its cameras' calibration.

    Parameters
    ----------
    session : Session

    Returns
    -------
    (m, 3, 3) float [-] or None     as `space_strains`; None where there is no rig, or no covariance
                                    beside it

    Raises
    ------
    RecordError, CalibrationError   a rig or a covariance that cannot be read, or are not of each
                                    other
    """
    file = None if session.rig is None else covariance_file(session.rig)
    if session.rig is None or file is None:
        return None
    return space_strains(read_rig(session.rig), read_rig_covariance(file), session.mesh.vertices)


def with_stretch(
    observations: Sequence[ProbeObservations], strains: Float[np.ndarray, "m 3 3"] | None
) -> list[ProbeObservations]:
    """What was seen, with what the calibration of the cameras leaves open.

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
        replace(one, nuisances=(*one.nuisances, SpaceStretch(strains, len(one.position))))
        for one in observations
    ]


def known_lengths(
    session: Session, strains: Float[np.ndarray, "m 3 3"] | None
) -> dict[str, object]:
    """Where the error of lengths comes from, and how large it is along x, y and z.

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

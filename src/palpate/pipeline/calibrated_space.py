"""How well lengths are known that calibrated cameras measured on an object."""

import numpy as np
from jaxtyping import Float

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

"""Covariance of a rig: `rig_covariance.npz` in the same folder as `rig.toml`."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from palpate.files import stored_arrays
from palpate.records.rig import RigCovariance

COVARIANCE_FORMAT = "palpate-rig-covariance/1"
_FILE = "rig_covariance.npz"
# Largest size [bytes]: the covariance of three thousand parameters; four cameras have eighty.
_MAX_BYTES = 2**26
_CURE = "calibrate again, or remove it: then lengths are known as [errors] says"


def covariance_file(rig: Path) -> Path | None:
    """File with the covariance of a rig, in the same folder as the rig.

    Parameters
    ----------
    rig : Path                      the rig's file, or its folder

    Returns
    -------
    Path or None                    None if there is none; the file is not checked
    """
    path = (rig if rig.is_dir() else rig.parent) / _FILE
    return path if os.path.lexists(path) else None


def write_rig_covariance(
    folder: Path, known: RigCovariance, corner_noise: Float[np.ndarray, " c"] | None = None
) -> None:
    """Write `rig_covariance.npz`.

    Parameters
    ----------
    folder : Path                   an existing folder
    known : RigCovariance
    corner_noise : (c,) float [px] or None  standard deviation of a corner coordinate, per camera
    """
    content: dict[str, Any] = {
        "format": np.array(COVARIANCE_FORMAT),
        "names": np.array(known.names),
        "value": known.value,
        "covariance": known.covariance,
    }
    if corner_noise is not None:
        content["corner_noise"] = corner_noise
    np.savez_compressed(folder / _FILE, **content)


def read_rig_covariance(path: Path) -> RigCovariance:
    """Read a `rig_covariance.npz`.

    Parameters
    ----------
    path : Path

    Returns
    -------
    RigCovariance

    Raises
    ------
    RecordError                     missing, not readable, damaged, too large, of another format
    CalibrationError                as in `RigCovariance`
    """
    what = "cannot be read as the covariance of a rig"
    with stored_arrays(path, _CURE, what=what, max_bytes=_MAX_BYTES) as stored:
        file_format = str(stored["format"])
        if file_format != COVARIANCE_FORMAT:
            raise ValueError(f"its format is {file_format!r}, not '{COVARIANCE_FORMAT}'")
        names = tuple(map(str, stored["names"].tolist()))
        return RigCovariance(names, stored["value"], stored["covariance"], str(path))

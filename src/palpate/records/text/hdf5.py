"""HDF5 files: MATLAB files from version 7.3 on, and DICe's Exodus files."""

from pathlib import Path
from typing import Any

from palpate.optional_imports import late_import


def open_hdf5(path: Path) -> Any:
    """Open an HDF5 file for reading.

    Parameters
    ----------
    path : Path

    Returns
    -------
    h5py.File                       to be closed: `with open_hdf5(path) as file`

    Raises
    ------
    InputError                      h5py is not installed
    OSError                         not an HDF5 file
    """
    return late_import("h5py", extra="hdf5", purpose=f"reading {path.name}").File(path)

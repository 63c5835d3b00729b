"""HDF5 files: what MATLAB saves from version 7.3 on, and DICe as Exodus."""

from pathlib import Path
from typing import Any

from palpate.optional_imports import late_import


def open_hdf5(path: Path) -> Any:
    """Open a file of groups, which are mappings, and arrays.

    Parameters
    ----------
    path : Path

    Returns
    -------
    h5py.File                       to be closed: `with open_hdf5(path) as file`

    Raises
    ------
    InputError                      h5py is not installed
    OSError                         no file of this kind
    """
    return late_import("h5py", extra="hdf5", purpose=f"reading {path.name}").File(path)

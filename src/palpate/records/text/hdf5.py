"""HDF5 files: MATLAB files from version 7.3 on, and DICe's Exodus files."""

import math
from pathlib import Path
from typing import Any

from palpate.files import max_unpacked_size
from palpate.optional_imports import late_import

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


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


def checked_size(array: Any) -> Any:
    """Return a data set that is not yet loaded, after checking its size, which a header may forge.

    Parameters
    ----------
    array : h5py.Dataset

    Raises
    ------
    ValueError                      more numbers than any measurement has
    """
    if math.prod(array.shape) * array.dtype.itemsize > max_unpacked_size(
        array.id.get_storage_size()
    ):
        raise ValueError(f"it claims an array of {' x '.join(map(str, array.shape))} numbers")
    return array

"""Pose of another program's frame in the object frame, from a small TOML file."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from palpate.arrays import fixed_array
from palpate.errors import InputError, quoted
from palpate.records.program import nearest_rotation
from palpate.records.text.toml_table import TomlTable, read_toml
from palpate.records.text.units import LENGTH_UNITS

# A rotation typed with four digits is this far from orthogonal; a larger error is a mistake.
_MAX_TYPED_ERROR = 1e-3
_MAX_ROUNDING_ERROR = 1e-9
_EXAMPLE = 'length_unit = "mm", R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], t = [0, 0, 0]'


def read_import_pose(path: Path | str) -> tuple[Float[np.ndarray, "4 4"], tuple[str, ...]]:
    """Rigid motion that maps the points of a file to the object frame.

    The file has `length_unit` (of t), and either `R` (3 x 3, rows) and `t`, with
    x_object = R x_file + t, or `T`, the same as one 4 x 4 matrix.

    Parameters
    ----------
    path : path                     a TOML file

    Returns
    -------
    T_object_file : (4, 4) float    translation in metres
    notes : tuple of str            that R was made orthogonal, if so

    Raises
    ------
    RecordError                     missing file, not TOML, a missing or unknown key, R not a
                                    rotation
    """
    table = read_toml(Path(path))
    table.check_keys(("length_unit", "R", "t", "T"))
    unit = LENGTH_UNITS[table.choice("length_unit", tuple(LENGTH_UNITS))]
    if ("T" in table.values) == ("R" in table.values or "t" in table.values):
        table.fail("", f"must have either R and t, or T; for example: {_EXAMPLE}")
    if "T" in table.values:
        pose = _matrix(table, "T", 4).copy()
        if not np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0]):
            table.fail("T", f"has the last row {pose[3].tolist()}; must be [0, 0, 0, 1]")
    else:
        pose = np.eye(4)
        pose[:3, :3] = _matrix(table, "R", 3)
        pose[:3, 3] = table.vector("t")
    rotation, error = _rotation(table, pose[:3, :3])
    pose[:3, :3] = rotation
    pose[:3, 3] *= unit
    if error < _MAX_ROUNDING_ERROR:
        return pose, ()
    return pose, (
        f"{path}: R was made orthogonal; it was {error:.1g} off (typed with few digits?).",
    )


def _matrix(table: TomlTable, key: str, size: int) -> np.ndarray:
    """A square matrix of finite numbers."""
    value = table.get(key)
    try:
        return fixed_array(value, name=key, shape=(size, size))
    except InputError:
        table.fail(key, f"is {quoted(value)}; must be {size} rows of {size} finite numbers")


def _rotation(table: TomlTable, given: np.ndarray) -> tuple[np.ndarray, float]:
    """The rotation nearest to an almost orthogonal matrix, and the error of that matrix."""
    error = float(np.abs(given @ given.T - np.eye(3)).max())
    determinant = float(np.linalg.det(given))
    if error > _MAX_TYPED_ERROR:
        table.fail(
            "R", f"is no rotation: R R^T is {error:.2g} off the identity; check its rows and digits"
        )
    if determinant < 0.0:
        table.fail(
            "R",
            "is a mirror image (determinant -1); both frames are right-handed: swap two axes, or"
            " the sign of one",
        )
    return nearest_rotation(given), error

"""Tables of pokes: position and force of a tool, one row a sample, in text, MATLAB's or NumPy's
files."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from palpate.arrays import LARGEST_NUMBER, fix_fields
from palpate.errors import RecordError, quoted
from palpate.files import stored_arrays
from palpate.records.program import checked_size
from palpate.records.programs.matlab import of_mat, open_mat
from palpate.records.quantities import FORCE_UNITS, LENGTH_UNITS
from palpate.records.text.csv_table import read_text_table
from palpate.shapes import Points

_CURE = (
    "give a table with a header and one row a sample: position (x, y, z), force, if the surface is"
    " not level its outward normal (nx, ny, nz), and the number of the poke"
)
# Names taken for columns that are not named, in lower case; of several, the first that is there.
_POSITION, _NORMAL = (("x", "y", "z"), ("position",)), (("nx", "ny", "nz"), ("normal",))
_FORCE = (("force",), ("f",), ("fz",), ("fx", "fy", "fz"))
_POKE = (("poke",), ("id",))


@dataclass(frozen=True, slots=True, eq=False)
class PokeTable:
    """Samples of a tool that pokes a surface.

    Attributes
    ----------
    position : (n, 3) float [m]     of the tool's end
    force : (n, k) float [N]        along the push, either sign (k = 1), or a vector (k = 3)
    normal : (n, 3) float [-]       outward normal of the surface
    poke : (n,) int or None         number of the poke; None: not given
    without_number : int            rows that were left out, since a number was missing
    """

    position: Points
    force: Float[np.ndarray, "n k"]
    normal: Points
    poke: Int[np.ndarray, " n"] | None
    without_number: int

    def __post_init__(self) -> None:
        fix_fields(self, position=(None, 3), normal=(len(self.position), 3))
        fix_fields(self, force=(len(self.position), None))


def read_poke_table(
    path: Path,
    *,
    position: Sequence[str] = (),
    force: Sequence[str] = (),
    normal: Sequence[str] = (),
    poke: str | None = None,
    length_unit: str = "mm",
    force_unit: str = "N",
) -> PokeTable:
    """Read a table of pokes.

    Parameters
    ----------
    path : Path                     text with a header, .npz, or .mat of version 5 to 7.3
    position : sequence of str      names of three columns, or of one array of vectors; default:
                                    x, y, z or position
    force : sequence of str         of one or three columns, or of one array; default: force, f, fz,
                                    or fx, fy, fz
    normal : sequence of str        default: nx, ny, nz or normal; +z where there are none
    poke : str or None              default: poke or id, if there is one
    length_unit, force_unit : str   of columns whose heading, as in "x [mm]", names no unit

    Returns
    -------
    PokeTable                       rows with a number that is missing are left out, and counted

    Raises
    ------
    RecordError                     not such a file; a column that is missing; an unknown unit
    """
    table = _Columns(path, *_columns(path))
    at = table.values("position", position, _POSITION, (3,))
    pushed = table.values("force", force, _FORCE, (1, 3))
    outward, number = np.tile([0.0, 0.0, 1.0], (len(at), 1)), np.zeros((len(at), 0))
    if normal or table.names((), _NORMAL):
        outward = table.values("normal", normal, _NORMAL, (3,))
    if poke or table.names((), _POKE):
        number = table.values("poke", (poke,) if poke else (), _POKE, (1,))
    at = at * table.factor("position", position, _POSITION, LENGTH_UNITS, length_unit)
    pushed = pushed * table.factor("force", force, _FORCE, FORCE_UNITS, force_unit)
    whole = np.isfinite(np.hstack([at, pushed, outward, number])).all(axis=1)
    if not whole.any():
        raise RecordError(f"{path}: not one of its {len(whole)} rows has all its numbers; {_CURE}")
    length = np.linalg.norm(outward[whole], axis=1, keepdims=True)
    if not length.all():
        raise RecordError(f"{path}: a normal is the zero vector; it must point out of the surface")
    return PokeTable(
        at[whole],
        pushed[whole],
        outward[whole] / length,
        np.unique(number[whole, 0], return_inverse=True)[1] if number.size else None,
        int((~whole).sum()),
    )


@dataclass(frozen=True, slots=True)
class _Columns:
    """Named columns of a file, with the units of those that have one."""

    path: Path
    columns: dict[str, np.ndarray]
    units: dict[str, str]

    def names(self, given: Sequence[str], usual: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
        """The columns meant, as the file spells them; empty where none are given nor there."""
        spelling = {name.lower(): name for name in reversed(self.columns)}
        for words in [tuple(given)] if given else usual:
            if all(word.lower() in spelling for word in words):
                return tuple(spelling[word.lower()] for word in words)
        return ()

    def values(
        self,
        what: str,
        given: Sequence[str],
        usual: Sequence[tuple[str, ...]],
        widths: tuple[int, ...],
    ) -> np.ndarray:
        names = self.names(given, usual)
        if not names:
            wanted = " or ".join(", ".join(words) for words in ([given] if given else usual))
            raise RecordError(
                f"{self.path}: has no column of the {what}: looked for {wanted}; it has:"
                f" {', '.join(list(self.columns)[:12])}. Name it with --{what}-column"
                f"{'' if what == 'poke' else 's'}"
            )
        rows = {len(self.columns[name]) for name in names}
        if len(rows) > 1:
            raise RecordError(f"{self.path}: {', '.join(names)} have different numbers of rows")
        values = np.hstack([self.columns[name] for name in names])
        if values.shape[1] not in widths:
            raise RecordError(
                f"{self.path}: the {what} has {values.shape[1]} components ({', '.join(names)});"
                f" must have {' or '.join(map(str, widths))}"
            )
        first = next(iter(self.columns.values()))
        if len(values) != len(first):
            raise RecordError(f"{self.path}: {names[0]} has {len(values)} rows, not {len(first)}")
        return values

    def factor(
        self,
        what: str,
        given: Sequence[str],
        usual: Sequence[tuple[str, ...]],
        known: dict[str, float],
        default: str,
    ) -> float:
        """Value of the columns' unit in SI units."""
        units = {self.units.get(name, default) for name in self.names(given, usual)}
        if len(units) > 1 or not units <= set(known):
            raise RecordError(
                f"{self.path}: the {what} is in {', '.join(sorted(map(quoted, units)))}; must be in"
                f" one of {', '.join(known)}"
            )
        return known[units.pop()]


def _mat_columns(path: Path) -> dict[str, np.ndarray]:
    """Arrays of numbers in a MATLAB file."""
    with open_mat(path) as content:
        # A data set of version 7.3 is transposed.
        return {
            name: value.astype(float)
            if isinstance(value, np.ndarray)
            else np.asarray(checked_size(value), dtype=float).T
            for name, value in content.items()
            if getattr(value, "dtype", np.dtype(object)).kind in "fiu"
        }


def _columns(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Columns of a file, (n, k) each, and their units."""
    suffix, units = path.suffix.lower(), dict[str, str]()
    if suffix == ".npz":
        with stored_arrays(path, _CURE) as arrays:
            columns = {
                name: value.astype(float)
                for name, value in arrays.items()
                if value.dtype.kind in "fiu"
            }
    elif suffix == ".mat":
        columns = of_mat(_mat_columns, path)
    else:
        table = read_text_table(path, cure=_CURE)
        values = table.values(table.columns)
        columns = {
            column.name: values[:, column.index]
            for column in table.columns
            # What is there twice is refused: nobody knows which is meant.
            if table.find((column.name,), normalise=str)
        }
        units = {column.name: column.unit for column in table.columns if column.unit}
    wide = {
        name: value.reshape(len(value), math.prod(value.shape[1:]))
        for name, value in columns.items()
        if value.ndim
    }
    if not wide:
        raise RecordError(f"{path}: holds no columns of numbers; {_CURE}")
    for name, value in wide.items():
        if (np.abs(value[np.isfinite(value)]) > LARGEST_NUMBER).any():
            raise RecordError(f"{path}: {name} holds a number beyond {LARGEST_NUMBER:g}")
    return wide, units

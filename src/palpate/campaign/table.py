"""A campaign's table as a CSV or Parquet file."""

import io
from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path

from palpate.campaign.rows import COLUMNS, Row, outliers
from palpate.disk import write_bytes
from palpate.errors import InputError
from palpate.optional_imports import late_import
from palpate.records import spreadsheet_text

_OUTLIER = "outlier"


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Write a table, whose last column names the constants that make a session an outlier.

    Parameters
    ----------
    path : Path                     with suffix .csv or .parquet; an existing file is replaced
    rows : sequence of Row

    Raises
    ------
    InputError                      another suffix; the package for Parquet is not installed
    RecordError                     the file cannot be written
    """
    if path.suffix == ".csv":
        write_bytes(path, table_text(rows).encode())
    elif path.suffix == ".parquet":
        write_bytes(path, _parquet(rows))
    else:
        raise InputError(f"{path}: ends in '{path.suffix}'; a table is a .csv or a .parquet file")


def table_text(rows: Sequence[Row]) -> str:
    """A table as CSV text; unknown values are empty.

    Parameters
    ----------
    rows : sequence of Row

    Returns
    -------
    str
    """
    outlying = outliers(rows)
    cells = ((*astuple(row), " ".join(outlying.get(row.session, ()))) for row in rows)
    return spreadsheet_text([(*COLUMNS, _OUTLIER), *cells])


def _parquet(rows: Sequence[Row]) -> bytes:
    arrow = late_import("pyarrow", extra="parquet", purpose="a table in Parquet")
    parquet = late_import("pyarrow.parquet", extra="parquet", purpose="a table in Parquet")
    outlying = outliers(rows)
    columns = {name: [getattr(row, name) for row in rows] for name in COLUMNS}
    columns[_OUTLIER] = [" ".join(outlying.get(row.session, ())) for row in rows]
    content = io.BytesIO()
    parquet.write_table(arrow.table(columns), content)
    return content.getvalue()

"""A campaign's table as a file: CSV, or Parquet."""

import csv
import io
from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path

from palpate.campaign.rows import COLUMNS, Row, outliers
from palpate.disk import write_bytes
from palpate.errors import InputError
from palpate.optional_imports import late_import

_OUTLIER = "outlier"


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Write a table, with the constants that make a session an outlier in its last column.

    Parameters
    ----------
    path : Path                     ending .csv or .parquet; a file of that name is replaced
    rows : sequence of Row

    Raises
    ------
    InputError                      another ending; Parquet's package is not installed
    RecordError                     the file cannot be written
    """
    if path.suffix == ".csv":
        write_bytes(path, table_text(rows).encode())
    elif path.suffix == ".parquet":
        write_bytes(path, _parquet(rows))
    else:
        raise InputError(f"{path}: ends in '{path.suffix}'; a table is a .csv or a .parquet file")


def table_text(rows: Sequence[Row]) -> str:
    """A table as CSV; empty cells where nothing is known.

    Parameters
    ----------
    rows : sequence of Row
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*COLUMNS, _OUTLIER))
    far = outliers(rows)
    writer.writerows((*astuple(row), " ".join(far.get(row.session, ()))) for row in rows)
    return text.getvalue()


def _parquet(rows: Sequence[Row]) -> bytes:
    arrow = late_import("pyarrow", extra="parquet", purpose="a table in Parquet")
    parquet = late_import("pyarrow.parquet", extra="parquet", purpose="a table in Parquet")
    far = outliers(rows)
    columns = {name: [getattr(row, name) for row in rows] for name in COLUMNS}
    columns[_OUTLIER] = [" ".join(far.get(row.session, ())) for row in rows]
    content = io.BytesIO()
    parquet.write_table(arrow.table(columns), content)
    return content.getvalue()

"""A campaign's folder: a table in SQLite, and every result under the digest of what it rests on."""

import os
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import astuple, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from palpate.campaign.items import CampaignItem
from palpate.campaign.package import Package, check_package
from palpate.campaign.rows import COLUMNS, Row, constants_of
from palpate.campaign.work import ESTIMATE_FILE, Outcome, Work
from palpate.disk import write_bytes
from palpate.errors import RecordError
from palpate.files import read_bytes
from palpate.pipeline import MOTION_FILE
from palpate.records import (
    INPUTS_FILE,
    disk_errors,
    folder_changes,
    read_estimate,
    result_folder,
    sums_text,
    write_text,
)

TABLE_FILE, TABLE_TEXT = "campaign.sqlite", "table.csv"
_RESULTS, _MOTIONS = "results", "motions"
# Digits of an address that name a file: more than anyone will ever meet two alike in.
_DIGITS = 32
# Another process may be reading the table [s].
_PATIENCE = 30.0
_KINDS = {"seconds": "REAL", **dict.fromkeys((n for n in COLUMNS if "modulus" in n), "REAL")} | {
    name: "REAL" for name in COLUMNS if "poisson" in name
}


class Store:
    """What a campaign has found so far.

    Parameters
    ----------
    folder : Path                   of the campaign; made with its parts by `begin`

    Attributes
    ----------
    folder : Path
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def may_begin(self) -> bool:
        """Whether the folder is a campaign's, is not there, or has nothing in it."""
        if not self.folder.is_dir():
            return not self.folder.exists()
        names = {path.name for path in self.folder.iterdir()}
        # What an interrupted beginning left does not count.
        own = {name for name in names if name.startswith(f".{TABLE_TEXT}")}
        return names == own or not names.isdisjoint({TABLE_FILE, _RESULTS})

    def begin(self, items: Sequence[CampaignItem]) -> None:
        """Have a row for every session of a list; what is known of them stays.

        Parameters
        ----------
        items : sequence of CampaignItem

        Raises
        ------
        RecordError                 the folder or the table cannot be written
        """
        with disk_errors(self.folder):
            for name in (_RESULTS, _MOTIONS):
                (self.folder / name).mkdir(parents=True, exist_ok=True)
        columns = ", ".join(f'"{name}" {_KINDS.get(name, "TEXT")}' for name in COLUMNS)
        with self._table() as table:
            table.execute(
                f"CREATE TABLE IF NOT EXISTS sessions (place INTEGER, {columns}, UNIQUE (session))"
            )
            known = {row.session: row for row in _rows(table)}
            table.execute("DELETE FROM sessions")
            for place, item in enumerate(items):
                row = known.get(item.name, Row(item.name, item.group))
                _put(table, place, replace(row, group=item.group))

    def rows(self) -> tuple[Row, ...]:
        """The table.

        Raises
        ------
        RecordError                 there is none, or it cannot be read
        """
        if not (self.folder / TABLE_FILE).is_file():
            raise RecordError(
                f"{self.folder}: holds no {TABLE_FILE}; give the folder that `palpate campaign`"
                " wrote"
            )
        with self._table() as table:
            return tuple(_rows(table))

    def set_row(self, row: Row) -> None:
        """Put a row in place of the one of the same session.

        Parameters
        ----------
        row : Row

        Raises
        ------
        RecordError                 the table cannot be written
        """
        with self._table() as table:
            (place,) = table.execute(
                "SELECT place FROM sessions WHERE session = ?", (row.session,)
            ).fetchone()
            table.execute("DELETE FROM sessions WHERE session = ?", (row.session,))
            _put(table, place, row)

    def result(self, work: Work) -> Path:
        """Folder of a fit's result, there or not.

        Parameters
        ----------
        work : Work
        """
        return self.folder / _RESULTS / work.address[:_DIGITS]

    def is_done(self, work: Work) -> bool:
        """Whether a fit's result is there as it was written.

        Parameters
        ----------
        work : Work
        """
        folder = self.result(work)
        return folder.is_dir() and folder_changes(folder)[:2] == ("fit", {})

    def motion(self, work: Work) -> bytes | None:
        """The motion that was measured in a session's pictures; None where it is still to be.

        Parameters
        ----------
        work : Work
        """
        path = self._motion_file(work)
        return read_bytes(path) if path.is_file() else None

    def keep(self, work: Work, package: Package) -> None:
        """Keep what a piece of work gave.

        Parameters
        ----------
        work : Work
        package : Package

        Raises
        ------
        RecordError                 damaged on its way, or the disk takes no more
        """
        check_package(package)
        if work.kind == "motion":
            write_bytes(self._motion_file(work), package.files[MOTION_FILE])
            return
        with result_folder(self.result(work), kind="fit", force=True) as folder:
            for name, content in package.files.items():
                (folder / name).parent.mkdir(exist_ok=True)
                (folder / name).write_bytes(content)
            # As they were when they were packed, whatever has become of them since.
            here = {
                Path(os.path.relpath(Path(work.session.root) / name, folder)).as_posix(): value
                for name, value in work.session.package.sums.items()
            }
            write_text(folder / INPUTS_FILE, sums_text(here))

    def row_of(self, item: CampaignItem, work: Work | None, outcome: Outcome | None) -> Row:
        """The row of a session whose fit has ended.

        Parameters
        ----------
        item : CampaignItem
        work : Work or None         None: it could not begin
        outcome : Outcome or None   None: an earlier run ended it
        """
        finished = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        head = Row(item.name, item.group, finished=finished)
        if outcome is not None:
            head = replace(head, seconds=outcome.seconds)
        if work is not None:
            head = replace(head, address=work.address)
        if work is None or (outcome is not None and outcome.failure):
            return replace(head, state="failed", message=outcome.failure if outcome else "")
        folder = self.result(work)
        estimate = read_estimate(folder / ESTIMATE_FILE)
        constants: dict[str, Any] = constants_of(estimate)
        notes = " ".join(estimate.notes)
        return replace(head, state="done", status=estimate.status.value, message=notes, **constants)

    def _motion_file(self, work: Work) -> Path:
        return self.folder / _MOTIONS / f"{work.address[:_DIGITS]}.npz"

    @contextmanager
    def _table(self) -> Iterator[sqlite3.Connection]:
        """The table, for one change that is made whole or not at all."""
        path = self.folder / TABLE_FILE
        try:
            with closing(sqlite3.connect(path, timeout=_PATIENCE)) as table:
                # A crash of the whole machine may cost the table, which the results make again; to
                # wait for the disk after every row would cost more time than the rest of it.
                table.execute("PRAGMA synchronous = OFF")
                with table:
                    yield table
        except sqlite3.Error as error:
            raise RecordError(
                f"{path}: cannot be read or written ({error}); what is there stays: make room and"
                " start again, or remove the file, which is made anew from the results"
            ) from error


def _rows(table: sqlite3.Connection) -> Iterable[Row]:
    names = ", ".join(f'"{name}"' for name in COLUMNS)
    return [Row(*cells) for cells in table.execute(f"SELECT {names} FROM sessions ORDER BY place")]


def _put(table: sqlite3.Connection, place: int, row: Row) -> None:
    cells = (place, *astuple(row))
    table.execute(f"INSERT INTO sessions VALUES ({', '.join('?' * len(cells))})", cells)

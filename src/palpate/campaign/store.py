"""A campaign's sessions and its folder: a table in SQLite, results under the digest of inputs."""

import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import astuple, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from palpate.campaign.rows import COLUMNS, WAITING, Row, constants_of
from palpate.campaign.work import (
    ESTIMATE_FILE,
    Outcome,
    Work,
    real_session_file,
)
from palpate.disk import created_folder, write_bytes
from palpate.errors import InputError, PalpateError, RecordError, quoted
from palpate.files import read_bytes
from palpate.records import (
    INPUTS_FILE,
    folder_changes,
    read_estimate,
    read_text,
    result_folder,
    sums_text,
    write_text,
)

TABLE_FILE, TABLE_TEXT = "campaign.sqlite", "table.csv"
_RESULTS, _MOTIONS = "results", "motions"
# Digits of an address that are used in file names; collisions are practically impossible.
_DIGEST_DIGITS = 32
# Timeout while another process is reading the table [s].
_TIMEOUT = 30.0
_COLUMN_TYPES = {
    "seconds": "REAL",
    **dict.fromkeys((n for n in COLUMNS if "modulus" in n), "REAL"),
} | {name: "REAL" for name in COLUMNS if "poisson" in name}
_SESSION_FILE = "session.toml"


@dataclass(frozen=True, slots=True)
class CampaignItem:
    """One session of a campaign.

    Attributes
    ----------
    name : str                      its path as written in the list, or relative to the folder
    group : str                     group in which outliers are sought; empty: no group
    path : Path                     folder of the session, or a session file
    """

    name: str
    group: str
    path: Path


class Store:
    """Table and results of a campaign so far.

    Parameters
    ----------
    folder : Path                   of the campaign; created by `begin`

    Attributes
    ----------
    folder : Path
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def may_begin(self) -> bool:
        """Whether the folder is a campaign's, missing, or empty."""
        if not self.folder.is_dir():
            return not self.folder.exists()
        names = {path.name for path in self.folder.iterdir()}
        # Ignore temporary files of a run that was interrupted at its beginning.
        temporary = {name for name in names if name.startswith(f".{TABLE_TEXT}")}
        return names == temporary or not names.isdisjoint({TABLE_FILE, _RESULTS})

    def begin(self, items: Sequence[CampaignItem]) -> None:
        """Create folder and table with a row for every session of a list; known rows are kept.

        Parameters
        ----------
        items : sequence of CampaignItem

        Raises
        ------
        RecordError                 the folder or the table cannot be written
        """
        columns = ", ".join(f'"{name}" {_COLUMN_TYPES.get(name, "TEXT")}' for name in COLUMNS)
        with (
            created_folder(self.folder / _RESULTS),
            created_folder(self.folder / _MOTIONS),
            self._table() as table,
        ):
            table.execute(
                f"CREATE TABLE IF NOT EXISTS sessions (place INTEGER, {columns}, UNIQUE (session))"
            )
            known = {row.session: row for row in _rows(table)}
            table.execute("DELETE FROM sessions")
            for position, item in enumerate(items):
                row = known.get(item.name, Row(item.name, item.group))
                _insert(table, position, replace(row, group=item.group))

    def clear(self) -> None:
        """Remove what `begin` made, where nothing has come of it: the folder may go, too."""
        folders = [self.folder / name for name in (_RESULTS, _MOTIONS)]
        with suppress(OSError, RecordError):
            if {row.state for row in self.rows()} == {WAITING}:
                for folder in folders:
                    folder.rmdir()
                (self.folder / TABLE_FILE).unlink()

    def rows(self) -> tuple[Row, ...]:
        """All rows, in the order of the list.

        Raises
        ------
        RecordError                 there is no table, or it cannot be read
        """
        if not (self.folder / TABLE_FILE).is_file():
            raise RecordError(
                f"{self.folder}: holds no {TABLE_FILE}; give the folder that `palpate campaign`"
                " wrote"
            )
        with self._table() as table:
            return tuple(_rows(table))

    def set_row(self, row: Row) -> None:
        """Replace the row of a session.

        Parameters
        ----------
        row : Row

        Raises
        ------
        RecordError                 the table cannot be written
        """
        with self._table() as table:
            (position,) = table.execute(
                "SELECT place FROM sessions WHERE session = ?", (row.session,)
            ).fetchone()
            table.execute("DELETE FROM sessions WHERE session = ?", (row.session,))
            _insert(table, position, row)

    def result(self, work: Work) -> Path:
        """Folder of a fit's result, whether it exists or not.

        Parameters
        ----------
        work : Work
        """
        return self.result_at(work.digest)

    def result_at(self, address: str) -> Path:
        """Folder of the result with an address, whether it exists or not.

        Parameters
        ----------
        address : str               as in `Row`, of a session that is done
        """
        return self.folder / _RESULTS / address[:_DIGEST_DIGITS]

    def is_done(self, work: Work) -> bool:
        """Whether a fit's result exists and is unchanged.

        Parameters
        ----------
        work : Work

        Returns
        -------
        bool

        Raises
        ------
        RecordError                 the checksums of the result cannot be read
        """
        folder = self.result(work)
        return folder.is_dir() and folder_changes(folder)[:2] == ("fit", {})

    def motion(self, key: str) -> bytes | None:
        """The stored motion of a probing; None if it is not measured yet.

        Parameters
        ----------
        key : str                   as in `Work.keys`
        """
        path = self._motion_file(key)
        return read_bytes(path) if path.is_file() else None

    def save_motion(self, key: str, motion: bytes) -> None:
        """Store the motion of a probing.

        Parameters
        ----------
        key : str                   as in `Work.keys`
        motion : bytes

        Raises
        ------
        RecordError                 it cannot be written
        """
        write_bytes(self._motion_file(key), motion)

    def save_result(self, work: Work, files: Mapping[str, bytes]) -> None:
        """Store the result of a fit.

        Parameters
        ----------
        work : Work
        files : mapping             as in `Outcome`

        Raises
        ------
        RecordError                 it cannot be written
        """
        with result_folder(self.result(work), kind="fit", force=True) as folder:
            for name, content in files.items():
                (folder / name).parent.mkdir(exist_ok=True)
                (folder / name).write_bytes(content)
            # Checksums of the inputs when they were packed, even if they have changed since.
            relative_sums = {
                Path(os.path.relpath(Path(work.session.root) / name, folder)).as_posix(): value
                for name, value in work.session.sums.items()
            }
            write_text(folder / INPUTS_FILE, sums_text(relative_sums))

    def row_of(
        self, item: CampaignItem, work: Work | None, outcome: Outcome | PalpateError | None
    ) -> Row:
        """The row of a session whose fit has ended.

        Parameters
        ----------
        item : CampaignItem
        work : Work or None         None: the session could not be read
        outcome : Outcome, error or None      None: an earlier run completed it

        Returns
        -------
        Row

        Raises
        ------
        RecordError                 the estimate of the fit cannot be read
        """
        row = Row(
            item.name, item.group, address=work.digest if work else "",
            seconds=outcome.seconds if isinstance(outcome, Outcome) else None,
            finished=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        )  # fmt: skip
        if work is None or isinstance(outcome, PalpateError):
            return replace(row, state="failed", message=str(outcome))
        estimate = read_estimate(self.result(work) / ESTIMATE_FILE)
        constants: dict[str, Any] = constants_of(estimate)
        notes = " ".join(estimate.notes)
        return replace(row, state="done", status=estimate.status.value, message=notes, **constants)

    def _motion_file(self, key: str) -> Path:
        return self.folder / _MOTIONS / f"{key[:_DIGEST_DIGITS]}.npz"

    @contextmanager
    def _table(self) -> Iterator[sqlite3.Connection]:
        """Connection to the table, with one transaction."""
        path = self.folder / TABLE_FILE
        new = not path.exists()
        try:
            with closing(sqlite3.connect(path, timeout=_TIMEOUT)) as table:
                # A crash of the machine may destroy the table, which can be rebuilt from the
                # results; flushing after every row would take more time than all the rest.
                table.execute("PRAGMA synchronous = OFF")
                with table:
                    yield table
        # Messages about a damaged file may quote what is no UTF-8.
        except (sqlite3.Error, UnicodeDecodeError) as error:
            if new:
                path.unlink(missing_ok=True)
            raise RecordError(
                f"{path}: cannot be read or written ({error}); what is there stays: make room and"
                " start again, or remove the file, which is made anew from the results"
            ) from error


def _rows(table: sqlite3.Connection) -> Iterable[Row]:
    names = ", ".join(f'"{name}"' for name in COLUMNS)
    return [Row(*cells) for cells in table.execute(f"SELECT {names} FROM sessions ORDER BY place")]


def _insert(table: sqlite3.Connection, position: int, row: Row) -> None:
    cells = (position, *astuple(row))
    table.execute(f"INSERT INTO sessions VALUES ({', '.join('?' * len(cells))})", cells)


def read_items(source: Path) -> tuple[CampaignItem, ...]:
    """The sessions named in a list, or found in a folder tree.

    A line of a list is a path, relative to the list's folder, optionally followed by a comma and a
    group; `#` starts a comment. In a folder tree the group is the topmost folder above the session,
    if the session lies two or more levels deep.

    Parameters
    ----------
    source : Path                   text file, or folder

    Returns
    -------
    tuple of CampaignItem           in the order of the list; in a folder sorted by path

    Raises
    ------
    RecordError                     missing, without sessions, an invalid path
    InputError                      a session that occurs twice in the list
    """
    items = tuple(_in_folder(source) if source.is_dir() else _in_list(source))
    if not items:
        what = f"no {_SESSION_FILE} anywhere below it" if source.is_dir() else "names no session"
        raise RecordError(
            f"{source}: {what}; give a folder that holds sessions, or a text file with a path a"
            " line"
        )
    return items


def _in_folder(folder: Path) -> Iterator[CampaignItem]:
    for file in sorted(folder.rglob(_SESSION_FILE)):
        below = file.parent.relative_to(folder)
        group = below.parts[0] if len(below.parts) > 1 else ""
        yield CampaignItem(below.as_posix(), group, file.parent)


def _in_list(file: Path) -> Iterator[CampaignItem]:
    line_of: dict[Path, int] = {}
    for number, line in enumerate(read_text(file).splitlines(), start=1):
        name, _, group = (part.strip() for part in line.partition("#")[0].partition(","))
        if not name:
            continue
        path = file.parent / name
        try:
            # The same for all spellings of the path, and for the folder and the file in it.
            real = real_session_file(path)
        except (OSError, ValueError) as error:
            raise RecordError(f"{file}, line {number}: {quoted(name)} cannot be a file") from error
        if real in line_of:
            raise InputError(
                f"{file}, line {number}: the session '{name}' is already in line {line_of[real]}; a"
                " session counts once: leave out one of the lines"
            )
        line_of[real] = number
        yield CampaignItem(name, group, path)

"""The sessions of a campaign, from a list or from a folder tree."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from palpate.errors import InputError, RecordError, quoted
from palpate.records import read_text

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
    found = tuple(_in_folder(source) if source.is_dir() else _in_list(source))
    if not found:
        what = f"no {_SESSION_FILE} anywhere below it" if source.is_dir() else "names no session"
        raise RecordError(
            f"{source}: {what}; give a folder that holds sessions, or a text file with a path a"
            " line"
        )
    return found


def _in_folder(folder: Path) -> Iterator[CampaignItem]:
    for file in sorted(folder.rglob(_SESSION_FILE)):
        below = file.parent.relative_to(folder)
        group = below.parts[0] if len(below.parts) > 1 else ""
        yield CampaignItem(below.as_posix(), group, file.parent)


def _in_list(file: Path) -> Iterator[CampaignItem]:
    line_of: dict[str, int] = {}
    for number, line in enumerate(read_text(file).splitlines(), start=1):
        name, _, group = (part.strip() for part in line.partition("#")[0].partition(","))
        if not name:
            continue
        path = file.parent / name
        try:
            # The same for all spellings of the path, and for the folder and the file in it.
            real = os.path.realpath(path / _SESSION_FILE if path.is_dir() else path)
        except (OSError, ValueError) as error:
            raise RecordError(f"{file}, line {number}: {quoted(name)} cannot be a file") from error
        if real in line_of:
            raise InputError(
                f"{file}, line {number}: the session '{name}' is already in line {line_of[real]}; a"
                " session counts once: leave out one of the lines"
            )
        line_of[real] = number
        yield CampaignItem(name, group, path)

"""The sessions of a campaign, from a list or from a folder with sessions somewhere below it."""

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
    name : str                      its path as the list writes it, or from the folder
    group : str                     what it is compared within; empty: with all
    path : Path                     folder of the session, or a session file
    """

    name: str
    group: str
    path: Path


def read_items(place: Path) -> tuple[CampaignItem, ...]:
    """The sessions that a list names, or that lie in a folder.

    A line of a list is a path, from the list's folder, and a group behind a comma where there are
    any; what stands behind `#` is a comment. In a folder the group is the first folder of two or
    more on the way down to the session.

    Parameters
    ----------
    place : Path                    text file, or folder

    Returns
    -------
    tuple of CampaignItem           in the list's order; in a folder in that of their names

    Raises
    ------
    RecordError                     not there, nothing in it, a session twice, what is no path
    """
    found = tuple(_in_folder(place) if place.is_dir() else _in_list(place))
    if not found:
        what = f"no {_SESSION_FILE} anywhere below it" if place.is_dir() else "names no session"
        raise RecordError(
            f"{place}: {what}; give a folder that holds sessions, or a text file with a path a line"
        )
    return found


def _in_folder(folder: Path) -> Iterator[CampaignItem]:
    for file in sorted(folder.rglob(_SESSION_FILE)):
        below = file.parent.relative_to(folder)
        group = below.parts[0] if len(below.parts) > 1 else ""
        yield CampaignItem(below.as_posix(), group, file.parent)


def _in_list(file: Path) -> Iterator[CampaignItem]:
    seen: dict[str, int] = {}
    for number, line in enumerate(read_text(file).splitlines(), start=1):
        name, _, group = (part.strip() for part in line.partition("#")[0].partition(","))
        if not name:
            continue
        path = file.parent / name
        try:
            # However it is spelled, and whether its folder is named or the file in it.
            real = os.path.realpath(path / _SESSION_FILE if path.is_dir() else path)
        except (OSError, ValueError) as error:
            raise RecordError(f"{file}, line {number}: {quoted(name)} cannot be a file") from error
        if real in seen:
            raise InputError(
                f"{file}, line {number}: the session '{name}' is already in line {seen[real]}; a"
                " session counts once: leave out one of the lines"
            )
        seen[real] = number
        yield CampaignItem(name, group, path)

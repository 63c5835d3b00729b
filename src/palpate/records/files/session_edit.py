"""One key more in a session.toml that a person wrote: everything else stays as it is."""

import json
import re
import tomllib
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

from palpate.errors import RecordError

_PROBE = re.compile(r"^\s*(\[\[\s*probe\s*\]\]|\[\s*probe\s*\])\s*(#.*)?$")
_TABLE = re.compile(r"^\s*\[")
_KEY = re.compile(r"""^(\s*displacement\s*=\s*)("[^"]*"|'[^']*')(\s*(?:#.*)?)$""")


def displacement_line(file: str) -> str:
    """The line of a [[probe]] table that names its displacement file."""
    return f"displacement = {json.dumps(file, ensure_ascii=False)}"


def with_displacements(path: Path, text: str, files: Mapping[str, str]) -> str:
    """A session's text in which some probings name their displacement files.

    One line per probing is inserted, or its value exchanged; comments, order and blanks stay. The
    result is read back and must differ from the original in these keys alone.

    Parameters
    ----------
    path : Path                     of the session, for messages
    text : str                      valid TOML
    files : mapping                 name of the probing to file, relative to the session

    Raises
    ------
    RecordError                     the tables are written in a way that is not understood; the text
                                    says which lines to add by hand
    """
    before = tomllib.loads(text)
    wanted = _expected(before, files)
    for number, probe in enumerate(_probes(before)):
        if probe["name"] in files:
            text = _edited(text, number, displacement_line(files[probe["name"]]))
    try:
        fits = tomllib.loads(text) == wanted
    except tomllib.TOMLDecodeError:
        fits = False
    if not fits:
        lines = "; ".join(
            f"in the table of '{name}': {displacement_line(file)}" for name, file in files.items()
        )
        raise RecordError(
            f"{path}: its [[probe]] tables are written in a way that cannot be edited safely;"
            f" nothing was changed: use --out, and add by hand {lines}"
        )
    return text


def _probes(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The probe tables; one alone counts as an array of one."""
    probes = content["probe"]
    return probes if isinstance(probes, list) else [probes]


def _expected(before: Mapping[str, Any], files: Mapping[str, str]) -> dict[str, Any]:
    wanted = deepcopy(dict(before))
    for probe in _probes(wanted):
        if probe["name"] in files:
            probe["displacement"] = files[probe["name"]]
    return wanted


def _edited(text: str, number: int, line: str) -> str:
    """Text with the key in the probe table of this number, which is left as it is if not found."""
    lines = text.splitlines(keepends=True)
    heads = [i for i, content in enumerate(lines) if _PROBE.match(content.rstrip("\r\n"))]
    if number >= len(heads):
        return text
    head = heads[number]
    end = next((i for i in range(head + 1, len(lines)) if _TABLE.match(lines[i])), len(lines))
    ending = "\r\n" if lines[head].endswith("\r\n") else "\n"
    for i in range(head + 1, end):
        bare = lines[i].rstrip("\r\n")
        if match := _KEY.match(bare):
            value = line.partition(" = ")[2]
            lines[i] = f"{match[1]}{value}{match[3]}{lines[i][len(bare) :]}"
            return "".join(lines)
    last = end - 1
    while last > head and (not lines[last].strip() or lines[last].lstrip().startswith("#")):
        last -= 1
    if not lines[last].endswith("\n"):
        lines[last] += ending
    return "".join([*lines[: last + 1], line + ending, *lines[last + 1 :]])

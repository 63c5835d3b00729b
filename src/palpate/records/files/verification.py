"""Verification of results: unchanged since written, consistent, and made from the present input."""

import json
import os
from dataclasses import dataclass
from pathlib import Path

from palpate.errors import RecordError
from palpate.parts import is_intact_part
from palpate.records.files.estimate import read_estimate
from palpate.records.files.results import (
    INPUTS_FILE,
    SEAL_NAME,
    folder_changes,
    is_sealed,
    target_parts_folder,
)
from palpate.records.files.sums import CHANGED, changes, sums_in, unreadable_errors
from palpate.records.text import read_text

UNCHANGED = "as it was"


@dataclass(frozen=True, slots=True)
class Finding:
    """State of one file of a result, or of one of its inputs.

    Attributes
    ----------
    file : str                      path relative to the result
    role : str                      "result", "input", or "part": a finished part that an
                                    interrupted run left
    state : str                     `UNCHANGED`, or what is wrong
    """

    file: str
    role: str
    state: str

    @property
    def is_unchanged(self) -> bool:
        """Whether the file is unchanged and consistent."""
        return self.state == UNCHANGED


def verify_result(path: Path) -> tuple[Finding, ...]:
    """Verify a result, its inputs, and finished parts of an interrupted run by their checksums.

    Parameters
    ----------
    path : Path                     a result folder, or a JSON result file

    Returns
    -------
    tuple of Finding                one for each file

    Raises
    ------
    RecordError                     not a result of Palpate, or not readable
    """
    parts = _parts(path)
    if parts and not path.exists():
        raise RecordError(
            f"{path}: is not there; an interrupted run left {len(parts)} finished parts of it in"
            f" {parts[0].file.rpartition('/')[0]}: run it again to go on"
        )
    return (*(_folder_findings(path) if path.is_dir() else _file_findings(path)), *parts)


def _parts(path: Path) -> list[Finding]:
    """The finished parts stored next to a result."""
    folder = target_parts_folder(Path(os.path.abspath(path)))
    with unreadable_errors():
        names = sorted(os.listdir(folder)) if folder.is_dir() else []
    return [
        Finding(
            f"{folder.name}/{name}", "part", UNCHANGED if is_intact_part(folder / name) else CHANGED
        )
        for name in names
        # Temporary files of a part that was being written; the next run removes them.
        if not name.startswith(".")
    ]


def _folder_findings(folder: Path) -> tuple[Finding, ...]:
    kind, changed, sums = folder_changes(folder)
    if not kind:
        raise RecordError(
            f"{folder}: is no result that can be verified: it has no contents.txt with sums, as"
            " this version writes it; results of earlier versions have none"
        )
    states = dict.fromkeys(sums, UNCHANGED) | changed
    if states.get("estimate.json") == UNCHANGED:
        try:
            read_estimate(folder / "estimate.json")
        except RecordError as error:
            states["estimate.json"] = str(error).removeprefix(f"{folder / 'estimate.json'}: ")
    findings = [Finding(name, "result", state) for name, state in states.items()]
    return (*findings, *_inputs(folder, sums_in(folder / INPUTS_FILE)))


def _file_findings(path: Path) -> tuple[Finding, ...]:
    text = read_text(path)
    if f'"{SEAL_NAME}": "' not in text:
        raise RecordError(f"{path}: is no result that can be verified: it has no {SEAL_NAME}")
    if not is_sealed(text):
        return (Finding(path.name, "result", CHANGED),)
    return (
        Finding(path.name, "result", UNCHANGED),
        *_inputs(path.parent, json.loads(text)["inputs"]),
    )


def _inputs(folder: Path, sums: dict[str, str]) -> list[Finding]:
    changed = changes(folder, sums)
    return [Finding(name, "input", changed.get(name, UNCHANGED)) for name in sums]

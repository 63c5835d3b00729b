"""Whether a result is as it was written, says no contradiction, and is made from what is there."""

import json
from dataclasses import dataclass
from pathlib import Path

from palpate.errors import RecordError
from palpate.records.files.estimate import read_estimate
from palpate.records.files.results import INPUTS_FILE, SEAL_NAME, folder_changes, is_sealed
from palpate.records.files.sums import changes, sums_in
from palpate.records.text import read_text

WHOLE = "as it was"


@dataclass(frozen=True, slots=True)
class Finding:
    """What is known of one file of a result, or of one that it was made from.

    Attributes
    ----------
    file : str                      name, from the result
    role : str                      "result" or "input"
    state : str                     `WHOLE`, or what is wrong
    """

    file: str
    role: str
    state: str

    @property
    def is_whole(self) -> bool:
        """Whether nothing is wrong."""
        return self.state == WHOLE


def verify_result(path: Path) -> tuple[Finding, ...]:
    """Compare a result with the sums that it carries of itself and of its inputs.

    Parameters
    ----------
    path : Path                     a result folder, or a JSON file that a command left

    Returns
    -------
    tuple of Finding                one for each file

    Raises
    ------
    RecordError                     no result of Palpate's, or not readable
    """
    return _folder_findings(path) if path.is_dir() else _file_findings(path)


def _folder_findings(folder: Path) -> tuple[Finding, ...]:
    kind, changed, sums = folder_changes(folder)
    if not kind:
        raise RecordError(
            f"{folder}: is no result that can be verified: there is no contents.txt with sums in"
            " it; results of earlier versions have none"
        )
    states = dict.fromkeys(sums, WHOLE) | changed
    if states.get("estimate.json") == WHOLE:
        try:
            read_estimate(folder / "estimate.json")
        except RecordError as error:
            states["estimate.json"] = str(error).removeprefix(f"{folder / 'estimate.json'}: ")
    own = [Finding(name, "result", state) for name, state in states.items()]
    return (*own, *_inputs(folder, sums_in(folder / INPUTS_FILE)))


def _file_findings(path: Path) -> tuple[Finding, ...]:
    text = read_text(path)
    if f'"{SEAL_NAME}": "' not in text:
        raise RecordError(f"{path}: is no result that can be verified: it has no {SEAL_NAME}")
    if not is_sealed(text):
        return (Finding(path.name, "result", "changed"),)
    return (
        Finding(path.name, "result", WHOLE),
        *_inputs(path.parent, json.loads(text)["inputs"]),
    )


def _inputs(folder: Path, sums: dict[str, str]) -> list[Finding]:
    try:
        changed = changes(folder, sums)
    except OSError as error:
        raise RecordError(f"{error.filename}: cannot be read ({error.strerror})") from error
    return [Finding(name, "input", changed.get(name, WHOLE)) for name in sums]

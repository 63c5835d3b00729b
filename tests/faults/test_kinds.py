"""Every kind of broken input gets one message that names the place, and nothing is touched."""

import hashlib
import importlib
import shutil
from pathlib import Path

import pytest
from faults.kind import Kind

from palpate.app.cli import main

_FILES = sorted(path.stem for path in Path(__file__).parent.glob("kinds_*.py"))
_KINDS: list[Kind] = [
    kind for file in _FILES for kind in importlib.import_module(f"faults.{file}").KINDS
]
# A message that fills a terminal is a flood: nobody finds its point.
_MOST_CHARACTERS = 1500
# No example has a file of so many bytes.
_HOLE = 2**30


def _content(folder: Path) -> dict[str, str]:
    """Digest of every regular file below a folder; of one that is a hole, its size."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        if path.stat().st_size < _HOLE
        else str(path.stat().st_size)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.mark.parametrize("kind", _KINDS, ids=lambda kind: kind.name)
def test_one_message_and_nothing_touched(
    kind: Kind,
    tmp_path: Path,
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "work"
    shutil.copytree(request.getfixturevalue(kind.example), folder)
    kind.damage(folder)
    before = _content(folder)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "100")
    code = main(list(kind.command))
    said = capsys.readouterr()
    assert code == kind.code, said.err
    assert "Traceback" not in said.out + said.err
    assert len(said.err) < _MOST_CHARACTERS
    missing = [piece for piece in kind.says if piece not in said.err]
    assert not missing, f"{missing} not in: {said.err}"
    assert _content(folder) == before


def test_names_differ() -> None:
    names = [kind.name for kind in _KINDS]
    assert sorted(set(names)) == sorted(names)

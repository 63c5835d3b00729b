"""What a user may not read, or may not write to: one line, an exit code, nothing left."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from fault_injection import without_rights

from palpate.app import process
from palpate.app.cli import main


@pytest.fixture
def work(bench: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The bench; what was closed in it is opened again."""
    folder = tmp_path / "bench"
    shutil.copytree(bench, folder)
    monkeypatch.chdir(folder)
    yield folder
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o755)


def _tree(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("closed", "words"),
    [
        ("cube/session.toml", ("check", "cube")),
        ("cube/mesh.ply", ("check", "cube")),
        ("cube/n01.csv", ("fit", "cube", "--out", "made")),
        ("rig.toml", ("check", "pictured")),
        ("result/estimate.json", ("report", "result", "--out", "made.html")),
        ("cube", ("check", "cube")),
        ("list.txt", ("campaign", "run", "list.txt", "--out", "made")),
    ],
)
def test_what_may_not_be_read_is_named(work: Path, closed: str, words: tuple[str, ...]) -> None:
    target = work / ("pictured/rig.toml" if closed == "rig.toml" else closed)
    target.chmod(0o000)
    code, said = without_rights(lambda: main(list(words)))
    assert code == 2
    assert "ermission denied" in said
    assert Path(closed).name in said
    assert "Traceback" not in said
    assert not (work / "made").exists()


@pytest.mark.parametrize(
    "words",
    [
        ("fit", "cube", "--out", "made"),
        ("mesh", "mesh.ply", "--vertices", "60", "--out", "made"),
        ("export", "result", "--to", "obj", "--out", "made"),
        ("report", "result", "--out", "made.html"),
        ("init", "cube"),
        ("campaign", "table", "many", "--out", "made.csv"),
    ],
)
def test_where_nothing_may_be_written(work: Path, words: tuple[str, ...]) -> None:
    for path in (work, *work.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    before = _tree(work)
    code, said = without_rights(lambda: main(list(words)))
    assert code == 2
    assert len(said.strip()) > 20
    assert "Traceback" not in said
    assert _tree(work) == before


def test_a_home_that_may_not_be_searched_is_as_good_as_none(
    work: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of another user, as in a container: kernels are then compiled into a temporary folder."""
    (work / "users" / "me").mkdir(parents=True)
    monkeypatch.setenv("HOME", str(work / "users" / "me"))
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    # The installation, which is asked first, belongs to whoever runs the tests.
    places = process._cache_places()[1:]
    monkeypatch.setattr(process, "_cache_places", lambda: places)
    (work / "users").chmod(0o000)
    code, said = without_rights(lambda: main(["check", "cube"]))
    (work / "users").chmod(0o755)
    assert code in (0, 3)
    assert "set NUMBA_CACHE_DIR to a folder that can be written" in said

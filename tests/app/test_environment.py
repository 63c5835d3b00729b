"""What the environment of a process may lack, tried in processes of their own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from cube_session import cube_session as cube_session

from palpate.app import environment
from palpate.app.environment import kernel_cache, usable_columns
from palpate.errors import InputError

SRC = str(Path(__file__).parents[2] / "src")
RUN = "import sys; from palpate.app.cli import main; sys.exit(main())"


def run(folder, *words, **variables):
    """`palpate` in a process of its own, with some variables set, or unset where None."""
    env = {**os.environ, "PYTHONPATH": SRC, **variables}
    return subprocess.run(
        [sys.executable, "-c", RUN, *words], capture_output=True, text=True, cwd=folder,
        env={key: value for key, value in env.items() if value is not None}, timeout=60,
    )  # fmt: skip


@pytest.mark.parametrize("columns", ["0", "1", "19"])
def test_a_width_that_shows_nothing_is_left_aside(columns, monkeypatch):
    monkeypatch.setenv("COLUMNS", columns)
    with usable_columns():
        assert "COLUMNS" not in os.environ
    assert os.environ["COLUMNS"] == columns


@pytest.mark.parametrize("columns", ["20", "100", "wide"])
def test_a_width_that_shows_something_stays(columns, monkeypatch):
    monkeypatch.setenv("COLUMNS", columns)
    with usable_columns():
        assert os.environ["COLUMNS"] == columns


def test_kernels_stay_where_they_can_be_written(monkeypatch, capsys):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    with kernel_cache():
        assert "NUMBA_CACHE_DIR" not in os.environ
    assert capsys.readouterr().err == ""


def test_kernels_have_a_folder_that_goes_with_the_process(monkeypatch, capsys):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(environment, "_is_writable", lambda folder: False)
    with kernel_cache():
        folder = Path(os.environ["NUMBA_CACHE_DIR"])
        assert folder.is_dir()
    assert not folder.exists()
    assert "NUMBA_CACHE_DIR" not in os.environ
    assert "set NUMBA_CACHE_DIR" in capsys.readouterr().err


def test_no_place_at_all_is_said(monkeypatch):
    def refused(**_):
        raise OSError(30, "Read-only file system")

    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(environment, "_is_writable", lambda folder: False)
    monkeypatch.setattr(environment.tempfile, "mkdtemp", refused)
    with pytest.raises(InputError, match=r"Read-only.*set NUMBA_CACHE_DIR"), kernel_cache():
        pass


def test_the_places_are_those_of_the_library(tmp_path, monkeypatch):
    """numba itself, asked where it would keep the kernels of a file that cannot be written."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    user = tmp_path if sys.platform == "linux" else None
    from numba.misc.appdirs import AppDirs  # noqa: PLC0415

    place = Path(AppDirs(appname="numba", appauthor=False).user_cache_dir)
    assert user is None or place.parent == user
    assert place.parent in environment._cache_places()


@pytest.mark.parametrize(
    ("variables", "says"),
    [
        ({"NUMBA_NUM_THREADS": "0"}, "correct or unset NUMBA_NUM_THREADS=0"),
        ({"NUMBA_THREADING_LAYER": "bogus"}, "correct or unset NUMBA_THREADING_LAYER=bogus"),
        ({"MPLBACKEND": "nonsense"}, "correct or unset MPLBACKEND=nonsense"),
    ],
)
def test_variables_of_libraries_that_mean_nothing(cube_session, variables, says):
    found = run(cube_session.parent, "fit", "cube", "--out", "made", **variables)
    assert found.returncode == 2
    assert says in found.stderr
    assert "Traceback" not in found.stderr
    assert [path.name for path in cube_session.parent.iterdir()] == ["cube"]


@pytest.mark.parametrize(
    "variables",
    [
        {"HOME": None, "XDG_CACHE_HOME": None},
        {"LANG": "C", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"},
        {"LC_ALL": "nonsense"},
        {"COLUMNS": "0", "TERM": "bogus"},
        {"TMPDIR": "/nonexistent"},
    ],
    ids=lambda variables: " ".join(f"{key}={value}" for key, value in variables.items()),
)
def test_a_poor_environment_shows_the_same(cube_session, variables):
    found = run(cube_session.parent, "check", "cube", **variables)
    assert found.returncode == 0
    assert found.stderr == ""
    assert "218, 432" in found.stdout

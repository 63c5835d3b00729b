"""The last guard: whatever happens is one line, with a report where the program is to blame."""

import io
import logging
import os
import resource
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import pytest
from cube_session import cube_session as cube_session

from palpate.app import process
from palpate.app.process import guarded, kernel_cache, usable_columns
from palpate.errors import InputError

SRC = str(Path(__file__).parents[2] / "src")
RUN = "import sys; from palpate.app.cli import main; sys.exit(main())"


def _raising(error: BaseException):
    @guarded
    def main(arguments=None):
        raise error

    return main


@pytest.fixture
def in_folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_an_unexpected_error_is_one_line_that_names_a_report(in_folder, capsys):
    assert _raising(KeyError("knot"))(["check", "session"]) == 70
    said = capsys.readouterr().err
    (report,) = in_folder.iterdir()
    assert said.startswith("palpate: an error of the program, not of yours (KeyError: 'knot')")
    assert said.count("\n") == 1
    assert report.name in said
    text = report.read_text()
    assert "command: palpate check session" in text
    assert "Traceback" in text
    assert "numpy 2" in text


def test_the_report_goes_elsewhere_where_the_folder_takes_none(in_folder, monkeypatch, capsys):
    (in_folder / "kept").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(in_folder / "kept"))
    written = Path.write_text

    def full(path, *arguments, **named):
        if path.parent == Path():
            raise OSError(28, "No space left on device")
        return written(path, *arguments, **named)

    monkeypatch.setattr(Path, "write_text", full)
    assert _raising(KeyError("knot"))([]) == 70
    (report,) = (in_folder / "kept").iterdir()
    assert str(report) in capsys.readouterr().err
    monkeypatch.setattr(tempfile, "tempdir", str(in_folder / "none"))
    assert _raising(KeyError("knot"))([]) == 70
    assert "no report could be written" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError("Unable to allocate 298 GiB"), "memory ran out (Unable to allocate 298 GiB);"),
        (MemoryError(), "memory ran out; use a coarser mesh"),
        (RecursionError("maximum recursion depth"), "(lists in lists without end)"),
    ],
)
def test_memory_and_depth_have_messages_of_their_own(in_folder, capsys, error, said):
    assert _raising(error)([]) == 70
    assert said in capsys.readouterr().err
    # Memory is no fault of the program's.
    assert len(list(in_folder.iterdir())) == isinstance(error, RecursionError)


def test_memory_that_was_behind_another_error_is_named(in_folder, capsys):
    error = ImportError("cannot import")
    error.__cause__ = MemoryError()
    assert _raising(error)([]) == 70
    assert "memory ran out" in capsys.readouterr().err


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252"])
def test_output_degrades_where_the_encoding_lacks_a_character(monkeypatch, encoding):
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", stream)

    @guarded
    def main(arguments=None):
        print("E 2.0 ± 0.1, 5 µm \u4e00 \udc80")
        return 0

    assert main([]) == 0
    stream.flush()
    said = stream.buffer.getvalue()
    assert said == (
        b"E 2.0 +- 0.1, 5 um ? ?\n" if encoding == "ascii" else b"E 2.0 \xb1 0.1, 5 \xb5m ? ?\n"
    )
    assert stream.errors == "strict"


def test_libraries_say_nothing_on_the_terminal(in_folder, capsys):
    @guarded
    def main(arguments=None):
        warnings.simplefilter("always")
        warnings.warn("overflow encountered", stacklevel=1)
        logging.getLogger("matplotlib").warning("created a temporary cache folder")
        raise ValueError("odd")

    with warnings.catch_warnings():
        assert main([]) == 70
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    (report,) = in_folder.iterdir()
    assert "overflow encountered" in report.read_text()
    assert "created a temporary cache folder" in report.read_text()


def _run(*words: str, **changes) -> subprocess.CompletedProcess:
    command = "import sys; from palpate.app.cli import main; sys.exit(main())"
    return subprocess.run(
        [sys.executable, "-c", command, *words], capture_output=True, text=True, **changes
    )


def test_a_process_that_may_have_little_memory_says_so_at_once():
    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (600 * 2**20, 600 * 2**20))

    done = _run("check", ".", preexec_fn=limit)
    assert done.returncode == 70
    assert done.stderr == (
        "palpate: may use 0.59 GiB of memory (ulimit -v), and needs 1.5 GiB; raise the limit\n"
    )


def test_a_variable_that_numba_refuses_is_named(cube_session):
    done = _run("check", str(cube_session), env=os.environ | {"NUMBA_NUM_THREADS": "0"})
    assert done.returncode == 2
    assert "must be > 0. (numba); correct or unset" in done.stderr
    assert "NUMBA_NUM_THREADS=0" in done.stderr
    assert done.stderr.count("\n") == 1


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
    monkeypatch.setattr(process, "_is_writable", lambda folder: False)
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
    monkeypatch.setattr(process, "_is_writable", lambda folder: False)
    monkeypatch.setattr(process.tempfile, "mkdtemp", refused)
    with pytest.raises(InputError, match=r"Read-only.*set NUMBA_CACHE_DIR"), kernel_cache():
        pass


def test_the_places_are_those_of_the_library(tmp_path, monkeypatch):
    """numba itself, asked where it would keep the kernels of a file that cannot be written."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    user = tmp_path if sys.platform == "linux" else None
    from numba.misc.appdirs import AppDirs  # noqa: PLC0415

    library_cache = Path(AppDirs(appname="numba", appauthor=False).user_cache_dir)
    assert user is None or library_cache.parent == user
    assert library_cache.parent in process._cache_places()


@pytest.mark.parametrize(
    ("variables", "says"),
    [
        ({"NUMBA_NUM_THREADS": "0"}, "correct or unset NUMBA_NUM_THREADS=0"),
        ({"NUMBA_THREADING_LAYER": "bogus"}, "correct or unset NUMBA_THREADING_LAYER=bogus"),
        ({"MPLBACKEND": "nonsense"}, "correct or unset MPLBACKEND=nonsense"),
    ],
)
def test_variables_of_libraries_that_mean_nothing(cube_session, variables, says):
    done = run(cube_session.parent, "fit", "cube", "--out", "made", **variables)
    assert done.returncode == 2
    assert says in done.stderr
    assert "Traceback" not in done.stderr
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
    done = run(cube_session.parent, "check", "cube", **variables)
    assert done.returncode == 0
    assert done.stderr == ""
    assert "218, 432" in done.stdout

"""What every test may ask for."""

import faulthandler
import os
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba
import pytest
from _pytest.faulthandler import fault_handler_stderr_fd_key
from jaxtyping import _import_hook
from shape_checks import check_first_calls, forget_calls

# The import hook wraps every function; numba cannot compile a wrapper, so kernels go unwrapped.
# They are arrays in, arrays out, and called by functions that are checked. Versions of jaxtyping
# that do not have it run without the hook (`make oldest`).
_marked_unchecked = getattr(_import_hook, "_is_no_type_check", lambda _: False)


def _is_unchecked(decorator: Any) -> bool:
    """True for decorators of functions that the shape checker must leave alone."""
    called = getattr(decorator, "func", decorator)
    name = getattr(called, "attr", getattr(called, "id", ""))
    return name in ("njit", "jit", "vectorize", "guvectorize") or _marked_unchecked(decorator)


_import_hook._is_no_type_check = _is_unchecked
check_first_calls()


def _trace_file(workerinput: dict[str, str]) -> Path:
    """Where one of several processes says what its threads were doing when it ended."""
    name = f"palpate-tests-{workerinput['testrunuid']}-{workerinput['workerid']}.txt"
    return Path(tempfile.gettempdir()) / name


@pytest.hookimpl(trylast=True)
def pytest_configure(config: Any) -> None:
    """A process that crashes or stands still writes what its threads were doing into a file: its
    standard error is lost among what the others print."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        path = _trace_file(config.workerinput)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.close(config.stash[fault_handler_stderr_fd_key])
        config.stash[fault_handler_stderr_fd_key] = descriptor
        faulthandler.enable(descriptor)


def pytest_unconfigure(config: Any) -> None:
    """Nothing is left of processes that ended well."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        _trace_file(config.workerinput).unlink(missing_ok=True)


@pytest.hookimpl(optionalhook=True)
def pytest_handlecrashitem(report: Any) -> None:
    """The report of a test that took its process along shows what that wrote."""
    path = _trace_file(report.node.workerinput)
    text = path.read_text(errors="replace") if path.exists() else ""
    report.longrepr += "\n\n" + (text or "It left no trace: it was killed, or ended by itself.")
    path.unlink(missing_ok=True)


def pytest_runtest_setup() -> None:
    """Every test has the shapes of its calls checked anew."""
    forget_calls()


# What takes longest starts first, so that processes that share the tests end together: first the
# files that take more than some ten seconds, and rooms whose files take seconds each. The first two
# need different kernels: none is compiled twice at the same time.
_LONGEST_FIRST = (
    "tests/vision/joint/test_flow.py",
    "tests/paper/test_table3.py",
    "tests/examples",
    "tests/faults/test_kinds.py",
    "tests/app/test_tutorial.py",
    "tests/pipeline/test_fit_session.py",
    "tests/faults/test_interrupted.py",
    "tests/geometry/registration",
    "tests/pipeline/motion/test_measure_motion.py",
    "tests/lab/test_facility.py",
    "tests/calibration",
    "tests/scanning",
    "tests/vision/joint",
    "tests/vision/matching",
    "tests/ground",
    "tests/docs/test_guides.py",
    "tests/docs/test_blocks.py",
    "tests/paper",
    "tests/app/commands",
    "tests/app",
    "tests/pipeline",
    "tests/recording",
    "tests/estimation",
    "tests/simulation",
    "tests/lab",
    "tests/vision",
    "tests/truth",
    "tests/bem",
    "tests/campaign",
    "tests/viewer",
    "tests/faults",
    "tests/report",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first; within them the order stays."""

    def place(item: pytest.Item) -> int:
        matching = (k for k, name in enumerate(_LONGEST_FIRST) if item.nodeid.startswith(name))
        return next(matching, len(_LONGEST_FIRST))

    items.sort(key=place)


@pytest.fixture
def heeded_signals() -> Iterator[None]:
    """Signals do what they do in a terminal, for this process and those that it starts: what runs
    the tests in the background, as nohup and cron do, has some of them ignored."""
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGHUP: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="session", autouse=True)
def _one_thread_each() -> None:
    """Processes that share the tests have a thread each; tests of threads ask for theirs."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        numba.set_num_threads(1)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the data that is shared between the project's parts, beside the checkout.

    Tests that use it skip where it is absent; where CI=true is set they fail instead.
    """
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if folder.is_dir():
        return folder
    text = "needs the folder ../shared/data beside the checkout, which is not there"
    if os.environ.get("CI") == "true":
        pytest.fail(text)
    pytest.skip(text)

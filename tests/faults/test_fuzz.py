"""Whatever is in a file, its reader takes it or says what is wrong with it: nothing else is raised.

`make test` tries some 500 files, the same every time, and those in `corpus`, which were once read
or refused wrongly; `make fuzz` ten thousand, others every time; `make fuzz-coverage` those that
lead to lines of the readers where no other did.
"""

import os
import re
import time
from pathlib import Path

import numpy as np
import pytest
from faults.samples import Reader, write_samples
from hypothesis import HealthCheck, given, settings, strategies as st

from palpate.errors import PalpateError

# Examples for each of the files; there are `_COUNT` of them.
_EXAMPLES = int(os.environ.get("PALPATE_FUZZ_EXAMPLES", "8"))
_MOST_SECONDS = 10.0
_MOST_CHARACTERS = 1500
_NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
_ODD = [
    b"nan", b"-inf", b"1e300", b"1e160", b"1e-300", b"-1", b"0", b"9" * 400, b"1_0", b"", b'""',
    b"true", b"[]", b"[" * 9000, b"x" * 200_000, b"\0", b"\xff\xfe", b"\xff\xff\xff\x7f",
]  # fmt: skip


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Path, Reader]]:
    return write_samples(tmp_path_factory.mktemp("samples"))


@st.composite
def _damaged(draw: st.DrawFn, content: bytes) -> bytes:
    """A file with one to three pieces cut out, doubled, moved or replaced."""
    for _ in range(draw(st.integers(1, 3))):
        numbers = [(m.start(), m.end()) for m in _NUMBER.finditer(content[:20_000])]
        begin = draw(st.integers(0, max(len(content) - 1, 0)))
        piece = (begin, begin + draw(st.sampled_from([0, 1, 4, 8, 100, len(content)])))
        if numbers and draw(st.booleans()):
            piece = draw(st.sampled_from(numbers))
        start, end = piece
        new = draw(st.sampled_from(_ODD) | st.binary(max_size=8) | st.just(content[start:end] * 2))
        content = content[:start] + new + content[end:]
    return content


def read_damaged(file: Path, read: Reader, content: bytes) -> None:
    """Read a damaged file: whatever happens is quick, and said in one message if anything.

    Parameters
    ----------
    file : Path                     gets the content
    read : callable
    content : bytes
    """
    file.write_bytes(content)
    start = time.perf_counter()
    try:
        # Warnings are kept from the terminal by the app; a number that overflows is no fault here.
        with np.errstate(all="ignore"):
            read(file)
    except PalpateError as error:
        said = str(error)
        assert len(said) < _MOST_CHARACTERS
        assert "\n" not in said
    assert time.perf_counter() - start < _MOST_SECONDS


_COUNT = 74
# In a folder for each sample, named like it.
_CORPUS = sorted(Path(__file__).with_name("corpus").glob("*/*"))


@pytest.mark.parametrize("number", range(_COUNT))
def test_a_damaged_file_is_read_or_refused(samples: list[tuple[Path, Reader]], number: int) -> None:
    file, read = samples[number]
    good = file.read_bytes()

    @settings(
        max_examples=_EXAMPLES,
        deadline=None,
        database=None,
        derandomize="PALPATE_FUZZ_EXAMPLES" not in os.environ,
        suppress_health_check=list(HealthCheck),
    )
    @given(content=_damaged(good))
    def try_all(content: bytes) -> None:
        read_damaged(file, read, content)

    try:
        try_all()
    finally:
        file.write_bytes(good)


def test_every_sample_is_tried_and_good(samples: list[tuple[Path, Reader]]) -> None:
    assert len(samples) == _COUNT
    for file, read in samples:
        read(file)


@pytest.mark.parametrize("bad", _CORPUS, ids=lambda path: f"{path.parent.name} {path.name}")
def test_what_was_found_stays_mended(samples: list[tuple[Path, Reader]], bad: Path) -> None:
    ((file, read),) = [sample for sample in samples if sample[0].name == bad.parent.name]
    good = file.read_bytes()
    try:
        read_damaged(file, read, bad.read_bytes())
    finally:
        file.write_bytes(good)

"""Safe reading of files: regular files of bounded size only, and errors that say what is wrong."""

import math
import os
import stat
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import BufferedIOBase, BytesIO, StringIO
from pathlib import Path
from typing import IO

import numpy as np

from palpate.errors import InputError, PalpateError, RecordError

# Far larger than any file that Palpate reads [bytes]; stops reading of endless files.
_MAX_BYTES = 4 * 2**30
# Largest compression ratio of measurements, and size [bytes] up to which any ratio is accepted.
_MAX_RATIO, _ANY_RATIO_BYTES = 100, 2**28
# What Git LFS leaves for a large file that was not fetched, shorter than this [bytes].
_POINTER, _MOST_POINTER_BYTES = b"version https://git-lfs.github.com/spec/", 1024
# Neither follow a link, nor wait for the other end of a pipe (Windows knows neither).
_OWN_FILE_FLAGS = (
    os.O_RDONLY
    | getattr(os, "O_NOFOLLOW", 0)
    | getattr(os, "O_NONBLOCK", 0)
    | getattr(os, "O_BINARY", 0)
)
# Things that are not regular files: reading them could block, or never end.
_IRREGULAR_KINDS = {
    stat.S_IFDIR: "Is a directory",
    stat.S_IFIFO: "a pipe, no regular file",
    stat.S_IFCHR: "a device, no regular file",
    stat.S_IFBLK: "a device, no regular file",
    stat.S_IFSOCK: "a socket, no regular file",
}


def checked_file(
    path: Path, *, max_bytes: int = _MAX_BYTES, kind: type[InputError] = RecordError
) -> Path:
    """Return a path after checking that it is a regular file of bounded size.

    Parameters
    ----------
    path : Path
    max_bytes : int                 largest permitted size [bytes]
    kind : class                    class of the error to raise

    Returns
    -------
    Path                            `path`, unchanged

    Raises
    ------
    InputError of that kind         missing, not a regular file, too large, in Git LFS
    """
    try:
        status = os.stat(path)
    except (OSError, ValueError) as error:
        raise kind(f"{path}: cannot be read ({reason(error)})") from error
    _check_kind(path, status, max_bytes, kind)
    if status.st_size < _MOST_POINTER_BYTES and _is_pointer(path):
        raise kind(f"{path}: is a Git LFS pointer in place of the file; get that by: git lfs pull")
    return path


def _is_pointer(path: Path) -> bool:
    """Whether a file starts as a Git LFS pointer; False if it cannot be opened."""
    try:
        with path.open("rb") as file:
            return file.read(len(_POINTER)) == _POINTER
    except OSError:
        return False


def _check_kind(path: Path, status: os.stat_result, max_bytes: int, kind: type[InputError]) -> None:
    """Refuse what is no regular file of bounded size."""
    if not stat.S_ISREG(status.st_mode):
        what = _IRREGULAR_KINDS.get(stat.S_IFMT(status.st_mode), "no regular file")
        raise kind(f"{path}: cannot be read ({what}); give a file")
    if status.st_size > max_bytes:
        raise kind(
            f"{path}: has {status.st_size} bytes, more than the {max_bytes} that are read of such a"
            " file; is it the right one?"
        )


def is_file(path: Path) -> bool:
    """Whether a path exists and is not a folder; False also for an invalid name.

    Parameters
    ----------
    path : Path
    """
    try:
        return not stat.S_ISDIR(os.stat(path).st_mode)
    except (OSError, ValueError):
        return False


def read_bytes(
    path: Path,
    count: int = -1,
    *,
    max_bytes: int = _MAX_BYTES,
    kind: type[InputError] = RecordError,
) -> bytes:
    """The first bytes of a file, or all of them.

    Parameters
    ----------
    path : Path
    count : int                     bytes to read; -1: all
    max_bytes, kind                 as `checked_file`

    Raises
    ------
    InputError of that kind         as `checked_file`; not readable
    """
    try:
        with checked_file(path, max_bytes=max_bytes, kind=kind).open("rb") as file:
            return file.read(count)
    except OSError as error:
        raise kind(f"{path}: cannot be read ({reason(error)})") from error


@contextmanager
def open_own_file(path: Path) -> Iterator[IO[bytes]]:
    """Open a file that belongs to this user and is no link.

    Parameters
    ----------
    path : Path

    Yields
    ------
    binary file

    Raises
    ------
    RecordError                     as `checked_file`; a link; another user's
    """
    try:
        handle = os.open(path, _OWN_FILE_FLAGS)
    except (OSError, ValueError) as error:
        raise RecordError(f"{path}: cannot be read ({reason(error)})") from error
    with os.fdopen(handle, "rb") as file:
        status = os.fstat(handle)
        _check_kind(path, status, _MAX_BYTES, RecordError)
        # Windows has no such numbers.
        if hasattr(os, "geteuid") and status.st_uid != os.geteuid():
            raise RecordError(f"{path}: belongs to another user; give a file of your own")
        yield file


def max_unpacked_size(size: int) -> int:
    """Largest permitted uncompressed size of a compressed file, as a guard against zip bombs.

    Parameters
    ----------
    size : int                      size of the file [bytes]

    Returns
    -------
    int                             [bytes]
    """
    return max(_ANY_RATIO_BYTES, _MAX_RATIO * size)


@contextmanager
def read_errors(
    path: Path,
    cure: str,
    *,
    what: str = "is damaged or cut off",
    kind: type[InputError] = RecordError,
) -> Iterator[None]:
    """Convert any error that a third-party reader raises within the block into one of ours.

    Whatever the reader prints is discarded.

    Parameters
    ----------
    path : Path                     the file that is read
    cure : str                      advice, for the message: what to do about a damaged file
    what : str                      what is wrong with it, for the message
    kind : class                    class of the error to raise

    Raises
    ------
    PalpateError                    passed through unchanged
    InputError of that kind         in place of any other error of the block
    """
    try:
        # Some readers print a message before they raise.
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            yield
    except PalpateError:
        raise
    # Readers raise errors of any class, and one of them calls sys.exit.
    except (Exception, SystemExit) as error:
        raise kind(f"{path}: {what} ({reason(error)}); {cure}") from error


@contextmanager
def stored_arrays(
    path: Path, cure: str, *, what: str = "is damaged or cut off", max_bytes: int = _MAX_BYTES
) -> Iterator[dict[str, np.ndarray]]:
    """The arrays of an NPZ file; errors raised while the block uses them become `RecordError`.

    Nothing is decompressed before the sizes are checked: a small file can expand to gigabytes.

    Parameters
    ----------
    path : Path
    cure, what : str                as in `read_errors`
    max_bytes : int                 largest permitted size of all arrays together [bytes]

    Yields
    ------
    dict of str to array            arrays by name

    Raises
    ------
    PalpateError                    raised by the block, passed through unchanged; but a plain
                                    `InputError`, which names no file
    RecordError                     missing, not a regular file, too large, not an NPZ file,
                                    damaged; also in place of any other error of the block
    """
    read_bytes(path, 0, max_bytes=max_bytes)
    with read_errors(path, cure, what=what):
        with path.open("rb") as file:
            arrays = unpacked_arrays(file, path, max_bytes=max_bytes)
        try:
            yield arrays
        except InputError as error:
            if type(error) is not InputError:
                raise
            raise RecordError(f"{path}: {error}; {cure}") from error


def unpacked_arrays(
    file: IO[bytes], path: Path, *, max_bytes: int = _MAX_BYTES
) -> dict[str, np.ndarray]:
    """The arrays of an open NPZ file, as `stored_arrays` gives them, whose `read_errors` it needs.

    Parameters
    ----------
    file : binary file
    path : Path                     of it, for the message
    max_bytes : int                 as in `stored_arrays`

    Returns
    -------
    dict of str to array            arrays by name

    Raises
    ------
    RecordError                     too large
    """
    with zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        size = sum(member.file_size for member in members)
        max_bytes = min(max_bytes, max_unpacked_size(os.fstat(file.fileno()).st_size))
        if size > max_bytes:
            raise RecordError(
                f"{path}: its arrays take {size} bytes, more than the {max_bytes} that are read"
                " of such a file; is it the right one?"
            )
        arrays = {}
        for member in members:
            with archive.open(member) as packed:
                name = member.filename.removesuffix(".npy")
                arrays[name] = _read_array(packed, member.file_size)
    return arrays


def parse_array(content: bytes) -> np.ndarray:
    """Array from the content of an NPY file.

    Parameters
    ----------
    content : bytes                 the whole file

    Returns
    -------
    array                           of any shape, of numbers or texts

    Raises
    ------
    ValueError                      not an NPY file, damaged, or not as long as its header states
    """
    return _read_array(BytesIO(content), len(content))


def _read_array(file: IO[bytes] | BufferedIOBase, size: int) -> np.ndarray:
    """Array from an NPY stream of `size` bytes; the size is checked before memory is allocated."""
    header_readers = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    version = np.lib.format.read_magic(file)
    if version not in header_readers:
        raise ValueError(f"its arrays have version {version} of the format NPY")
    shape, _, kind = header_readers[version](file)
    stated, actual = math.prod(shape) * max(kind.itemsize, 1), size - file.tell()
    if stated != actual and not kind.hasobject:
        raise ValueError(f"an array says that it has {stated} bytes, and holds {actual}")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)


def reason(error: BaseException) -> str:
    """One short line that describes an error of a third-party library.

    Parameters
    ----------
    error : exception
    """
    text = getattr(error, "strerror", None) or " ".join(str(error).split())
    if "integer string conversion" in text:  # Python's limit against long computations
        text = "a whole number of too many digits"
    if not text or isinstance(error, (KeyError, RecursionError, SystemExit)):
        text = f"{type(error).__name__} {text}".strip()
    return text if len(text) <= 160 else f"{text[:100]} ... {text[-50:]}"

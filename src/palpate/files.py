"""Files that are read: regular ones of a bounded size, and messages that name what is wrong."""

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

# Nothing that Palpate reads comes near this [bytes]; a file without an end does.
_MOST_BYTES = 4 * 2**30
# What stands in the place of a file: reading it would wait for ever, or never end.
_KINDS = {
    stat.S_IFDIR: "Is a directory",
    stat.S_IFIFO: "a pipe, no regular file",
    stat.S_IFCHR: "a device, no regular file",
    stat.S_IFBLK: "a device, no regular file",
    stat.S_IFSOCK: "a socket, no regular file",
}


def checked_file(
    path: Path, *, most: int = _MOST_BYTES, kind: type[InputError] = RecordError
) -> Path:
    """A path, if it is that of a regular file of a bounded size.

    Parameters
    ----------
    path : Path
    most : int                      bytes that a file of this kind has at most
    kind : class                    of the error

    Returns
    -------
    Path                            the same

    Raises
    ------
    InputError of that kind         not there, no regular file, too large
    """
    try:
        found = os.stat(path)
    except (OSError, ValueError) as error:
        raise kind(f"{path}: cannot be read ({_reason(error)})") from error
    if not stat.S_ISREG(found.st_mode):
        what = _KINDS.get(stat.S_IFMT(found.st_mode), "no regular file")
        raise kind(f"{path}: cannot be read ({what}); give a file")
    if found.st_size > most:
        raise kind(
            f"{path}: has {found.st_size} bytes, more than the {most} that are read of such a file;"
            " is it the right one?"
        )
    return path


def is_file(path: Path) -> bool:
    """Whether something that is no folder lies there; False also where the name cannot be one.

    Parameters
    ----------
    path : Path
    """
    try:
        return not stat.S_ISDIR(os.stat(path).st_mode)
    except (OSError, ValueError):
        return False


def read_bytes(
    path: Path, count: int = -1, *, most: int = _MOST_BYTES, kind: type[InputError] = RecordError
) -> bytes:
    """The first bytes of a file, or all of them.

    Parameters
    ----------
    path : Path
    count : int                     bytes to read; -1: all
    most, kind                      as `checked_file`

    Raises
    ------
    InputError of that kind         as `checked_file`; not readable
    """
    try:
        with checked_file(path, most=most, kind=kind).open("rb") as file:
            return file.read(count)
    except OSError as error:
        raise kind(f"{path}: cannot be read ({_reason(error)})") from error


@contextmanager
def damage(
    path: Path,
    cure: str,
    *,
    what: str = "is damaged or cut off",
    kind: type[InputError] = RecordError,
) -> Iterator[None]:
    """Turn whatever a reader of others runs into within the block into a message.

    Parameters
    ----------
    path : Path                     the file that is read
    cure : str                      what to do about a file with missing or wrong bytes
    what : str                      what is wrong with it
    kind : class                    of the error

    Raises
    ------
    PalpateError                    as it is
    InputError of that kind         in place of what the reader raised
    """
    try:
        # Some print what is wrong before they raise.
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            yield
    except PalpateError:
        raise
    # They raise whatever their parsing came across, and one of them ends the process.
    except (Exception, SystemExit) as error:
        raise kind(f"{path}: {what} ({_reason(error)}); {cure}") from error


@contextmanager
def stored_arrays(
    path: Path, cure: str, *, what: str = "is damaged or cut off", most: int = _MOST_BYTES
) -> Iterator[dict[str, np.ndarray]]:
    """The arrays of an NPZ file, and messages about whatever is wrong with them within the block.

    Nothing is read before the sizes are known: a few bytes can be packed gigabytes.

    Parameters
    ----------
    path : Path
    cure, what : str                as `damage`
    most : int                      bytes that the arrays of such a file take at most

    Yields
    ------
    dict of str to array            by name

    Raises
    ------
    PalpateError                    as the block raises it
    RecordError                     not there, no regular file, too large, no NPZ file, damaged; in
                                    place of what the block raised
    """
    read_bytes(path, 0, most=most)
    with damage(path, cure, what=what):
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            size = sum(member.file_size for member in members)
            if size > most:
                raise RecordError(
                    f"{path}: its arrays take {size} bytes, more than the {most} that are read of"
                    " such a file; is it the right one?"
                )
            arrays = {}
            for member in members:
                with archive.open(member) as packed:
                    arrays[member.filename.removesuffix(".npy")] = _array(packed, member.file_size)
        yield arrays


def parse_array(content: bytes) -> np.ndarray:
    """The array of an NPY file.

    Parameters
    ----------
    content : bytes                 the whole file

    Returns
    -------
    array                           of any shape, of numbers or texts

    Raises
    ------
    ValueError                      no such file, damaged, another length than its head says
    """
    return _array(BytesIO(content), len(content))


def _array(file: IO[bytes] | BufferedIOBase, size: int) -> np.ndarray:
    """An array in NPY format of so many bytes, which are counted before memory is taken."""
    heads = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    version = np.lib.format.read_magic(file)
    if version not in heads:
        raise ValueError(f"its arrays have version {version} of the format NPY")
    shape, _, kind = heads[version](file)
    said, held = math.prod(shape) * max(kind.itemsize, 1), size - file.tell()
    if said != held and not kind.hasobject:
        raise ValueError(f"an array says that it has {said} bytes, and holds {held}")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)


def _reason(error: BaseException) -> str:
    """One short line about an error of another program."""
    text = getattr(error, "strerror", None) or " ".join(str(error).split())
    if not text or isinstance(error, (KeyError, RecursionError, SystemExit)):
        text = f"{type(error).__name__} {text}".strip()
    return text if len(text) <= 160 else f"{text[:100]} ... {text[-50:]}"

"""A session's files as one package that travels to where it is worked on, and is checked there."""

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from palpate.errors import RecordError
from palpate.files import read_bytes
from palpate.records import disk_errors, session_files


@dataclass(frozen=True, slots=True, eq=False)
class Package:
    """Files with their sums.

    Attributes
    ----------
    files : mapping of str to bytes     by their paths, with `/`, from one folder
    sums : mapping of str to str        SHA-256 of each, 64 hexadecimal digits
    """

    files: Mapping[str, bytes]
    sums: Mapping[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class PackedSession:
    """A session's files, and what they are called where they come from.

    Attributes
    ----------
    package : Package
    session : str                   the session file in the package
    root : str                      the folder that the package's paths start from
    """

    package: Package
    session: str
    root: str


def packed(files: Mapping[str, bytes]) -> Package:
    """Files with their sums.

    Parameters
    ----------
    files : mapping of str to bytes
    """
    ordered = dict(sorted(files.items()))
    sums = {name: hashlib.sha256(content).hexdigest() for name, content in ordered.items()}
    return Package(ordered, sums)


def pack_session(path: Path) -> PackedSession:
    """All files of a session, read into memory.

    Parameters
    ----------
    path : Path                     folder of the session, or a session file in it

    Returns
    -------
    PackedSession                   with the name of the session's folder in every path: it may
                                    stand for the session's own name

    Raises
    ------
    RecordError                     no session, or one of its files cannot be read
    """
    session = Path(os.path.realpath(path / "session.toml" if path.is_dir() else path))
    files = [Path(os.path.realpath(file)) for file in session_files(session)]
    root = Path(os.path.commonpath([session.parent.parent, *(file.parent for file in files)]))
    content = {file.relative_to(root).as_posix(): read_bytes(file) for file in files}
    return PackedSession(packed(content), session.relative_to(root).as_posix(), str(root))


def unpack(package: Package, folder: Path) -> None:
    """Write the files of a package.

    Parameters
    ----------
    package : Package
    folder : Path                   that the paths start from; exists

    Raises
    ------
    RecordError                     a file has arrived damaged, leads out of the folder, or cannot
                                    be written
    """
    check_package(package)
    for name, content in package.files.items():
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise RecordError(f"{name}: leads out of the folder that it is unpacked in")
        target = folder / name
        with disk_errors(folder):
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)


def check_package(package: Package) -> None:
    """Refuse a package whose files are not those that were sent.

    Parameters
    ----------
    package : Package

    Raises
    ------
    RecordError                     a file was damaged on its way
    """
    if packed(package.files).sums != package.sums:
        raise RecordError(
            "files were damaged on their way between two machines: their sums are not those with"
            " which they left; run again"
        )

"""A session's files as one package that is sent to a worker and verified there."""

import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from palpate.errors import RecordError
from palpate.files import read_bytes
from palpate.records import disk_errors, path_below, session_files


@dataclass(frozen=True, slots=True, eq=False)
class Package:
    """Files with their checksums.

    Attributes
    ----------
    files : mapping of str to bytes     content by path, with `/`, relative to one folder
    sums : mapping of str to str        SHA-256 of each, 64 hexadecimal digits
    """

    files: Mapping[str, bytes]
    sums: Mapping[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class PackedSession:
    """A session's files, with their original location.

    Attributes
    ----------
    package : Package
    session : str                   path of the session file in the package
    root : str                      original folder that the package's paths are relative to
    """

    package: Package
    session: str
    root: str


def pack_files(files: Mapping[str, bytes]) -> Package:
    """Make a package of files, with their checksums.

    Parameters
    ----------
    files : mapping of str to bytes     content by path

    Returns
    -------
    Package                         sorted by path
    """
    ordered = dict(sorted(files.items()))
    sums = {name: hashlib.sha256(content).hexdigest() for name, content in ordered.items()}
    return Package(ordered, sums)


def pack_session(path: Path) -> PackedSession:
    """Read all files of a session into a package.

    Parameters
    ----------
    path : Path                     folder of the session, or a session file in it

    Returns
    -------
    PackedSession                   paths include the name of the session's folder, which is the
                                    default name of the session

    Raises
    ------
    RecordError                     no session, or one of its files cannot be read
    """
    session = real_session_file(path)
    files = [Path(os.path.realpath(file)) for file in session_files(session)]
    root = Path(os.path.commonpath([session.parent.parent, *(file.parent for file in files)]))
    content = {file.relative_to(root).as_posix(): read_bytes(file) for file in files}
    return PackedSession(pack_files(content), session.relative_to(root).as_posix(), str(root))


def real_session_file(path: Path) -> Path:
    """Where the session file that a path stands for really lies, whether it is there or not.

    Parameters
    ----------
    path : Path                     folder of the session, or a session file in it

    Returns
    -------
    Path
    """
    return Path(os.path.realpath(path / "session.toml" if path.is_dir() else path))


def without_files(packed: PackedSession, files: Iterable[Path]) -> PackedSession:
    """A packed session without some of its files.

    Parameters
    ----------
    packed : PackedSession
    files : iterable of Path        in their original places; others are ignored

    Returns
    -------
    PackedSession
    """
    dropped = {Path(os.path.relpath(os.path.realpath(file), packed.root)) for file in files}
    names = [name for name in packed.package.files if Path(name) not in dropped]
    package = Package(
        {name: packed.package.files[name] for name in names},
        {name: packed.package.sums[name] for name in names},
    )
    return replace(packed, package=package)


def unpack(package: Package, folder: Path) -> None:
    """Write the files of a package.

    Parameters
    ----------
    package : Package
    folder : Path                   an existing folder, to which the paths are relative

    Raises
    ------
    RecordError                     a file that was damaged in transit, whose path leads out of the
                                    folder, or that cannot be written
    """
    check_package(package)
    for name, content in package.files.items():
        target = path_below(folder, name)
        with disk_errors(folder):
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)


def check_package(package: Package) -> None:
    """Refuse a package whose files do not match their checksums.

    Parameters
    ----------
    package : Package

    Raises
    ------
    RecordError                     a file was damaged in transit
    """
    if pack_files(package.files).sums != package.sums:
        raise RecordError(
            "files were damaged on their way between two machines: their sums are not those with"
            " which they left; run again"
        )

"""Several files that appear together or not at all."""

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from palpate.errors import RecordError


@contextmanager
def placed_files(targets: Sequence[Path]) -> Iterator[tuple[Path, ...]]:
    """Files to write to; they take their final names when the block ends well, else vanish.

    Older files of these names are replaced in the order given; where one cannot be, those before
    it are put back.

    Parameters
    ----------
    targets : sequence of Path      final names, in folders that are there

    Yields
    ------
    tuple of Path                   beside the targets, empty, under other names

    Raises
    ------
    RecordError                     one cannot be written; raised before the block runs where the
                                    folder does not allow it
    """
    finals = [Path(os.path.realpath(target)) for target in targets]
    staged = tuple(path.with_name(f".{path.name}.{os.getpid()}.partial") for path in finals)
    try:
        for path, final in zip(staged, finals, strict=True):
            try:
                path.touch()
            except OSError as error:
                raise _refusal(final, error) from error
        yield staged
        _put_in_place(staged, finals)
    finally:
        for path in staged:
            path.unlink(missing_ok=True)


def _put_in_place(staged: Sequence[Path], finals: Sequence[Path]) -> None:
    """Give every file its name; the older ones go only when all of that has worked."""
    older: list[tuple[Path, Path | None]] = []
    try:
        for path, final in zip(staged, finals, strict=True):
            backup = None
            if final.exists():
                shutil.copymode(final, path)
                backup = path.with_suffix(".older")
                final.rename(backup)
            older.append((final, backup))
            path.rename(final)
    except OSError as error:
        for done, backup in reversed(older):
            done.unlink(missing_ok=True)
            if backup is not None:
                backup.rename(done)
        raise _refusal(final, error) from error
    for _, backup in older:
        if backup is not None:
            backup.unlink()


def _refusal(path: Path, error: OSError) -> RecordError:
    return RecordError(
        f"{path}: cannot be written ({error.strerror}); nothing was changed: check the folder's"
        " rights, or write elsewhere with --out"
    )

"""A way in which what a user gives can be broken, and what Palpate must answer."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of broken input: a good example, what is done to it, the command and its answer.

    Attributes
    ----------
    name : str                      what is wrong, in a few words; no two alike
    damage : callable               gets the folder that holds a copy of the example, breaks it
    command : sequence of str       of `palpate`, run in that folder
    says : sequence of str          pieces of the message, all of which must be there
    example : str                   name of a fixture of `tests/faults/conftest.py`: a good folder
    code : int                      exit code
    """

    name: str
    damage: Callable[[Path], object]
    command: tuple[str, ...]
    says: tuple[str, ...]
    example: str = "cube"
    code: int = 2


def replaced(file: str, old: str, new: str) -> Callable[[Path], object]:
    """Damage: a piece of a text file, which must be there, is replaced by another."""

    def damage(folder: Path) -> None:
        path = folder / file
        text = path.read_text()
        assert old in text, f"{old!r} is not in {file}"
        path.write_text(text.replace(old, new, 1))

    return damage


def written(file: str, content: str | bytes) -> Callable[[Path], object]:
    """Damage: a file gets another content."""

    def damage(folder: Path) -> None:
        data = content.encode() if isinstance(content, str) else content
        (folder / file).write_bytes(data)

    return damage

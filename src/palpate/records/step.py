"""One position of an object that moves as a whole: pictures, no tool, no force."""

from dataclasses import dataclass

from palpate.errors import InputError


@dataclass(frozen=True, slots=True)
class Step:
    """One instant of a rigid-motion sequence.

    Parameters
    ----------
    name : str                      unique within its session
    images : str                    file pattern of its pictures, with `{camera}` in place of the
                                    camera's name

    Raises
    ------
    InputError                      a blank name or pattern
    """

    name: str
    images: str

    def __post_init__(self) -> None:
        for field in ("name", "images"):
            if not getattr(self, field).strip():
                raise InputError(f"{field} of a step is blank; must be a text")

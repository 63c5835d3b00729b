"""Values of the wrong type or size at every key of the files that a person writes."""

import re
from collections.abc import Callable
from pathlib import Path

from faults.kind import Kind

# What stands in the place of a value, as TOML writes it.
_VALUES = {
    "not a number": "nan",
    "infinite": "inf",
    "too large": "1e300",
    "too small": "1e-300",
    "of 400 digits": "9" * 400,
    "of 6000 hexadecimal digits": "0x" + "f" * 6000,
    "of 6000 digits": "9" * 6000,
    "a truth": "true",
    "an empty list": "[]",
    "a list in lists": "[" * 50 + "]" * 50,
    "lists in lists without end": "[" * 9000 + "]" * 9000,
    "a table": "{ a = 1 }",
    "a text of 100,000 letters": '"' + "n" * 100_000 + '"',
    "text with a control character": '"a\\u0000b"',
}
# Of a key: the piece of the message that names it; a file that cannot be parsed has a line instead,
# or what the parser says.
_UNPARSED = {"lists in lists without end": "valid TOML", "of 6000 digits": "of too many digits"}


def _valued(file: str, key: str, value: str) -> Callable[[Path], object]:
    """Damage: another value at a key, whatever its value is now."""

    def damage(folder: Path) -> None:
        path = folder / file
        text, count = re.subn(
            rf"(?m)((?:^|[ {{]){key} = )(\[\[.*?\]\]|\[.*?\]|\{{.*?\}}|[^,\n}}]+)",
            lambda number: number[1] + value,
            path.read_text(),
            count=1,
        )
        assert count == 1, f"{key} is not in {file}"
        path.write_text(text)

    return damage


def kinds_of_values(
    example: str, file: str, command: tuple[str, ...], keys: tuple[str, ...]
) -> list[Kind]:
    return [
        Kind(
            f"{file}, {key}: {what}",
            _valued(file, key, value),
            command,
            (file, _UNPARSED.get(what, key)),
            example,
        )
        for key in keys
        for what, value in _VALUES.items()
    ]


KINDS = [
    *kinds_of_values("cube", "session.toml", ("check", "."), (
        "mesh", "length_unit", "tolerance", "normal", "point", "radius", "force",
    )),
    *kinds_of_values("motion", "rig.toml", ("flow", ".", "--out", "moved"), (
        "length_unit", "size", "K", "R", "t",
    )),
    *kinds_of_values("others", "ball.toml", ("lab", "ball.toml", "made"), (
        "shape", "radius", "edge", "element", "young_modulus", "distance", "columns", "samples",
        "depth", "steps",
    )),
    *kinds_of_values("others", "pose.toml", (
        "import", "vic3d", "vic3d.txt", ".", "--probe", "n01", "--replace", "--to-object", "pose.toml",
    ), ("length_unit", "R", "t")),
]  # fmt: skip

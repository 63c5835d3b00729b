"""Kinds of displacements, errors and names that no measurement has."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from faults.kind import Kind, replaced, written

_ROWS = [
    f"{x},{y},0.04,{3e-4 + 1e-3 * x:.7f},1e-6,{-4e-4 + 1e-3 * y:.7f}"
    for x in (0.005, 0.015, 0.03)
    for y in (0.004, 0.016, 0.033)
]
_HEAD = "x,y,z,ux,uy,uz"
_FORCE = "force = [0, 0, -1.2]"


def _table(*rows: str, more: str = "") -> Callable[[Path], object]:
    """Damage: these rows under the header and further columns."""
    return written("n01.csv", "\n".join([_HEAD + more, *rows]) + "\n")


def _sigma(value: str) -> Callable[[Path], object]:
    """Damage: all points have one standard deviation but the third, which has another."""
    rows = [f"{row},{value if k == 2 else '1e-5'}" for k, row in enumerate(_ROWS)]
    return _table(*rows, more=",sigma")


def _separated(by: str) -> Callable[[Path], object]:
    return written("n01.csv", "\n".join([_HEAD, *_ROWS]).replace(",", by))


def _under_load(folder: Path) -> None:
    """Damage: places under load where displacements belong."""
    rows = np.loadtxt(folder / "n01.csv", delimiter=",", skiprows=1)
    rows[:, 3:6] += rows[:, :3]
    head = _HEAD + ",sigma"
    np.savetxt(folder / "n01.csv", rows, delimiter=",", header=head, comments="")


def _said(more: str) -> Callable[[Path], object]:
    """Damage: a line more in the probing."""
    return replaced("session.toml", _FORCE, f"{_FORCE}\n{more}")


def _error(line: str, sensor: str = "") -> Callable[[Path], object]:
    """Damage: a line of [errors]; with a sensor, the first probing names it."""
    named = f"force_sensor = {sensor}\n" if sensor else ""
    return replaced("session.toml", "[[probe]]", f"[errors]\n{line}\n[[probe]]\n{named}")


# What is wrong, damage, pieces of the message.
_CHECKED = [
    *(
        (f"a sigma of {value}", _sigma(value), ("n01.csv: line 4: the standard", f" is {said} m"))
        for value, said in {
            "0": "0", "-1e-6": "-1e-06", "nan": "nan", "": "nan", "1": "1", "1e-15": "1e-15",
            "1e-28": "1e-28",
        }.items()
    ),
    ("one of three standard deviations", _table(*(f"{row},1e-5" for row in _ROWS), more=",sx"),
     ("n01.csv: has sx only",)),
    ("semicolons", _separated(";"), ("n01.csv", "separated by semicolons", "by commas")),
    ("tabs", _separated("\t"), ("n01.csv", "separated by tabs", "by commas")),
    ("places under load", _under_load, ("'n01'", "ux,uy,uz of n01.csv", "Take x,y,z off")),
    *(
        (f"a vertex of {value}", _table(*(f"{row},{value}" for row in _ROWS), more=",vertex"),
         (f"palpate: n01.csv: line 2: vertex is {value}",))
        for value in ("1.5", "-1", "9999")
    ),
    ("another vertex", _table(*(f"{row},0" for row in _ROWS), more=",vertex"),
     ("palpate: n01.csv: line 10: vertex 0", "Leave the column 'vertex' out")),
    ("a tip that did not move", _said("tip_displacement = [0, 0, 0]"),
     ("'n01'", "tip_displacement is exactly zero", "leave it out")),
    ("an offset of no tip", _said('tip_displacement_offset_std = "1 mm"'),
     ("'n01' tip_displacement_offset_std", "without tip_displacement")),
    ("a tip known to a metre", _said(
        "tip_displacement = [0, 0, -4e-4]\ntip_displacement_std = 1.0"),
     ("tip_displacement_std of 'n01' is 1 m", "more than the body of 0.0693 m")),
    ("a contact known to a metre", replaced("session.toml", "radius = 0.006",
                                            "radius = 0.006, point_std = 1"),
     ("point_std of 'n01' is 1 m", "more than the body of 0.0693 m")),
    ("contacts known to 10 cm", _error('contact_point = "10 cm"'),
     ("contact point of [errors] is 0.1 m", "more than the body of 0.0693 m")),
    ("a pose known to a metre", _error('pose = { translation = "1 m" }'),
     ("pose translation of [errors] is 1 m", "more than the body of 0.0693 m")),
    ("gains by sensor where no probing names one", _error("force_gain = { gauge = 0.01 }"),
     ("[errors] force_gain", "no probing names its sensor", 'force_sensor = "gauge"')),
    ("a gain of a sensor that no probing names", _error("force_gain = { scale = 0.01 }", '"gauge"'),
     ("[errors] force_gain: unknown key 'scale'", "(allowed: gauge)")),
    ("a gain of a sensor in newtons", _error('force_gain = { gauge = "1 N" }', '"gauge"'),
     ("[errors] force_gain gauge: is '1 N'", '"1 %"')),
    ("a gain of a sensor that is larger than any", _error("force_gain = { gauge = 0.9 }", '"gauge"'),
     ("the force gain of 'gauge' is 0.9", "at most 0.5")),
    ("a sensor that is a number", _error("force_gain = 0.01", "7"),
     ("[[probe]] 'n01' force_sensor: is 7", "text in quotes")),
    ("a sensor whose name has a line break", _error("force_gain = 0.01", '"a\\nb"'),
     ("[[probe]] 'n01' force_sensor", "no line break")),
    *(
        (f"a probing called {name!r}", replaced("session.toml", '"n01"', name),
         ("[[probe]] number 1 name", says))
        for name, says in {
            '"a\\nb"': "no line break", '"\\u202Eabc"': "control character",
            '"\\u001b[31m"': "control character", '""': "must not be empty", '" "': "not be empty",
        }.items()
    ),
    ("a session called by two lines", replaced("session.toml", '"a [bold] cube"', '"a\\nb"'),
     ("session.toml: name", "no line break")),
    ("a mesh without a name", replaced("session.toml", '"mesh.ply"', '""'),
     ("[object] mesh: is ''; must not be empty",)),
]  # fmt: skip
KINDS = [Kind(name, damage, ("check", "."), says) for name, damage, says in _CHECKED]

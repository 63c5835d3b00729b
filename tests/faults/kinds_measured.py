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


def _series(
    *rows: str, head: str = "t,fx,fy,fz,tz,tx,ty", more: str = ""
) -> Callable[[Path], None]:
    """Damage: a series of these rows."""

    def damage(folder: Path) -> None:
        (folder / "n01_series.csv").write_text("\n".join([head, *rows]) + "\n")
        _said(f'series = "n01_series.csv"\n{more}')(folder)

    return damage


_RISING = [f"{t},0,0,{-0.6 * min(t, 2)},{-2e-4 * min(t, 2)},0,0" for t in range(8)]
_NAMED = [f"{t},0,0,{-0.6 * min(t, 2)},{'n01.csv' if t > 2 else ''}" for t in range(8)]
_FRAMES = "t,fx,fy,fz,displacement"


def _of_no_force(folder: Path) -> None:
    """Damage: a series of a probing whose only load is a pressure."""
    _series(*_RISING)(folder)
    load = "[[probe.load]]\ncontact = { triangles = 'faces.txt' }\npressure = 100.0"
    (folder / "faces.txt").write_text("0\n1\n")
    text = (folder / "session.toml").read_text()
    lines = [line for line in text.splitlines() if not line.startswith(("contact", "force"))]
    (folder / "session.toml").write_text("\n".join([*lines, load]) + "\n")


def _to_infinity(folder: Path) -> None:
    """Damage: a frame with an infinite displacement."""
    (folder / "far.csv").write_text(f"{_HEAD}\n0.04,0.04,0.04,inf,0,0\n")
    _series(*_NAMED, "8,0,0,-1.2,far.csv", head=_FRAMES)(folder)


def _other_points(folder: Path) -> None:
    """Damage: a series with a frame of points that the probing does not have."""
    (folder / "far.csv").write_text(f"{_HEAD}\n0.001,0.0015,0.0172,0,0,-1e-4\n")
    _series(*_NAMED, "8,0,0,-1.2,far.csv", head=_FRAMES)(folder)


# What is wrong, damage, pieces of the message.
_CHECKED = [
    ("a series out of order", _series(*_RISING[:4], *_RISING[:2]),
     ("n01_series.csv: row 5 is at 0 s, after 3 s", "the times must increase")),
    ("a series that begins under load", _series(*_RISING[2:]),
     ("n01_series.csv: begins at 1.2 N of 1.2 N", "begin before that")),
    ("a series without motion", _series(*(f"{t},0,0,{-0.6 * min(t, 2)}" for t in range(8)), head="t,fx,fy,fz"),
     ("n01_series.csv", "has forces and no motion")),
    ("a series without a force", _series(*_RISING, head="t,fx,fy,f,tz,tx,ty"),
     ("n01_series.csv: the column 'fz' is missing",)),
    ("a series longer than anybody waits for", _series(*200_001 * ["0,0,0,0,0,0,0"]),
     ("n01_series.csv: has 200001 rows", "200000 at most", "fewer of the hold")),
    ("a series in another unit", _series(*_RISING, head="t,fx [mN],fy [mN],fz [mN],tz,tx,ty"),
     ("the force at 7 s is", "they are the same push")),
    ("a series with a gap in a row", _series(*_RISING, "8,0,0,,-4e-4,0,0"),
     ("n01_series.csv: line 10: t, fx, fy and fz must be numbers",)),
    ("a series that ends in infinity", _series(*_RISING, "8,0,0,-1.2,-4e-4,-inf,0"),
     ("n01_series.csv: line 10: column 'tx' holds '-inf'",)),
    ("a frame that moved to infinity", _to_infinity, ("far.csv: line 2: column 'ux' holds 'inf'",)),
    ("an instant after the series", _series(*_RISING, more='measured_at = "9 s"'),
     ("'n01' measured_at: is 9 s", "7 s at most")),
    ("a series of no force", _of_no_force, ("'n01' series", "the probing has none")),
    ("an instant of no series", _said('measured_at = "9 s"'),
     ("'n01' measured_at", "given without series")),
    ("a frame that is not there", _series(*_NAMED, "8,0,0,-1.2,n02.csv", head=_FRAMES),
     ("n01_series.csv: line 10: no such file", "n02.csv")),
    ("a frame of other points", _other_points,
     ("far.csv: none of its points is measured and one of", "the same points")),
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

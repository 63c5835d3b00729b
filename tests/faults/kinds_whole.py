"""Kinds of surfaces that hold less than they say, of rigs, records and options that contradict."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from faults.kind import Kind, replaced, written

from palpate.records import read_rig

_CHECK = ("check", ".")
_CYLINDER = ("compression", "c.csv", "--diameter", "50mm", "--height", "30mm")


def _mesh(file: str, change: Callable[[bytes], bytes], *says: str) -> Kind:
    """The session's mesh is this file, its bytes changed."""

    def damage(folder: Path) -> None:
        session = folder / "session.toml"
        session.write_text(session.read_text().replace("mesh.ply", file))
        (folder / file).write_bytes(change((folder / file).read_bytes()))

    return Kind(f"{file}: {says[0]}", damage, _CHECK, (f"{file}: cannot be read", *says), "meshes")


def _line(text: str) -> Callable[[bytes], bytes]:
    """One more line at the end."""
    return lambda content: content + f"\n{text}\n".encode()


def _without(count: int) -> Callable[[bytes], bytes]:
    return lambda content: b"\n".join(content.rstrip().split(b"\n")[:-count]) + b"\n"


def _record(pairs: np.ndarray, *says: str, options: tuple[str, ...] = ()) -> Kind:
    """A compression record of these millimetres and newtons."""
    text = "\n".join(f"{a:.6g},{b:.6g}" for a, b in pairs)
    return Kind(f"a record: {says[0]}", written("c.csv", text), (*_CYLINDER, *options),
                ("c.csv", *says))  # fmt: skip


def _timed(order: slice | np.ndarray, *says: str) -> Kind:
    """A compression record with a column of times, its rows in another order."""
    rows = np.column_stack([np.arange(len(_PRESSED)), _PRESSED])[order]
    text = "Time (s),Compression (mm),Load (N)\n" + "\n".join(
        ",".join(f"{x:.6g}" for x in row) for row in rows
    )
    return Kind(f"a record: {says[0]}", written("c.csv", text), _CYLINDER, ("c.csv", *says))


def _one_place(folder: Path) -> None:
    """Damage: the second camera stands where the first does, and looks elsewhere."""
    text = (folder / "rig.toml").read_text()
    first, second = (
        camera.T_camera_object[:3, 3] for camera in read_rig(folder / "rig.toml").cameras
    )
    assert str(second.tolist()) in text
    (folder / "rig.toml").write_text(text.replace(str(second.tolist()), str(first.tolist())))


_PRESSED = np.column_stack([np.linspace(0.0, 3.0, 60), np.linspace(0.0, 60.0, 60)])
_SHUFFLED = np.random.default_rng(1).permutation(len(_PRESSED))
_POKE = ("poke", ".", "--at", "0.02", "0.02", "0.04", "--force", "0", "0", "-1",
         "--poisson-ratio", "0.3")  # fmt: skip


def _option(*command: str, says: tuple[str, ...], example: str = "cube") -> Kind:
    return Kind(" ".join(command), lambda _: None, command, says, example)


KINDS = [
    *(
        _mesh("cube.obj", _line(text), f"'{text}' is no vertex or face of it")
        for text in ("f 1 2", "f 1", "f", "vv 1 2 3", "face 1 2 3", "v 1 2", "1 2 3", "f 1/ 2/ x")
    ),
    _mesh("cube.obj", _line("f 1 2 999"), "the face names vertex 999, of"),
    _mesh("cube.off", _line("3 0 1 2"), "it says that it has 74 rows, and holds 75"),
    _mesh("cube.off", _without(3), "it says that it has 74 rows, and holds 71"),
    _mesh("text.ply", _without(1), "rows, and holds"),
    _mesh("text.ply", _without(30), "rows, and holds "),
    _mesh("text.ply", _line("3 0 1 2"), "it says that it has"),
    _mesh("binary.stl", lambda content: content[:-30], "triangles, and holds"),
    _mesh("binary.stl", lambda content: content[:-50], "48 triangles, and holds 47"),
    _mesh("binary.stl", lambda content: content + bytes(50), "48 triangles, and holds 49"),
    _mesh("text.stl", lambda content: content[: len(content) // 2], "endsolid, is missing"),
    Kind("two cameras at one place", _one_place, _CHECK,
         ("rig.toml: cameras 'c0' and 'c1' stand at the same place", "no depth"), "pictured"),
    _record(_PRESSED * [1.0, 1e6], "30.6 GPa, more than any steel bears"),
    _record(_PRESSED * [1e3, 1.0], "reaches 3 m, the cylinder is 0.03 m high"),
    _record(_PRESSED[:, ::-1], "reaches 0.06 m, the cylinder is 0.03 m high"),
    _record(_PRESSED, "reaches 3 m, the cylinder is 0.03 m", options=("--displacement-unit", "m")),
    _record(_PRESSED * [1.0, 0.0], "the force does not rise"),
    _timed(slice(None, None, -1), "line 3: the times do not ascend: 'Time (s)' goes from 59 to 58"),
    _timed(_SHUFFLED, "the times do not ascend", "sort the rows by time"),
    _record(_PRESSED[::-1], "it must grow: put the rows in the order of time"),
    _record(_PRESSED * [1.0, 1e-9], "Young's modulus comes out as", "check the units of force"),
    *(
        Kind(f"a cylinder of metres: {size}", written("c.csv", f"{size}: 5m\nheight: 5m\n0,0\n1,1\n"),
             ("compression", "c.csv"), (f'c.csv: the {size.lower()} is "5m"', "from 0.1 mm to 2 m"))
        for size in ("Diameter", "Height")
    ),
    *(
        _option(*_POKE, option, value, says=(f"{option} is {value}", "softest gel to diamond"))
        for option in ("--young-modulus", "--shear-modulus")
        for value in ("-5", "0", "1e-20", "1e+30")
    ),
    _option(*_POKE, "--young-modulus", "5e4", "--radius", "1",
            says=("wider than the body", "0.0693 m across")),
    *(
        _option(*command, says=(f"{command[1]}: is no session file", "palpate init"))
        for command in (("check", "mesh.ply"), ("check", "n01.csv"), ("flow", "mesh.ply"))
    ),
    _option("campaign", "run", "list.txt", "--workers", "1000000",
            says=("--workers is 1000000", "for every core"), example="bench"),
    Kind("one view twice", replaced("scan/scan.toml", "[[view]]",
         '[[view]]\nfile = "top.xyz"\neye = [20, 20, 500]\n[[view]]'),
         ("scan", "scan", "--out", "made"),
        ("[[view]] number 2 file: top.xyz is another view already",), "bench"),
    Kind("a support of no planes", replaced(
        "session.toml", "plane = { point = [0, 0, 0], normal = [0, 0, 1], tolerance = 1e-6 }",
        "plane = []"), _CHECK, ("[support] plane: is an empty list",)),
    Kind("a date for a tolerance", replaced("session.toml", "tolerance = 1e-6",
         "tolerance = 2020-01-01"), _CHECK, ("tolerance: is 2020-01-01; must be",)),
]  # fmt: skip

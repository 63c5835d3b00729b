"""Kinds of broken results of other programs, and of a robot's pokes."""

import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
from faults.kind import Kind, written

_HEAD = "u,v,w,r1r2 ZNCC,r1t1 ZNCC,r1t2 ZNCC,ref_x,ref_y,ref_z"
_ROWS = [f"0.1,0,-0.2,0.9,0.95,0.9,{5 * i},{7 * i % 40},40" for i in range(1, 8)]


def _table(*rows: str, head: str = _HEAD) -> Callable[[Path], object]:
    """Damage: a table of OpenCorr of these rows."""

    def damage(folder: Path) -> None:
        (folder / "n.csv").write_text("\n".join([head, *rows]) + "\n")

    return damage


def _kind(name: str, damage: Callable[[Path], object], *says: str, options: str = "") -> Kind:
    words = ("import", "opencorr", "n.csv", ".", "--probe", "n01", "--replace", *options.split())
    return Kind(name, damage, words, says)


def _poked(name: str, damage: Callable[[Path], object], *says: str, options: str = "") -> Kind:
    file = "p" + name[name.rindex(".") :]
    words = ("import", "pokes", file, "--thickness", "20mm", *options.split())
    more = () if "--tool-radius" in options else ("--tool-radius", "6mm")
    return Kind(f"pokes: {name}", damage, (*words, *more), says)


def _bomb(folder: Path) -> None:
    """An array that says that it has 24 gigabytes."""
    head = "{'descr': '<f8', 'fortran_order': False, 'shape': (3000000000,), }".ljust(117) + "\n"
    with zipfile.ZipFile(folder / "p.npz", "w") as archive:
        archive.writestr("x.npy", b"\x93NUMPY\x01\0v\0" + head.encode() + bytes(1000))


def _hollow(folder: Path) -> None:
    """The same in HDF5, which keeps nothing of it."""
    with h5py.File(folder / "p.mat", "w") as file:
        file.create_dataset("x", shape=(10**10,), chunks=(1000,), dtype="f8")


def _arrays(**arrays: object) -> Callable[[Path], object]:
    return lambda folder: np.savez(folder / "p.npz", **arrays)


_POKES = "x,y,z,force\n" + "1,2,-1,-0.5\n" * 30


def _pushes(power: float, normal: str = "", head: str = "x,y,z,force") -> Callable[[Path], object]:
    """Damage: four pokes a centimetre apart, all but on a line, with a power of the depth."""
    head += ",nx,ny,nz" if normal else ""
    rows = [
        f"{10 * k},{1e-3 * (k % 2)},{-d},{0.02 * d**power}{normal}"
        for k in range(4) for d in range(6)
    ]  # fmt: skip
    return written("p.csv", "\n".join([head, *rows]) + "\n")


_STRONG = "x,y,z,force\n" + "".join(
    f"{10 * k},{1e-3 * (k % 2)},{-d},{2e9 * d**1.5}\n" for k in range(4) for d in range(6)
)
_POOR = [row.replace("0.95", "0.07") for row in _ROWS]
_KEPT = ["not one of its 7 points was measured"]

KINDS = [
    _kind("all matches hardly correlate", _table(*_POOR), *_KEPT, "7 correlate by less than 0.75"),
    _kind(
        "a least score above all",
        _table(*_ROWS),
        "7 correlate by less than 0.99",
        "--min-score",
        options="--min-score 0.99",
    ),
    _kind("a least score in per cent", _table(*_ROWS), "-1 to 1", options="--min-score 75"),
    _kind(
        "a least score of nan", _table(*_ROWS), '--min-score is "nan"', options="--min-score nan"
    ),
    _kind(
        "a least score where none is stated",
        _table("0.1,0,0,5,5,40", head="u,v,w,ref_x,ref_y,ref_z"),
        "has no correlation",
        options="--min-score 0.5",
    ),
    _kind("codes of failure everywhere", _table(*[r.replace("0.95", "-3") for r in _ROWS]), *_KEPT),
    _kind(
        "a score in per cent",
        _table(*_ROWS[:2], _ROWS[2].replace("0.95", "95")),
        "n.csv: line 4: r1t1 ZNCC is 95; must be a correlation, 1 at most",
    ),
    _kind("a planar table", _table("0.1,0,5,5", head="u,v,x,y"), "'w' is missing", "2-D"),
    _poked("no force in p.csv", written("p.csv", "x,y,z\n1,2,3\n"), "p.csv: has no column of the force"),
    _poked("one place in p.csv", written("p.csv", _POKES), "p.csv: 0 of 1 pokes have contact"),
    _poked("no force measured in p.csv", written("p.csv", _POKES.replace("-0.5", "nan")),
           "p.csv: not one of its 30 rows has all its numbers"),
    _poked("three metres for p.csv", written("p.csv", _POKES), "--tool-radius", "3 m", "like 3mm",
           options="--tool-radius 3"),
    _poked("a body of twenty metres for p.csv", _pushes(1.5), "--margin is 20 m",
           options="--margin 20"),
    _poked("metres in p.csv", _pushes(1.5), "into a body 20 mm thick", "--length-unit",
           options="--length-unit m --tool flat"),
    _poked("a ball of a micrometre for p.csv", _pushes(1.5), "deeper than the ball's radius",
           "0.001 mm", "--tool-radius", options="--tool-radius 1um"),
    _poked("pascals for newtons in p.csv", written("p.csv", _STRONG), "which no material has",
           "p.csv: the pokes mean a Young's modulus of", "which column is the force"),
    _poked("normals that point inward in p.csv", _pushes(1.5, ",0,0,-1"), "p.csv: in 4 of 4 pokes",
           "normals must point out of the body"),
    _poked("normals of no length in p.csv", _pushes(1.5, ",0,0,0"), "p.csv: a normal is the zero"),
    _poked("a sample a poke in p.csv", written("p.csv", "x,y,z,force\n0,0,-1,1\n9,0,-1,1\n"),
           "p.csv: poke 1 of 2 has 1 samples; at least 3", "--poke-column"),
    _poked("two columns of one name in p.csv", _pushes(1.5, head="x,y,x,force"),
           "p.csv: the column 'x' is there 2 times; export one"),
    _poked("pokes on a line in p.csv", _pushes(1.5), "are on a line", "--margin",
           options="--margin 0mm"),
    _poked("a force that does not rise in p.csv", _pushes(0.0), "0 of 4 pokes have contact"),
    _poked("no rows in p.npz", _arrays(position=np.zeros((0, 3)), force=np.zeros(0)),
           "p.npz: not one of its 0 rows"),
    _poked("a bomb p.npz", _bomb, "p.npz: is damaged", "holds 1000"),
    _poked("complex numbers in p.npz", _arrays(x=np.zeros(9) + 1j, y=np.zeros(9)), "p.npz: has no column"),
    _poked("no arrays in p.npz", _arrays(), "p.npz: holds no columns"),
    _poked("a hollow p.mat", _hollow, "p.mat: is damaged", "10000000000"),
]  # fmt: skip

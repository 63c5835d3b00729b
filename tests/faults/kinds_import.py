"""Kinds of broken results of other programs."""

from collections.abc import Callable
from pathlib import Path

from faults.kind import Kind

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
]

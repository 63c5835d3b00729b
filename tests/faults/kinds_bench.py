"""What can lie in the place of a file, and odd options, for the commands around a fit."""

import sqlite3
from pathlib import Path

import cv2
import numpy as np
from faults.kind import Kind, replaced, written
from faults.kinds_files import PLACES, Damage
from faults.kinds_values import kinds_of_values

from palpate.geometry import TriangleMesh, read_mesh, write_mesh

_SQUARES = ("--columns", "7", "--rows", "5", "--square", "16mm")
_CHESSBOARD = ("calibrate", "boards", "--target", "chessboard", *_SQUARES, "--out", "made")
_OBJECT = ("calibrate", "object", "rest_{camera}.png", "mesh.ply", "--rig", "rig.toml", "--out",
           "made")  # fmt: skip
_SCAN = ("scan", "scan", "--out", "made")
_MESH = ("mesh", "mesh.ply", "--near", "near.csv", "--out", "made")
_EXPORT = ("export", "result", "--to", "obj", "--out", "made")
_BOARD_FILE = ("calibrate", "board", "made.png")
_EDGE = ("export", "result", "--to", "obj", "--edge")
_REPORT = ("report", "result", "--out", "made.html")
_PLAN = ("lab", "plan", "pictured", "--young-modulus", "50kPa")
_RUN = ("campaign", "run", "list.txt", "--out", "made")
_THREE = "v 0 0 0\nv 0.04 0 0\nv 0 0.04 0\nf 1 2 3\n"
_SHOWN = ("--screenshot", "made.png")
_TABLES = tuple(("campaign", command, "many") for command in ("status", "table", "plot"))
# What reads a file; what is read besides it is good. A word of the message besides the name.
_READERS: dict[str, tuple[tuple[tuple[str, ...], ...], str]] = {
    "boards/c0/01.png": ((_CHESSBOARD,), ""),
    "rest_c1.png": ((_OBJECT,), "rest_c1.png"),
    "mesh.ply": ((_OBJECT, _MESH), "mesh.ply"),
    "rig.toml": ((_OBJECT,), "rig.toml"),
    "rig_covariance.npz": (((*_OBJECT, "--refine"),), "rig_covariance.npz"),
    "scan/scan.toml": ((_SCAN,), "scan.toml"),
    "scan/top.xyz": ((_SCAN,), "top.xyz"),
    "near.csv": ((_MESH, (*_SCAN, "--near", "near.csv")), "near.csv"),
    "list.txt": ((_RUN,), "list.txt"),
    "many/campaign.sqlite": (_TABLES, "campaign.sqlite"),
    "result/estimate.json": ((_EXPORT, _REPORT, ("view", "result", *_SHOWN)), "estimate.json"),
    "result/surface.npz": ((_REPORT, ("view", "result", *_SHOWN)), "surface.npz"),
    "result/inputs.txt": ((_EXPORT,), "inputs.txt"),
    "result/contents.txt": ((_REPORT, _EXPORT), "result"),
    "cube/session.toml": ((_EXPORT, ("view", "result", *_SHOWN), ("plan", "cube")), "session"),
    "cube/mesh.ply": ((("view", "cube", *_SHOWN), ("plan", "cube")), "mesh.ply"),
    "cube/n01.csv": ((("view", "cube", *_SHOWN), ("plan", "cube")), "n01.csv"),
    "pictured/rig.toml": ((_PLAN,), "rig.toml"),
}
# A view less, a rig whose lengths nothing is known of, and a table with nothing behind it are good.
_GOOD = {
    ("boards/c0/01.png", "is not there"): "no board",
    ("rig_covariance.npz", "is not there"): "features in common",
    ("many/campaign.sqlite", "has a terabyte"): None,
}


def _spoilt(name: str, damage: Damage) -> Damage:
    return lambda folder: damage(folder / name)


def _kind(command: tuple[str, ...], name: str, where: str, damage: Damage, word: str) -> Kind:
    title = f"{' '.join(command[:2])}: {name} {where}"
    return Kind(title, _spoilt(name, damage), command, (word,), "bench")


def _option(damage: Damage | None, *command: str, says: str) -> Kind:
    title = f"{' '.join(command)}: {says[:20]}"
    return Kind(title, damage or (lambda _: None), command, (says,), "bench")


def _listed(text: str | bytes, *says: str) -> Kind:
    return Kind(f"a list of sessions: {text[:30]!r}", written("list.txt", text), _RUN,
                ("list.txt", *says), "bench")  # fmt: skip


def _without_table(folder: Path) -> None:
    """Damage: a table of another program."""
    (folder / "many" / "campaign.sqlite").unlink()
    with sqlite3.connect(folder / "many" / "campaign.sqlite") as table:
        table.execute("CREATE TABLE tunes (name TEXT)")


def _packed_zeros(folder: Path) -> None:
    """Damage: a covariance that is a few kilobytes on the disk, and 72 MB."""
    numbers = np.zeros(3000)
    np.savez_compressed(
        folder / "rig_covariance.npz",
        format="palpate-rig-covariance/1",
        names=[f"n{k}" for k in range(len(numbers))],
        value=numbers,
        covariance=np.zeros((len(numbers), len(numbers))),
    )


def _thousandfold(folder: Path) -> None:
    """Damage: the mesh in millimetres."""
    mesh = read_mesh(folder / "mesh.ply")
    write_mesh(folder / "mesh.ply", TriangleMesh(1e3 * mesh.vertices, mesh.triangles))


def _three_pictures(folder: Path) -> None:
    """Damage: a TIFF of three pages."""
    grey = cv2.imread(str(folder / "boards" / "c0" / "01.png"))
    _, pages = cv2.imencodemulti(".tif", [grey] * 3)
    (folder / "boards" / "c0" / "01.png").write_bytes(pages.tobytes())


_BOARD = ("calibrate", "board", "made.pdf")
_POKE = ("poke", "cube", "--force", "0", "0", "-1", "--at", "0.02", "0.02", "0.04",
         "--young-modulus", "5e4", "--poisson-ratio", "0.3")  # fmt: skip
_TARGETS = {
    "chessboard": "3 to 1000", "circles": "2 to 1000", "asymmetric-circles": "2 to 1000",
}  # fmt: skip
_TAGS = ("calibrate", "boards", "--target", "aprilgrid", "--gap", "3mm", "--square", "16mm",
         "--rows", "5", "--columns")  # fmt: skip
KINDS = [
    Kind("a mesh over another", lambda folder: None,
         ("mesh", "mesh.ply", "--out", "mesh.ply"),
         ("mesh.ply: is there already", "give --force to replace it"), example="bench"),
    Kind("a result named like a report", lambda folder: None,
         ("fit", "cube", "--out", "cube.html"), ("a result is a folder", "a result is a folder: --out"), example="bench"),
    *(
        _kind(command, name, where, damage, _GOOD.get((name, where)) or word)
        for name, (commands, word) in _READERS.items()
        for command in commands
        for where, (damage, _) in PLACES.items()
        if _GOOD.get((name, where), word) is not None
    ),
    *(
        _option(None, *_CHESSBOARD[:2], "--target", target, "--columns", count, *_SQUARES[2:],
                says=says)
        for target, says in _TARGETS.items()
        for count in ("-1", "0", "1", "100000", "9" * 30)
    ),
    *(_option(None, *_TAGS, count, says="one or more") for count in ("0", "-3")),
    *(_option(None, *_TAGS, count, says="has 0 to 586") for count in ("1000", "9" * 30)),
    *(
        _option(None, *_BOARD, *words.split(), says=says)
        for words, says in {
            "--columns 0": "3 x 3 squares", "--rows -1": "3 x 3 squares",
            "--columns 1000000000": "the dictionary 4x4_250 has 0 to 249",
            "--first -1": "needs markers -1 to", "--first 1000000000": "has 0 to 249",
            "--marker 30mm": "smaller than the squares", "--dictionary none": "known: ",
            "--square 0mm": "--square", "--square 1e400mm": "--square", "--marker 1_0mm": "--marker",
            "--columns 7.5": 'is "7.5"; must be a whole number',
        }.items()
    ),
    *(
        _option(None, *_CHESSBOARD[:2], "--marker", "12mm", *_SQUARES, "--boards", count, says=says)
        for count, says in (("0", "--boards"), ("1000000000", "has 0 to 249"), ("2.5", "whole"))
    ),
    *(
        _option(None, *command, option, value, says=f'{option} is "{value}"; must be')
        for *command, option, values in (
            ("plan", "cube", "--count", ("1.5", "1_0", "nan", "x", "0x10", "1e3")),
            ("mesh", "mesh.ply", "--vertices", ("1000.5", "inf", "")),
            ("view", "cube", "--port", ("80.80",)),
            ("campaign", "run", "list.txt", "--workers", ("1.5",)),
            (*_PLAN, "--poisson-ratio", ("0_1", "NaN")),
            ("init", "boards", "--radius", ("1_0", "nan")),
        )
        for value in values
    ),
    *(
        _option(None, *_EDGE, value, says=f"--edge is '{value}'; must be a finite number, with one of")
        for value in ("1_0e-5", "nan", "1e400", "3N")
    ),
    _option(None, *_BOARD_FILE, "--square", "2m", says="markers smaller than the squares, but no less"),
    _option(None, *_BOARD_FILE, "--square", "2m", "--marker", "1.5m", says="pixels; must have 30000 a side"),
    _option(None, "report", "result", "--out", "made.pdf", says="made.pdf: a report is an HTML file"),
    _option(replaced("scan/scan.toml", "sigma = 0.05", "sigma = 1e9"), *_SCAN, says="scan.toml: [[view]] number 1: sigma of view 'top.xyz' reaches"),
    _option(None, *_EDGE, "1um", says="edge of 0.001 mm have some 8e+14 nodes, which would take"),
    *(
        _option(None, *command, says=says)
        for *command, says in (
            (*_PLAN[:3], "--young-modulus", "0", "softest gel"),
            (*_PLAN[:3], "--young-modulus", "1e-300", "softest gel"),
            (*_PLAN[:3], "--young-modulus", "1e300", "diamond"),
            (*_PLAN, "--poisson-ratio", "0.5", "(-1, 0.5)"),
            ("plan", "cube", "--count", "0", "must be 1 to 40"),
            ("plan", "cube", "--count", "100000000", "must be 1 to 40"),
            ("plan", "pictured", "a_c0.png"),
            ("export", "result", "--to", "mujoco", "--edge", "0", "must be positive"),
            ("export", "result", "--to", "calculix", "--edge", "1e9", "0.0693 m across"),
            ("export", "result", "--to", "obj", "--probe", "none", "there"),
            ("export", "result", "--to", "obj", "--session", "none", "no such file"),
            ("export", "cube", "--to", "obj", "no result of this version"),
            ("view", "cube", "--screenshot", "made.gif", ".png or .jpg"),
            ("view", "cube", "--turntable", "made.png", ".mp4 or .gif"),
            ("view", "cube", *_SHOWN, "--probe", "none", "there are: n01"),
            ("view", "cube", "--port", "99999", "99999"),
            ("mesh", "mesh.ply", "--support", "z=nan", 'plane "z=nan"'),
            ("mesh", "mesh.ply", "--support", "z=1000", "check the plane"),
            ("mesh", "mesh.ply", "--vertices", "1000000000", "must be 50 to 50000"),
            ("campaign", "run", "list.txt", "--workers", "0", "--workers is 0"),
            ("campaign", "run", "boards", "no session.toml anywhere below"),
            ("campaign", "run", "list.txt", "--out", "cube", "is there and no campaign"),
            ("campaign", "status", "cube", "holds no campaign.sqlite"),
            ("report", "cube", "no result of this version"),
            ("reproduce", "none", "there is no experiment"),
            ("campaign", "run", "list.txt", "--scheduler", "nonsense", "has no TLS"),
            ("fit", "cube", "--cache", "rig.toml", "rig.toml: the cache cannot be written"),
            ("view", "cube", "--cache", "rig.toml", "rig.toml: the cache cannot be written"),
            (*_POKE, "--cache", "rig.toml/below", "rig.toml/below: the cache cannot be written"),
            ("init", "boards", "--mesh", "mesh.ply", "--name", "", "--name is ''; must be one"),
            ("init", "boards", "--mesh", "mesh.ply", "--name", "a\nb", "must be one line"),
            ("init", "boards", "--mesh", "mesh.ply", "--name", "n" * 300, "of 1 to 200"),
        )
    ),
    *(
        _option(None, *command, "rig.toml", says="rig.toml")
        for command in (
            (*_MESH[:-1],), (*_SCAN[:-1],), (*_EXPORT[:-1],), (*_REPORT[:-1],), (*_OBJECT[:-1],),
            (*_PLAN, "--out"), ("plan", "cube", "--out"), (*_RUN[:-1],),
            ("export", "result", "--to", "obj", "--cache"),
        )
    ),
    # Nothing that is there is replaced, whatever made it.
    *(
        _option(written(name, "mine"), *command, name, says=f"{name}: is there already")
        for name, command in {
            "a.html": ("report", "result", "--out"),
            "b.png": ("view", "cube", "--screenshot"),
            "b.gif": ("view", "cube", "--turntable"),
            "c.csv": ("campaign", "table", "many", "--out"),
            "c.png": ("campaign", "plot", "many", "--out"),
            "d.pdf": ("calibrate", "board"),
        }.items()
    ),
    Kind("a page that somebody wrote", written("page.md", "mine"),
         ("reproduce", "all", "--page", "page.md"), ("page.md: was not generated",), "bench"),
    Kind("a page that is a pipe", lambda folder: PLACES["is a pipe"][0](folder / "list.txt"),
         ("reproduce", "all", "--page", "list.txt"), ("no regular file",), "bench"),
    _listed("", "names no session"),
    _listed("# nothing\n\n ,\n", "names no session"),
    _listed(b"cube\xff\n", "UTF-8"),
    _listed("cube\n" + "x" * 9000, "line 2", "cannot be a file"),
    _listed("cu\0be\n", "line 1", "cannot be a file"),
    _listed("cube\ncube/session.toml\n", "line 2", "already in line 1"),
    _listed("cube\n./cube/../cube, b\n", "line 2", "already in line 1"),
    Kind("a surface in millimetres", _thousandfold, _MESH,
         ("mesh.ply: does not say its unit", "69.3 m across", "--length-unit mm makes it 0.0693 m"),
         "bench"),
    Kind("a mesh of three points", written("three.obj", _THREE),
         ("mesh", "three.obj", "--out", "made"), ("three.obj: ",), "bench"),
    Kind("a covariance that fills the memory", _packed_zeros, (*_OBJECT, "--refine"),
         ("rig_covariance.npz: its arrays take 72", "more than the 67108864"), "bench"),
    Kind("three pictures in one file", _three_pictures, _CHESSBOARD,
         ("01.png: holds 3 pictures; give each a file of its own",), "bench"),
    Kind("a table of another program", _without_table, _TABLES[0], ("campaign.sqlite",), "bench"),
    Kind("points with an underscore", written("scan/top.xyz", "0 0 0\n1_0 0 0\n0 1 0\n"), _SCAN,
         ("top.xyz", "line 2", "no row of numbers"), "bench"),
    Kind("a session that changed its mesh", replaced("cube/session.toml", "mesh.ply", "n01.csv"),
         ("view", "result", *_SHOWN), ("n01.csv",), "bench"),
    *kinds_of_values("bench", "scan/scan.toml", _SCAN, ("format", "length_unit", "sigma", "file", "eye")),
]  # fmt: skip

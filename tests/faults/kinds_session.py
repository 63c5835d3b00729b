"""Kinds of broken sessions: their file, and what their displacements cannot be."""

from pathlib import Path

import numpy as np
from faults.kind import Kind, replaced, written
from scipy.spatial.transform import Rotation

_FORCE = "force = [0, 0, -1.2]"
_PLANE = "plane = { point = [0, 0, 0], normal = [0, 0, 1], tolerance = 1e-6 }"
_SECOND = """
[[probe]]
name = "n02"
contact = { point = [0.02, 0.02, 0.04], radius = 0.006, profile = "smooth" }
force = [0.1, 0, -1]
displacement = "FILE"
"""


def _in_session(old: str, new: str):
    return replaced("session.toml", old, new)


def _gravity(acceleration: str, density: str):
    def damage(folder: Path) -> None:
        file = folder / "session.toml"
        text = file.read_text().replace("[object]", f"[object]\ndensity = {density}")
        file.write_text(f"{text}\n[gravity]\nacceleration = {acceleration}\n")

    return damage


def _displacements(change):
    """Damage: the numbers of n01.csv, header and format kept, are changed."""

    def damage(folder: Path) -> None:
        file = folder / "n01.csv"
        rows = np.loadtxt(file, delimiter=",", skiprows=1)
        head = file.read_text().splitlines()[0]
        np.savetxt(file, change(rows), delimiter=",", header=head, comments="")

    return damage


def _scaled(factor: float):
    return _displacements(lambda rows: rows * np.r_[1, 1, 1, factor, factor, factor, 1])


def _turned(degrees: float):
    """Damage: the object was turned about a slanting axis between rest and load."""
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array([0.6, 0.0, 0.8])).as_matrix()

    def change(rows):
        loaded = rows[:, :3] + np.nan_to_num(rows[:, 3:6])
        return np.hstack([rows[:, :3], loaded @ turn.T - rows[:, :3], rows[:, 6:]])

    return _displacements(change)


def _twice(folder: Path) -> None:
    file = folder / "n01.csv"
    file.write_text(file.read_text() + file.read_text())


def _second_probing(file: str):
    def damage(folder: Path) -> None:
        (folder / file).write_bytes((folder / "n01.csv").read_bytes())
        with (folder / "session.toml").open("a") as session:
            session.write(_SECOND.replace("FILE", file))

    return damage


def _mesh_is_a_folder(folder: Path) -> None:
    (folder / "mesh.ply").unlink()
    (folder / "mesh.ply").mkdir()


def _session_is_a_folder(folder: Path) -> None:
    (folder / "session.toml").unlink()
    (folder / "session.toml").mkdir()


def _listed_triangles(text: str):
    """Damage: the support is the triangles of a list."""

    def damage(folder: Path) -> None:
        _in_session(_PLANE, 'triangles = "held.txt"')(folder)
        (folder / "held.txt").write_text(text)

    return damage


# What is wrong, damage, pieces of the message.
_CHECKED = [
    ("session.toml is empty", written("session.toml", ""), ("session.toml", "format")),
    (
        "a name as long as a book",
        _in_session('name = "a [bold] cube"', f'name = "{"x" * 100_000}"'),
        ("the name 'xxx", "100000 characters", "at most 200"),
    ),
    (
        "a probing's name as long as a book",
        _in_session('name = "n01"', f'name = "{"y" * 300}"'),
        ("probing 'yyy", "300 characters", "at most 200 bytes"),
    ),
    ("a force of two components", _in_session(_FORCE, "force = [0, -1.2]"), ("toml", "force")),
    (
        "a force of a meganewton",
        _in_session(_FORCE, "force = [0, 0, -1e6]"),
        ("'n01'", "8.8 GPa", "than any steel bears", "Young's modulus of about", "in N?"),
    ),
    (
        "a force that means diamond",
        _in_session(_FORCE, "force = [0, 0, -1e10]"),
        ("'n01'", "stiffer than diamond", "GPa"),
    ),
    (
        "a force of a nanonewton",
        _in_session(_FORCE, "force = [0, 0, -1e-9]"),
        ("'n01'", "too soft for its weight", "length_unit"),
    ),
    (
        "a tip displacement in micrometres",
        _in_session(_FORCE, _FORCE + "\ntip_displacement = [0, 0, -400]"),
        ("session.toml: [[probe]] 'n01'", "tip_displacement reaches 400 m", "more than the body"),
    ),
    ("no motion at all", _scaled(0.0), ("'n01'", "n01.csv", "exactly zero", "nothing moved")),
    ("a motion of metres", _scaled(1e3), ("'n01'", "more than the body of 0.0693 m across")),
    ("displacements in the wrong unit", _scaled(1e-9), ("'n01'", "stiffer than diamond")),
    (
        "an infinite displacement",
        written("n01.csv", "x,y,z,ux,uy,uz\n0.02,0.02,0.04,0,0,-1e-4\n0.01,0.01,0.04,0,inf,0\n"),
        ("n01.csv: line 3: uy is infinite",),
    ),
    (
        "a number with an underscore",
        written("n01.csv", "x,y,z,ux,uy,uz\n0.02,0.02,0.04,0,0,-1_0e-5\n"),
        ("n01.csv: line 2", "uz", "-1_0e-5"),
    ),
    (
        "two measurements one after the other",
        _twice,
        ("n01.csv: line", "header again", "a file of its own"),
    ),
    *(
        (
            f"an object turned by {degrees} degrees",
            _turned(degrees),
            ("'n01'", "n01.csv", f"turned by {degrees} degrees", "small"),
        )
        for degrees in (30, 45, 120)
    ),
    ("one file for two probings", _second_probing("n01.csv"), ("'n01'", "'n02'", "same disp")),
    ("a copied file", _second_probing("n02.csv"), ("'n01'", "'n02'", "digit by digit")),
    (
        "a triangle's number of 5000 digits",
        _listed_triangles("9" * 5000),
        (
            "held.txt: line 1",
            "is not a triangle of the mesh",
            "must be a whole number from 0 to 107",
        ),
    ),
    (
        "a support of nothing",
        _in_session(_PLANE, _PLANE.replace("[0, 0, 0]", "[0, 0, 5]")),
        (
            "[support]: the support is empty",
            "the object is 40 x 40 x 40 mm, from (0, 0, 0) to (0.04",
        ),
    ),
    (
        "a support of everything",
        _in_session(_PLANE, _PLANE.replace("1e-6", "1")),
        ("[support]: the support is the whole surface", "the object is 40 x 40 x 40 mm"),
    ),
    (
        "a support of one triangle",
        _listed_triangles("3\n3\n"),
        ("one triangle (number 3)", "select all"),
    ),
    (
        "a contact wider than the body",
        _in_session("radius = 0.006", "radius = 0.05"),
        ("'n01'", "wider than the body", "0.0693 m across"),
    ),
    (
        "a radius in micrometres",
        _in_session("radius = 0.006", "radius = 6e-6"),
        ("'n01'", "11 GPa at the contact", "contact radius"),
    ),
    (
        "gravity in mm/s^2",
        _gravity("[0, 0, -9810]", "1000"),
        ("gravity is 9810 m/s^2", "the earth's is 9.81", "mm/s^2"),
    ),
    ("a density in the wrong unit", _gravity("[0, 0, -9.81]", "1e6"), ("density is", "22600")),
    ("the mesh is a folder", _mesh_is_a_folder, ("mesh: is a folder, not a file", "mesh.ply")),
    ("the session is a folder", _session_is_a_folder, (".: the folder has no session file",)),
    (
        "a name of 100,000 characters",
        _in_session('name = "n01"', f'nam = "{"n" * 100_000}"'),
        ("unknown key 'nam'; did you mean 'name'",),
    ),
    (
        "a file name of 100,000 characters",
        _in_session('"n01.csv"', f'"{"n" * 100_000}.csv"'),
        ("[[probe]] 'n01' displacement",),
    ),
]
KINDS = [Kind(name, damage, ("check", "."), says) for name, damage, says in _CHECKED]

"""Kinds of broken cameras and pictures, which `check` must find, and numbers that are no options."""

import struct
import zlib
from pathlib import Path

from faults.kind import Kind, replaced, written


def _copied(source: str, target: str):
    def damage(folder: Path) -> None:
        (folder / target).write_bytes((folder / source).read_bytes())

    return damage


def _removed(file: str):
    return lambda folder: (folder / file).unlink()


def _in_rig(old: str, new: str):
    return replaced("rig.toml", old, new)


def _cut(file: str):
    def damage(folder: Path) -> None:
        content = (folder / file).read_bytes()
        (folder / file).write_bytes(content[: len(content) // 2])

    return damage


def _to_be_turned(file: str):
    """Damage: EXIF data that ask programs to show a PNG turned."""
    tiff = b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 274, 3, 1, 6, 0, 0)
    chunk = struct.pack(">I", len(tiff)) + b"eXIf" + tiff
    chunk += struct.pack(">I", zlib.crc32(chunk[4:]))

    def damage(folder: Path) -> None:
        content = (folder / file).read_bytes()
        (folder / file).write_bytes(content[:33] + chunk + content[33:])

    return damage


# Of both a session of probings and a rigid motion: the last picture of the second camera.
_SEEN = [
    ("no rig", _removed("rig.toml"), ("rig.toml",)),
    ("a rig that is empty", written("rig.toml", ""), ("rig.toml", "length_unit")),
    ("a camera without K", _in_rig("K =", "k ="), ("[[camera]] 'c0'", "unknown key 'k'", "K,")),
    ("a distortion of text", _in_rig("distortion = [0.0", 'distortion = ["x"'), ("'c0' dist",)),
    ("no last picture", _removed("b_c1.png"), ("'last'", "camera 'c1'", "no such file")),
    ("a last picture cut in half", _cut("b_c1.png"), ("'last'", "camera 'c1'", "cut off")),
    ("a last picture of text", written("b_c1.png", "no picture"), ("'last'", "PNG, JPEG")),
    (
        "a picture to be turned",
        _to_be_turned("b_c1.png"),
        ("'c1'", "EXIF orientation 6", "exiftool"),
    ),
    ("one picture for two cameras", _copied("b_c0.png", "b_c1.png"), ("the same picture",)),
    ("one picture for rest and load", _copied("a_c1.png", "b_c1.png"), ("the same picture",)),
    ("pictures of another size", _in_rig("[160, 120]", "[160, 121]"), ("120 pixels", "c0")),
]
_NO_NUMBERS = [
    ("compression", "c.csv", "--preload", "nan"),
    ("compression", "c.csv", "--preload", "-inf"),
    ("compression", "c.csv", "--preload=nan"),
    ("fit", ".", "--poisson-range", "nan", "0.4"),
    ("poke", ".", "--at", "0.02", "0.02", "0.04", "--force", "0", "0", "nan"),
    ("poke", ".", "--at", "0.02", "0.02", "inf", "--force", "0", "0", "-1"),
    ("lab", "plan", ".", "--young-modulus", "nan"),
    ("lab", "plan", ".", "--young-modulus", "1e4", "--noise", "inf"),
]
KINDS = [
    *(
        Kind(f"{name} ({example})", damage, ("check", "."), says, example=example)
        for name, damage, says in _SEEN
        for example in ("pictured", "rigid_motion")
    ),
    *(
        Kind(" ".join(words), lambda _: None, words, ("must be a finite number",))
        for words in _NO_NUMBERS
    ),
    Kind(
        "a window larger than the pictures",
        lambda _: None,
        ("flow", ".", "--subset", "121", "--out", "made"),
        ("subset is 121 px", "the smallest pictures are 120 px"),
        "pictured",
    ),
    Kind(
        "a preload that pulls",
        lambda folder: (folder / "c.csv").write_text(
            "\n".join(f"{0.1 * k},{0.2 * k}" for k in range(60))
        ),
        ("compression", "c.csv", "--diameter", "50mm", "--height", "50mm", "--preload", "-1"),
        ("c.csv: preload is -1 N", "0 N or more"),
    ),
    Kind(
        "one compression record twice",
        lambda folder: [
            (folder / name).write_text("\n".join(f"{0.1 * k},{0.2 * k}" for k in range(60)))
            for name in ("c.csv", "d.csv")
        ],
        ("compression", "c.csv", "d.csv", "--diameter", "50mm", "--height", "50mm"),
        ("d.csv: holds the same readings as c.csv",),
    ),
    Kind(
        "a copy of a compression record with one row more",
        lambda folder: [
            (folder / name).write_text("\n".join(f"{0.1 * k},{0.2 * k}" for k in range(rows)))
            for name, rows in (("c.csv", 60), ("d.csv", 61))
        ],
        ("compression", "c.csv", "d.csv", "--diameter", "50mm", "--height", "50mm"),
        ("d.csv: holds the same readings as c.csv, 59 of 60",),
    ),
    *(
        Kind(
            f"a compression record that says another {name}",
            lambda _: None,
            ("compression", "press.csv", f"--{name}", given),
            (f"press.csv: says that the {name} is", f"and --{name} that it is {given}"),
            "others",
        )
        for name, given in (("diameter", "40 mm"), ("height", "20.3 mm"))
    ),
]

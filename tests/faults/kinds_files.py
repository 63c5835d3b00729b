"""Everything that can lie in the place of a file, for every file that is read."""

import os
from collections.abc import Callable
from pathlib import Path

from faults.kind import Kind

Damage = Callable[[Path], object]


def _emptied(file: Path) -> None:
    file.write_bytes(b"")


def _gone(file: Path) -> None:
    file.unlink()


def _folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


def _pipe(file: Path) -> None:
    file.unlink()
    os.mkfifo(file)


def _device(file: Path) -> None:
    file.unlink()
    file.symlink_to("/dev/zero")


def _loop(file: Path) -> None:
    file.unlink()
    file.symlink_to(file.name)


def _noise(file: Path) -> None:
    # The same bytes every time; none of them is valid text, and none begins a known format.
    file.write_bytes(bytes((i * i * 37 + 255 - i) % 256 for i in range(3000)))


def _pointer(file: Path) -> None:
    text = f"version https://git-lfs.github.com/spec/v1\noid sha256:{64 * '0'}\nsize 12345\n"
    file.write_text(text)


def _endless(file: Path) -> None:
    # A hole: it takes no place on the disk.
    os.truncate(file, 2**40)


# What lies there, and a word of the message besides the file's name.
PLACES: dict[str, tuple[Damage, str]] = {
    "is empty": (_emptied, ""),
    "is not there": (_gone, "o such file"),
    "is a folder": (_folder, ""),
    "is a pipe": (_pipe, "no regular file"),
    "is a link to an endless device": (_device, "no regular file"),
    "is a link to itself": (_loop, ""),
    "is noise": (_noise, ""),
    "is in Git LFS": (_pointer, "git lfs pull"),
    "has a terabyte": (_endless, ""),
}
_CHECK = ("check", ".")
_FLOW = ("flow", ".", "--out", "moved")
_MESHES = (
    "cube.ply", "cube.obj", "cube.off", "cube.msh", "cube.vtu", "text.ply", "binary.stl",
    "text.stl", "ascii.vtp", "binary.vtp", "appended.vtp",
)  # fmt: skip
_RIGS = (
    "vic3d.xml", "dice.xml", "matchid.caldat", "kalibr.yaml", "stereo.yml", "stereo.xml",
    "stereo.json", "dlt/DLTstruct_cam_201.mat",
)  # fmt: skip
_RESULTS = {
    "vic3d.txt": "vic3d", "dice.txt": "dice", "large.e": "dice", "small.e": "dice",
    "hdf5.e": "dice", "matchid.txt": "matchid", "pyvale.txt": "pyvale", "rows.dic3d": "pyvale",
    "opencorr.txt": "opencorr", "v5.mat": "multidic", "v7.3.mat": "duodic", "grid.vtu": "vtu",
    "grid.vtk": "vtu",
}  # fmt: skip


def _import(kind: str, file: str) -> tuple[str, ...]:
    return ("import", kind, file, ".", "--probe", "n01", "--length-unit", "mm", "--replace")


# File: example, command, and what of session.toml becomes the file's name.
_FILES: dict[str, tuple[str, tuple[str, ...], str]] = {
    "session.toml": ("cube", ("check", "session.toml"), ""),
    "mesh.ply": ("cube", _CHECK, ""),
    "n01.csv": ("cube", _CHECK, ""),
    **dict.fromkeys(_MESHES, ("meshes", _CHECK, "mesh.ply")),
    "rig.toml": ("motion", _FLOW, ""),
    **dict.fromkeys(_RIGS, ("motion", _FLOW, "rig.toml")),
    **{f"{s}_c0.{s}": ("motion", _FLOW, f"png_{{camera}}.png|{s}_{{camera}}.{s}")
       for s in ("png", "jpg", "bmp")},
    **{name: ("others", _import(kind, name), "") for name, kind in _RESULTS.items()},
    "pose.toml": ("others", (*_import("vic3d", "vic3d.txt"), "--to-object", "pose.toml"), ""),
    "press.csv": ("others", ("compression", "press.csv"), ""),
    "ball.toml": ("others", ("lab", "ball.toml", "made"), ""),
    "stage.toml": ("others", ("lab", "stage.toml", "made"), ""),
}  # fmt: skip


def _spoilt(name: str, damage: Damage, named: str) -> Damage:
    """Have session.toml name the file, and put something else in its place."""

    def spoil(folder: Path) -> None:
        session = folder / "session.toml"
        old, _, new = named.partition("|")
        text = session.read_text()
        assert old in text
        session.write_text(text.replace(old, new or name) if old else text)
        damage(folder / name)

    return spoil


KINDS = [
    Kind(
        f"{name}: {where}",
        _spoilt(name, damage, named),
        command,
        (Path(name).name.partition(".")[0].partition("_c0")[0], word),
        example,
    )
    for name, (example, command, named) in _FILES.items()
    for where, (damage, word) in PLACES.items()
]

"""Kinds of broken camera files of other programs."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from faults.kind import Kind
from scipy.io import savemat

_TABLE = """size = [640, 480]
matrix = [[900, 0, 320], [0, 900, 240], [0, 0, 1]]
distortions = [0.1, 0, 0, 0, 0]
rotation = [0.1, 0.2, 0.3]
translation = [0.0, 0.1, 0.9]
"""
_TOML = f"[cameras.0]\n{_TABLE}\n[cameras.1]\n{_TABLE.replace('0.9', '0.8')}"
_CAMERA = {
    "IntrinsicMatrix": [[900.0, 0.0, 0.0], [0.0, 900.0, 0.0], [320.0, 240.0, 1.0]],
    "RadialDistortion": [0.1, 0.0],
    "TangentialDistortion": [0.0, 0.0],
}
_STEREO = {
    "CameraParameters1": _CAMERA,
    "CameraParameters2": _CAMERA,
    "RotationOfCamera2": np.eye(3),
    "TranslationOfCamera2": [-100.0, 0.0, 0.0],
}


def _rig(file: str, write: Callable[[Path], object]) -> Callable[[Path], object]:
    """Damage: the probing has pictures in place of displacements, and this rig."""

    def damage(folder: Path) -> None:
        write(folder / file)
        text = (folder / "session.toml").read_text()
        pictures = 'images = { rest = "r_{camera}.png", loaded = ["l_{camera}.png"] }'
        text = text.replace('displacement = "n01.csv"', pictures)
        (folder / "session.toml").write_text(text + f'\n[rig]\ncameras = "{file}"\n')

    return damage


def _toml(name: str, old: str, new: str, *says: str) -> Kind:
    text = _TOML.replace(old, new, 1)
    damage = _rig("cameras.toml", lambda path: path.write_text(text))
    return Kind(f"caliscope: {name}", damage, ("flow", "."), ("cameras.toml", *says))


def _matlab(name: str, change: dict[str, object], *says: str) -> Kind:
    content = {key: value for key, value in {**_STEREO, **change}.items() if value is not None}
    damage = _rig("stereo.mat", lambda path: savemat(path, content))
    return Kind(f"MATLAB: {name}", damage, ("flow", "."), ("stereo.mat", *says))


def _yaml(name: str, text: str, *says: str) -> Kind:
    damage = _rig("rig.yaml", lambda path: path.write_text(text))
    return Kind(f"YAML: {name}", damage, ("check", "."), ("rig.yaml", *says))


# Nine lists of nine values each: written out, 9^9 of them.
_LAUGHS = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 9)
)
KINDS = [
    _yaml("a billion values by aliases", _LAUGHS, "line 2: '*a0' stands for another value"),
    _yaml("a table by an alias", "a: &a {b: 1}\nc: {<<: *a}\n", "line 2: '*a'", "write out"),
    _toml("a fisheye lens", "size", "fisheye = true\nsize", "camera '0'", "fisheye"),
    _toml("no pose", "rotation = [0.1, 0.2, 0.3]", "", "camera '0'", "no rotation"),
    _toml("a pose that is text", "[0.1, 0.2, 0.3]", '"null"', "camera '0' rotation", "numbers"),
    _toml("a pose of two numbers", "[0.1, 0.2, 0.3]", "[1, 2]", "camera '0' rotation"),
    _toml("a matrix of two rows", "[[900, 0, 320], [0, 900, 240], [0, 0, 1]]", "[[1, 2]]", "'0'"),
    _toml("a lens of nan", "[0.1, 0, 0, 0, 0]", "[nan]", "camera '0' distortions", "finite"),
    _toml("a size of one number", "[640, 480]", "[640]", "image size"),
    _toml("one camera alone", "[cameras.1]", "[cameras.1]\nignore = true", "camera"),
    _toml("no TOML", "[cameras.0]", "[cameras.0", "line 1"),
    _matlab("no rotation", {"RotationOfCamera2": None}, "'RotationOfCamera2'"),
    _matlab("no second camera", {"CameraParameters2": None}, "'CameraParameters2'"),
    _matlab("a camera that is a number", {"CameraParameters2": 3.0}, "no structures", "toStruct"),
    _matlab("no rotation but numbers", {"RotationOfCamera2": 2 * np.eye(3)}, "camera '2'"),
    _matlab("a shift of nan", {"TranslationOfCamera2": [np.nan] * 3}, "TranslationOfCamera2"),
    _matlab("nothing of stereo", {"CameraParameters1": None}, "no stereo calibration"),
]

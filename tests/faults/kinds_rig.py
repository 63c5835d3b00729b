"""Kinds of broken cameras in rig.toml, whose numbers are those of no camera, or not of this one."""

from pathlib import Path

import tomlkit
from faults.kind import Kind

_CHECK, _FLOW = ("check", "."), ("flow", ".", "--out", "moved")
# Looks along y at the cube; and the same with rows and columns exchanged.
_ALONG = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
_TRANSPOSED = [list(column) for column in zip(*_ALONG, strict=True)]
_DOWN = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]


def _matrix(fx: float, fy: float, cx: float = 79.5, cy: float = 59.5) -> list[list[float]]:
    return [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]


def _second(**values: object):
    """Damage: keys of the second camera, which looks down at the cube from (0.06, 0.02, 0.44) m."""

    def damage(folder: Path) -> None:
        content = tomlkit.parse((folder / "rig.toml").read_text())
        content["camera"][1].update(values)  # type: ignore[index, union-attr]
        (folder / "rig.toml").write_text(tomlkit.dumps(content))

    return damage


# What is wrong, the second camera's keys, the command that notices, pieces of the message.
_CAMERAS = {
    "K in metres": (
        {"K": _matrix(8e-3, 8e-3)}, _CHECK,
        ("K: its focal lengths are 0.008 and 0.008", "must be 8 px or more", "side of a pixel"),
    ),
    "K of unlike focal lengths": (
        {"K": _matrix(1000.0, 100.0)}, _CHECK,
        ("K: fx is 1000 and fy is 100 px", "nearly square"),
    ),
    "a principal point the wrong way round": (
        {"K": _matrix(1000.0, 1000.0, 59.5, 79.5)}, _CHECK,
        ("K: its principal point is (59.5, 79.5) px", "160 x 120", "write cx, then cy"),
    ),
    "a lens that folds": (
        {"distortion": [-60.0]}, _CHECK,
        ("distortion: it folds the picture over 50 px off", "check the order k1 k2 p1 p2"),
    ),
    "a lens whose denominator vanishes": (
        {"distortion": [0.0, 0.0, 0.0, 0.0, 0.0, -400.0]}, _CHECK,
        ("distortion: its denominator", "vanishes 50 px off the principal point"),
    ),
    "R transposed": (
        {"K": _matrix(1500.0, 1500.0), "R": _TRANSPOSED, "t": [-0.02, 0.02, 0.4]}, _FLOW,
        ("does not see the object", "with its R transposed it would"),
    ),
    "t in millimetres": (
        {"t": [-60.0, 20.0, 440.0]}, _FLOW,
        ("does not see the object", "with its t a thousandth it would", "length_unit"),
    ),
    "t inside the object": (
        {"R": _DOWN, "t": [-0.02, 0.02, 0.02]}, _FLOW,
        ("stands inside the object, at (0.02, 0.02, 0.02) m", "check its t"),
    ),
}  # fmt: skip
KINDS = [
    Kind(name, _second(**values), command, ("rig.toml: camera 'c1'", *says), "pictured")
    for name, (values, command, says) in _CAMERAS.items()
]

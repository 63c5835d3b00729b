"""Configurations of the virtual facility whose values nothing has, or that contradict each other."""

from pathlib import Path

from faults.kind import Kind, replaced

# What of ball.toml becomes what, and what is said of it.
_BALL = {
    # Bounds of a key alone.
    ("distance = 0.5", "distance = 1e9"): "[head]: distance is 1e+09; must be 0.01 to 100 m",
    ("distance = 0.5", "baseline = 1e9"): "[head]: baseline is 1e+09; must be 1e-06 to 100 m",
    ("distance = 0.5", "focal = 1e12"): "[head]: focal is 1e+12; must be 1 to 1e+06 px",
    ("distance = 0.5", "k1 = 1e3"): "[head]: k1 is 1000; must be -1 to 1",
    ("size = 4e-3", "size = 1e9"): "[look]: size is 1e+09; must be 1e-06 to 100 m",
    ("size = 4e-3", "size = 1e-9"): "[look]: size is 1e-09; must be 1e-06 to 100 m",
    ("radius = 6e-3", "radius = 1e-9"): "[arm]: radius is 1e-09; must be 1e-06 to 100 m",
    ("misalignment = 2.0", "misalignment = 400"): "[arm]: misalignment is 400; must be 0 to 45 degrees",
    ("misalignment = 2.0", "placement = 5"): "[arm]: placement is 5; must be 0 to 1 m",
    ("noise = 0.002", "noise = 1e9"): "[force_sensor]: noise is 1e+09; must be 0 to 1e+06",
    ("noise = 0.002", "relative_noise = 3"): "[force_sensor]: relative_noise is 3; must be in 0 to 1",
    ("noise = 0.002", "bias = [0, 0, 1e9]"): "[force_sensor]: bias is [0.0, 0.0, 1000000000.0]; must be",
    ("young_modulus = 52e3", "young_modulus = 1e20"): "[material]: young_modulus is 1e+20; must be 1 to",
    ("samples = 8", "noise = 1e6"): "[pictures]: noise is 1e+06; must be 0 to 255 grey levels",
    ("samples = 8", "lamp = 1e-9"): "[pictures]: lamp is 1e-09; must be 0.001 to 100 m",
    ("samples = 8", "aperture = 30"): "[pictures]: aperture is 30; must be 0 to 1 m",
    ("samples = 8", "[calibration]\nrotation = 3e9"): "[calibration]: rotation is 3e+09; must be 0 to 45",
    ("samples = 8", "[calibration]\ntranslation = 5"): "[calibration]: translation is 5; must be 0 to 1 m",
    ("depth = 4e-3", "depth = 1e9"): "[[probe]]: depth is 1e+09; must be 1e-06 to 100 m",
    # Against the sizes that the configuration itself states.
    ("radius = 0.04\nedge = 0.008\nelement = 0.01", "radius = 40\nedge = 8"):
        "[specimen]: the object is 120 m across; must be 0.0001 to 50 m",
    ("element = 0.01", "element = 1e-5"): "[specimen]: element is 1e-05 m: the factor of a stiffness matrix of some",
    ("element = 0.01", "element = 1"): "[specimen] element: is 1 m; must be 0.12 m at most, the object's",
    ("distance = 0.5", "distance = 0.01"): "[head]: distance is 0.01 m, less than the object's size of 0.12 m",
    ("noise = 5e-5", "noise = 5"): "[position_sensor] noise: is 5 m; must be 0.12 m at most",
    ("noise = 5e-5", "bias = [3, 4, 0]"): "[position_sensor] bias: is 5 m; must be 0.12 m at most",
    ("noise = 5e-5", "resolution = 5"): "[position_sensor] resolution: is 5 m; must be 0.12 m at most",
    ("size = 4e-3", "size = 0.5"): "[look] size: is 0.5 m; must be 0.12 m at most",
    ("size = 4e-3", "size = 1e-5"): "[look]: size is 1e-05 m; dots of it on 0.015 m^2 are",
    ("radius = 6e-3", "radius = 1"): "[arm] radius: is 1 m; must be 0.12 m at most",
    ("depth = 4e-3", "depth = 50e-3"): "[[probe]] 'n01': depth is 50 mm, the tip's radius 6 mm; a sphere",
    # Found by what is made of it.
    ("point = [0, 0, 0.04]", "point = [1, 0, 0.04]"): "probe 'n01': its point is 961 mm away from",
    ("depth = 4e-3", "force = 1e9"): "[[probe]] 'n01': force is 1e+09 N, which presses a half space",
    ("distance = 0.5", "focal = 9000"): "camera 'c0' has 5 % of the object in its picture",
}  # fmt: skip
_STAGE = {
    ("rotation = 3.0", "rotation = 3e9"): "[stage]: rotation is 3e+09; must be -180 to 180 degrees",
    ("translation = [1e-3, 0, 0]", "translation = [1e3, 0, 0]"): "[stage]: translation is",
    ("rotation = 3.0", "centre = [1e9, 0, 0]"): "[stage]: centre is",
}  # fmt: skip
_SHAPE = 'shape = "half-ball"\nradius = 0.04\nedge = 0.008\n'
_CORNERS = "v 0 0 0\nv 0.04 0 0\nv 0 0.04 0\n"
_MESHES = {
    "open": _CORNERS + "v 0 0 0.04\nf 1 3 2\nf 1 2 4\nf 2 3 4\n",
    "of three points": _CORNERS + "f 1 2 3\n",
}


def _with_mesh(text: str):
    """Damage: the specimen is a surface of this text."""

    def damage(folder: Path) -> None:
        replaced("ball.toml", _SHAPE, 'mesh = "part.obj"\n')(folder)
        (folder / "part.obj").write_text(text)

    return damage


KINDS = [
    *(
        Kind(f"a specimen's mesh {name}", _with_mesh(text), ("lab", "ball.toml", "made"),
             ("part.obj: ", "open"), "others")
        for name, text in _MESHES.items()
    ),
    Kind("a probe on the support", replaced("ball.toml", "[0, 0, 0.04]", "[0, 0, 0]"),
         ("lab", "ball.toml", "made"), ("ball.toml: probe 'n01': ", "nodes of the support"), "others"),
]  # fmt: skip
KINDS += [
    Kind(
        f"{file}: {new}", replaced(file, old, new), ("lab", file, "made"),
        (f"palpate: {file}: {says}",), "others",
    )
    for file, changes in (("ball.toml", _BALL), ("stage.toml", _STAGE))
    for (old, new), says in changes.items()
]  # fmt: skip

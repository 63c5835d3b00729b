"""Kinds of broken tools that are given as a mesh."""

from pathlib import Path

from faults.kind import Kind, replaced

# A pyramid, apex down at the origin, 1 cm high and wide.
_SIDES = "f 1 3 2\nf 1 4 3\nf 1 5 4\nf 1 2 5\n"
_BASE = "f 2 3 4\nf 2 4 5\n"
# Its base drawn in to a sixth corner.
_DENT = "v 0 0 8e-3\nf 2 3 6\nf 3 4 6\nf 4 5 6\nf 5 2 6\n"


def _corners(x: float = 0.0, height: str = "1e-2") -> str:
    """The pyramid's corners, shifted along x [m]."""
    base = [(-5e-3, -5e-3), (5e-3, -5e-3), (5e-3, 5e-3), (-5e-3, 5e-3)]
    return f"v {x} 0 0\n" + "".join(f"v {x + a} {b} {height}\n" for a, b in base)


_PYRAMID = _corners() + _SIDES + _BASE
_TOOL = 'tool = "mesh", tool_mesh = "tool.obj"'


def _kind(name: str, text: str, *says: str, tool: str = _TOOL, command: str = "check") -> Kind:
    """The cube, pressed with a tool whose file holds this text."""

    def damage(folder: Path) -> None:
        (folder / "tool.obj").write_text(text)
        replaced("session.toml", 'radius = 0.006, profile = "smooth"', tool)(folder)

    return Kind(
        name, damage, (command, "."), ("session.toml", *says) if command == "check" else says
    )


KINDS = [
    _kind("a tool's mesh that is empty", "", "tool.obj", "cannot be read"),
    _kind("a tool's mesh that is a text", "hello\n", "tool.obj", "cannot be read"),
    _kind("a tool's mesh with a corner that is missing", "v 0 0 0\n" + _SIDES, "tool.obj"),
    _kind("a tool's mesh that is not finite", _corners(height="nan") + _SIDES + _BASE, "tool.obj"),
    _kind("a tool's mesh that is flat", _corners(height="0") + _SIDES + _BASE, "no volume"),
    _kind("a tool's mesh that is open", _corners() + _SIDES, "convex and closed"),
    _kind("a tool's mesh that is dented", _corners() + _SIDES + _DENT, "convex and closed"),
    _kind("a tool's mesh without a file", _PYRAMID, "tool_mesh", "no such file: ", "nail.stl",
          tool='tool = "mesh", tool_mesh = "nail.stl"'),
    _kind("a tool's mesh of a kind that nobody reads", _PYRAMID, "session.toml", "are not read",
          tool='tool = "mesh", tool_mesh = "session.toml"'),
    _kind("a tool's mesh that nobody names", _PYRAMID, "'tool_mesh' is missing", tool='tool = "mesh"'),
    _kind("a rotation of two numbers", _PYRAMID, "tool_rotation", "three finite numbers",
          tool=_TOOL + ", tool_rotation = [0, 1]"),
    _kind("a rotation of a ball", _PYRAMID, "unknown key 'tool_rotation'",
          tool='tool = "sphere", tool_radius = 0.006, tool_rotation = [0, 0, 1]'),
    _kind("a radius of a mesh", _PYRAMID, "unknown key 'tool_radius'",
          tool=_TOOL + ", tool_radius = 0.006"),
    _kind("a tool's mesh far from its origin", _corners(0.05) + _SIDES + _BASE,
          "origin of its frame", command="fit"),
]  # fmt: skip

"""Surfaces that say they are too large: refused by what their first bytes claim."""

from pathlib import Path

from faults.kind import Kind

_COUNT = 2_000_000
_VTU = (
    '<VTKFile type="UnstructuredGrid"><UnstructuredGrid><Piece NumberOfPoints="9"'
    f' NumberOfCells="{_COUNT}"/></UnstructuredGrid></VTKFile>'
).encode()
_CLAIMS = {
    "text.ply": f"ply\nformat ascii 1.0\nelement face {_COUNT}\n".encode(),
    "cube.off": f"OFF\n# a comment\n9 {_COUNT} 0\n".encode(),
    "cube.vtu": _VTU,
    "cube.msh": f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Elements\n{_COUNT}\n".encode(),
    "ascii.vtp": f'<VTKFile type="PolyData"><Piece NumberOfPolys="{_COUNT}"/>'.encode(),
    # Its length belongs to the claim: the rest is a hole.
    "binary.stl": bytes(80) + _COUNT.to_bytes(4, "little"),
}


def _claimed(file: str, head: bytes):
    def damage(folder: Path) -> None:
        session = folder / "session.toml"
        session.write_text(session.read_text().replace("mesh.ply", file))
        with (folder / file).open("wb") as opened:
            opened.write(head)
            if file.endswith(".stl"):
                opened.truncate(84 + 50 * _COUNT)

    return damage


KINDS = [
    Kind(
        f"{file}: {command[0]} of two million triangles",
        _claimed(file, head),
        command,
        (file, str(_COUNT), "too large", "decimate"),
        "meshes",
    )
    for file, head in _CLAIMS.items()
    for command in (("check", "."), ("fit", ".", "--out", "made"))
]
KINDS += [
    Kind(
        f"{file}: a number of 5000 digits",
        _claimed(file, head.replace(str(_COUNT).encode(), b"9" * 5000)),
        ("check", "."),
        (file, "a whole number of too many digits"),
        "meshes",
    )
    for file, head in _CLAIMS.items()
    if file != "binary.stl"
]

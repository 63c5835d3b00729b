"""Numbers of nodes that would fill the memory, and nodes that are missing, are refused."""

import resource
from pathlib import Path

import meshio
import numpy as np
import pytest
from surfaces import box

from palpate.errors import MeshError
from palpate.geometry import read_mesh

_FORMATS = [("2.2", False), ("2.2", True), ("4.0", False), ("4.0", True),
            ("4.1", False), ("4.1", True)]  # fmt: skip


def _written(path: Path, version: str, *, binary: bool) -> bytes:
    mesh = box(size=(0.02, 0.03, 0.04), cells=2)
    kept = meshio.Mesh(mesh.vertices, [("triangle", mesh.triangles)])
    meshio.gmsh.write(path, kept, fmt_version=version, binary=binary)
    return path.read_bytes()


@pytest.mark.parametrize(("version", "binary"), _FORMATS)
def test_every_version_is_read(tmp_path: Path, version: str, binary: bool) -> None:
    _written(tmp_path / "a.msh", version, binary=binary)
    mesh = box(size=(0.02, 0.03, 0.04), cells=2)
    assert read_mesh(tmp_path / "a.msh").triangles.tolist() == mesh.triangles.tolist()


@pytest.mark.parametrize(("version", "binary"), [pair for pair in _FORMATS if pair != _FORMATS[1]])
def test_a_number_that_would_fill_the_memory(tmp_path: Path, version: str, binary: bool) -> None:
    content = _written(tmp_path / "a.msh", version, binary=binary)
    nodes = content.index(b"$Nodes")
    count = len(box(size=(0.02, 0.03, 0.04), cells=2).vertices)
    if binary:
        size = 4 if version == "4.0" else 8
        last, high = (number.to_bytes(size, "little") for number in (count, 2_000_000_000))
        # The header counts the nodes, too; the last of these bytes is the number of the last node.
        place = content.rindex(last, nodes, content.index(b"$EndNodes"))
    else:
        last, high = f"\n{count}".encode(), b"\n2000000000"
        place = content.rindex(last, nodes, content.index(b"$EndNodes"))
    (tmp_path / "a.msh").write_bytes(content[:place] + high + content[place + len(last) :])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(MeshError, match=r"a\.msh: .*node has the number 2000000000, at most"):
        read_mesh(tmp_path / "a.msh")
    # Kilobytes: the table would have taken sixteen gigabytes.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500_000


@pytest.mark.parametrize(("version", "binary"), _FORMATS[2:])
def test_more_nodes_declared_than_held(tmp_path: Path, version: str, binary: bool) -> None:
    content = _written(tmp_path / "a.msh", version, binary=binary)
    count = len(box(size=(0.02, 0.03, 0.04), cells=2).vertices)
    start = content.index(b"\n", content.index(b"$Nodes")) + 1
    if binary:
        numbers = np.frombuffer(content[start : start + 16], "u8").copy()
        assert numbers[1] == count
        numbers[1] += 1000
        changed = numbers.tobytes() + content[start + 16 :]
    else:
        first, said, rest = content[start:].split(maxsplit=2)
        assert int(said) == count
        changed = b"%s %d %s" % (first, count + 1000, rest)
    (tmp_path / "a.msh").write_bytes(content[:start] + changed)
    with pytest.raises(MeshError, match=rf"declares|says that it has {count + 1000} nodes"):
        read_mesh(tmp_path / "a.msh")

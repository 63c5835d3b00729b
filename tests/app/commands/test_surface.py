"""`palpate mesh`: from a broken file to a surface that a session can name."""

import json

import pytest
import trimesh
from broken_surfaces import ball, box, made, together, without_cap

from palpate.geometry import checked_mesh, read_mesh


@pytest.fixture
def scan(tmp_path):
    """A ball with a hole and a crumb beside it, in millimetres as printers' files are."""
    v, f = together(without_cap(ball(), 0.029), ball(0.0008, (0.05, 0.0, 0.0), fine=1))
    trimesh.Trimesh(1e3 * v, f, process=False).export(tmp_path / "scan.stl")
    return tmp_path / "scan.stl"


def test_a_broken_file_becomes_a_sound_mesh(palpate, scan, tmp_path):
    (tmp_path / "touch.xyz").write_text("0 0 -30\n")
    options = ("--length-unit", "mm", "--vertices", "400", "--near", "touch.xyz")
    code, out, _ = palpate("mesh", scan, *options)
    assert code == 0
    assert "stray piece" in out
    assert "hole" in out
    mesh, notes = checked_mesh(read_mesh(tmp_path / "scan-mesh" / "mesh.ply"))
    assert notes == ()
    assert len(mesh.vertices) == pytest.approx(400, rel=0.1)
    content = json.loads((tmp_path / "scan-mesh" / "surface.json").read_text())
    assert [action["defect"] for action in content["actions"]] == ["stray piece", "hole"]
    # Of 20 edges around, chords lack about 1.5 % of a ball.
    assert abs(content["deviation"]["volume"]) < 0.02
    assert (tmp_path / "scan-mesh" / "mesh.png").stat().st_size > 20_000
    assert palpate("verify", "scan-mesh")[0] == 0


def test_a_unit_that_was_not_said_is_noticed(palpate, scan):
    _, _, err = palpate("mesh", scan, "--vertices", "300")
    assert "if the file is not in m, say --length-unit" in err


@pytest.mark.parametrize(
    ("part", "options", "message"),
    [
        (without_cap(box(), 0.009), (), 'say --support "0,0,0.01,0,0,1" if the object stood there'),
        (box(), ("--support", "z=-0.05"), "nothing of the object lies on the support"),
        (together(box(), box(centre=(0.06, 0.0, 0.0))), (), "2 separate objects"),
        (box(), ("--vertices", "3"), "must be 50 to 50000"),
        (box(), ("--support", "floor"), 'the plane "floor" is not understood'),
    ],
)
def test_what_cannot_be_done_leaves_nothing(palpate, tmp_path, part, options, message):
    mesh = made(part)
    trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).export(tmp_path / "m.ply")
    code, _, err = palpate("mesh", "m.ply", *options)
    assert code == 2
    assert message in " ".join(err.split())
    assert not (tmp_path / "m-mesh").exists()

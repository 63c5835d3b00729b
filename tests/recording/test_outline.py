"""What lies in a folder becomes the outline of a session that says what is still missing."""

import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from recording.bench_footage import write_recording
from surfaces import box, sphere

from palpate.app.cli import main
from palpate.errors import InputError, RecordError
from palpate.geometry import TriangleMesh, write_mesh
from palpate.recording import chosen_side, flat_sides, likely_unit, read_recording, survey_folder
from palpate.records import read_session


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording."""
    return write_recording(tmp_path_factory.mktemp("outline"))


def _said(path: Path) -> dict:
    return tomllib.loads(path.read_text(encoding="utf-8"))


def test_a_recording_needs_its_axes_only(bench: Path, tmp_path: Path) -> None:
    folder = tmp_path / "bench"
    shutil.copytree(bench, folder)
    (folder / "recording.toml").unlink()
    assert main(["init", str(folder), "--radius", "0.004"]) == 0
    given = read_recording(folder)
    assert [footage.source.name for footage in given.footage] == ["c0.avi", "c1.avi"]
    assert given.gauge.file.name == "force.csv"
    # The block stands on z = -0.03; its sides are smaller.
    assert _said(folder / "recording.toml")["support"]["plane"]["point"] == [0, 0, -0.03]
    assert given.contact_source.poses is None
    (folder / "poses.csv").write_text("time,x,y,z\n0,0,0,0\n1,0,0,0\n")
    (folder / "recording.toml").unlink()
    assert main(["init", str(folder)]) == 0
    assert _said(folder / "recording.toml")["contact"]["poses"] == "poses.csv"


def test_mesh_and_rig_may_lie_elsewhere(
    bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, made = tmp_path / "presses", tmp_path / "made"
    shutil.copytree(bench, folder)
    made.mkdir()
    (folder / "recording.toml").unlink()
    for name in ("mesh.ply", "rig.toml"):
        (folder / name).rename(made / name)
    words = ["init", str(folder), "--radius", "0.004", "--rig", str(made)]
    assert main([*words, "--mesh", str(tmp_path / "none.ply")]) == 2
    assert "none.ply: no such file, nor is it in" in capsys.readouterr().err
    assert main([*words, "--mesh", str(made / "mesh.ply")]) == 0
    text = (folder / "recording.toml").read_text()
    assert 'mesh = "../made/mesh.ply"' in text
    assert 'cameras = "../made/rig.toml"' in text
    assert read_recording(folder).rig.cameras


def test_a_tool_stands_for_the_patch(bench: Path, tmp_path: Path) -> None:
    """In a recording, and in a session."""
    folder = tmp_path / "bench"
    shutil.copytree(bench, folder)
    (folder / "recording.toml").unlink()
    assert main(["init", str(folder), "--tool-radius", "0.006"]) == 0
    patch = read_recording(folder).contact_source.patch
    assert (patch["tool"], patch["tool_radius"]) == ("sphere", 0.006)
    assert "radius" not in patch
    assert main(["init", str(folder), "--template", "dic", "--tool-radius", "0.006"]) == 0
    (probe,) = _said(folder / "session.toml")["probe"]
    assert probe["contact"] == {"point": [0, 0, 0], "tool": "sphere", "tool_radius": 0.006}


def test_displacements_become_probings(tmp_path: Path) -> None:
    mesh = box(size=(40.0, 40.0, 40.0), cells=3)
    write_mesh(tmp_path / "cube.stl", mesh)
    top = mesh.vertices[mesh.vertices[:, 2] > 0.0]
    rows = np.hstack([top, np.array([0.3, 0.0, -0.4]) * top[:, 2:] / 40.0])
    for name in ("a", "b"):
        np.savetxt(
            tmp_path / f"{name}.csv", rows, delimiter=",", header="x,y,z,ux,uy,uz", comments=""
        )
        rows[:, 3:] *= 0.5
    assert main(["init", str(tmp_path), "--held", "z-"]) == 0
    path = tmp_path / "session.toml"
    said = _said(path)
    assert said["object"] == {"mesh": "cube.stl", "length_unit": "mm"}
    assert [probe["displacement"] for probe in said["probe"]] == ["a.csv", "b.csv"]
    # What is not filled in is refused with its place; what is filled in is a session.
    with pytest.raises(InputError, match="force"):
        read_session(tmp_path)
    text = path.read_text().replace("force = [0, 0, 0]", "force = [0.5, 0, -1.2]")
    path.write_text(text.replace("point = [0, 0, 0], radius", "point = [20, 20, 40], radius"))
    assert len(read_session(tmp_path).probings) == 2


def test_pictures_become_probings(bench: Path, tmp_path: Path) -> None:
    for name in ("mesh.ply", "rig.toml"):
        shutil.copy(bench / name, tmp_path)
    (tmp_path / "images").mkdir()
    for instant in ("rest", "n01", "n02"):
        for camera in ("c0", "c1"):
            (tmp_path / "images" / f"{instant}_{camera}.png").write_bytes(b"")
    # A picture that one camera alone has is none of a probing.
    (tmp_path / "images" / "n03_c0.png").write_bytes(b"")
    assert main(["init", str(tmp_path)]) == 0
    probes = _said(tmp_path / "session.toml")["probe"]
    assert [probe["name"] for probe in probes] == ["n01", "n02"]
    assert probes[1]["images"] == {
        "rest": "images/rest_{camera}.png",
        "loaded": ["images/n02_{camera}.png"],
    }


def test_a_link_to_a_folder_makes_no_more_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_mesh(tmp_path / "mesh.ply", box(size=(0.04, 0.04, 0.04), cells=2))
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "rest_c0.png").write_bytes(b"")
    # A second name for one file is meant.
    (tmp_path / "pictures" / "n01_c0.png").symlink_to("rest_c0.png")
    (tmp_path / "here").symlink_to(".")
    (tmp_path / "earlier").symlink_to("pictures")
    survey = survey_folder(tmp_path)
    assert survey.meshes == ("mesh.ply",)
    assert survey.pictures == ("pictures/n01_c0.png", "pictures/rest_c0.png")
    assert main(["init", str(tmp_path), "--template", "lab"]) == 0
    assert "1 mesh, 2 pictures" in capsys.readouterr().out


@pytest.mark.parametrize("template", ["lab", "dic", "tension", "robot", "gauge", "webcams"])
def test_every_template_is_toml_for_a_mesh_alone(template: str, tmp_path: Path) -> None:
    write_mesh(tmp_path / "mesh.ply", box(size=(0.04, 0.04, 0.04), cells=2))
    name = 'it is "so"'
    assert main(["init", str(tmp_path), "--template", template, "--name", name]) == 0
    (file,) = tmp_path.glob("*.toml")
    assert _said(file)["name"] == name
    text = file.read_text()
    assert "<- fill in" in text
    # A comment does not touch what it is about; places are in the unit of the mesh.
    assert not re.search(r"[^ #\n]#", text)
    assert template != "gauge" or "[[0, 0, 0.04]]" in text


def test_a_strip_is_pulled_at_its_ends(tmp_path: Path) -> None:
    mesh = box(size=(100.0, 20.0, 4.0), cells=4)
    write_mesh(tmp_path / "strip.ply", mesh)
    rows = np.hstack([mesh.vertices, mesh.vertices * [0.01, 0.0, 0.0]])
    head = "x,y,z,ux,uy,uz"
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header=head, comments="")
    assert main(["init", str(tmp_path), "--template", "tension", "--unit", "mm"]) == 0
    file = tmp_path / "session.toml"
    text = file.read_text()
    file.write_text(text.replace("force = [0, 0, 0]", "force = [2, 0, 0]"))
    session = read_session(tmp_path)
    corners = session.mesh.vertices[session.mesh.triangles]
    ends = [corners[support.triangles][:, :, 0] for support in session.supports]
    assert sorted((end.min(), end.max()) for end in ends) == [(0.0, 0.0), (0.1, 0.1)]
    assert session.supports[1].motion == "free"


def test_a_sliver_as_support_is_marked(tmp_path: Path) -> None:
    # A ball with a facet of one per cent.
    ball = sphere(4, 0.03)
    flat = np.maximum(ball.vertices, [-1.0, -1.0, -0.0295])
    write_mesh(tmp_path / "ball.ply", TriangleMesh(flat, ball.triangles))
    assert main(["init", str(tmp_path), "--template", "lab"]) == 0
    assert "<- fill in: is this all that is held?" in (tmp_path / "session.toml").read_text()


def test_sides_and_units() -> None:
    mesh = box(size=(40.0, 30.0, 20.0), cells=2)
    sides = flat_sides(mesh)
    assert [side.name for side in sides[:2]] == ["z-", "z+"]
    # 40 x 30 of 2 (40 x 30 + 40 x 20 + 30 x 20).
    assert sides[0].area_fraction == pytest.approx(1200.0 / 5200.0)
    assert chosen_side(sides, "y+").point[1] == pytest.approx(mesh.vertices[:, 1].max())
    for factor, unit in ((1.0, "mm"), (0.1, "cm"), (1e-3, "m")):
        assert likely_unit(TriangleMesh(factor * mesh.vertices, mesh.triangles)) == unit
    with pytest.raises(InputError, match="no flat side"):
        chosen_side(sides[:2], "x-")


def test_times_of_numbered_frames_are_no_forces(tmp_path: Path) -> None:
    (tmp_path / "c0.csv").write_text("frame,time\n0,0.0\n1,0.05\n")
    (tmp_path / "gauge.csv").write_text("frame,time,fx\n0,0.0,0.1\n1,0.05,0.2\n")
    survey = survey_folder(tmp_path)
    assert survey.times == ("c0.csv",)
    assert survey.forces == ("gauge.csv",)


def test_files_of_one_name_would_overwrite_each_other(bench: Path, tmp_path: Path) -> None:
    folder = tmp_path / "bench"
    shutil.copytree(bench, folder)
    text = (folder / "recording.toml").read_text()
    start, end = text.index("[support]"), text.index("[rig]")
    supports = ""
    for name in ("left", "right"):
        (folder / name).mkdir()
        (folder / name / "held.txt").write_text("0\n1\n" if name == "left" else "2\n3\n")
        supports += f'[[support]]\ntriangles = "{name}/held.txt"\n'
    (folder / "recording.toml").write_text(text[:start] + supports + text[end:])
    with pytest.raises(RecordError, match=r"left/held\.txt.*right/held\.txt' have the same name"):
        read_recording(folder)

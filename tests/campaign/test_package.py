"""Files that travel, and the digest by which their result is found again."""

import shutil
from dataclasses import replace

import pytest

import palpate
from palpate.campaign import FitOptions, Work, pack_session
from palpate.campaign.work import Package, pack_files, unpack
from palpate.errors import RecordError


def _digest(folder, **options):
    return Work("fit", pack_session(folder), FitOptions(**options)).digest


def test_a_digest_is_that_of_files_options_and_version(cube_session, tmp_path, monkeypatch):
    first = _digest(cube_session)
    # Where the session lies has no part in it, nor what lies beside it without a name.
    (tmp_path / "elsewhere").mkdir()
    moved = tmp_path / "elsewhere" / "cube"
    shutil.copytree(cube_session, moved)
    (moved / "remarks.txt").write_text("a fine day")
    assert _digest(moved) == first
    assert _digest(moved / "session.toml") == first
    others = {_digest(moved, poisson_range=(0.0, 0.4)), _digest(moved, strain="finite")}
    others.add(Work("motion", pack_session(moved), FitOptions()).digest)
    shutil.move(moved, tmp_path / "ball")
    others.add(_digest(tmp_path / "ball"))  # its folder's name may be the session's
    for name in ("session.toml", "mesh.ply", "n01.csv"):
        changed = tmp_path / "elsewhere" / name / "cube"
        shutil.copytree(cube_session, changed)
        with (changed / name).open("ab") as file:
            file.write(b"\n")
        others.add(_digest(changed))
    monkeypatch.setattr(palpate, "__version__", "9.9")
    others.add(_digest(cube_session))
    assert len(others | {first}) == 9


def test_a_session_travels_with_what_lies_above_it(cube_session, tmp_path):
    shutil.move(cube_session / "mesh.ply", cube_session.parent / "mesh.ply")
    text = (cube_session / "session.toml").read_text().replace('"mesh.ply"', '"../mesh.ply"')
    (cube_session / "session.toml").write_text(text)
    found = pack_session(cube_session)
    assert set(found.package.files) == {"mesh.ply", "cube/session.toml", "cube/n01.csv"}
    assert found.session == "cube/session.toml"
    (tmp_path / "there").mkdir()
    unpack(found.package, tmp_path / "there")
    assert (tmp_path / "there" / "cube" / "session.toml").read_text() == text


def test_a_file_that_changes_on_its_way_is_noticed(packed_cube, tmp_path):
    files = dict(packed_cube.package.files)
    files["cube/n01.csv"] = files["cube/n01.csv"].replace(b"1", b"7", 1)
    with pytest.raises(RecordError, match="damaged on their way"):
        unpack(replace(packed_cube.package, files=files), tmp_path)
    del files["cube/n01.csv"]
    with pytest.raises(RecordError, match="damaged on their way"):
        unpack(Package(files, packed_cube.package.sums), tmp_path)


@pytest.mark.parametrize("name", ["../a", "/a", "b/../../a"])
def test_no_file_is_written_elsewhere(tmp_path, name):
    with pytest.raises(RecordError, match="leads out of the folder"):
        unpack(pack_files({name: b""}), tmp_path)

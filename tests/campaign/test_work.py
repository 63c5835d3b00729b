"""What a piece of work gives depends on its files and options, and on nothing else."""

import errno
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import palpate
from palpate.bem import check_memory
from palpate.bem.compressed import system as compressed
from palpate.campaign import FitOptions
from palpate.campaign.work import Work, do_work, pack_session, unpack
from palpate.errors import InputError, PalpateError, RecordError
from palpate.pipeline import fit_session
from palpate.records import read_estimate, read_session


@pytest.fixture(scope="module")
def fitted(cube, tmp_path_factory):
    """One session, fitted plainly, and twice in another folder with kept integrals."""
    folder = tmp_path_factory.mktemp("fitted")
    work = Work("fit", pack_session(cube), FitOptions())
    plain = do_work(work, folder=folder / "one")
    shared = replace(work, shared_body=True)
    return folder, plain, [do_work(shared, folder=folder / "two") for _ in range(2)]


def test_the_files_are_the_same_to_the_last_byte(fitted):
    _, plain, others = fitted
    assert "estimate.json" in plain.files
    assert all(dict(output.files) == dict(plain.files) for output in others)


def test_the_estimate_is_that_of_a_plain_fit(fitted, cube, tmp_path):
    _, plain, _ = fitted
    (tmp_path / "e.json").write_bytes(plain.files["estimate.json"])
    expected = fit_session(read_session(cube)).estimate
    estimate = read_estimate(tmp_path / "e.json")
    # Several threads may add in another order: rounding, times the condition of the model.
    assert estimate.young_modulus.value == pytest.approx(expected.young_modulus.value, rel=1e-9)
    assert estimate.young_modulus.ci95 == pytest.approx(expected.young_modulus.ci95, rel=1e-6)


def test_only_what_others_can_use_stays_behind(fitted):
    folder, _, _ = fitted
    assert list((folder / "one").iterdir()) == []
    assert [path.name for path in (folder / "two").iterdir()] == ["bodies"]
    # The given mesh, the same with wider fits between its vertices, with finer sharp edges, graded:
    # factors (but those of the last, which depends on the contacts), reduced models.
    assert len(list((folder / "two" / "bodies").iterdir())) == 3 + 4


def test_a_body_leaves_what_its_fits_need(fitted, packed_cube, tmp_path):
    folder, _, (first, _) = fitted
    body = do_work(Work("body", packed_cube, FitOptions(), {"mesh": "m"}), folder=tmp_path)
    assert body.files == {}
    names = [
        sorted(path.name for path in (parent / "bodies").iterdir())
        for parent in (folder / "two", tmp_path)
    ]
    assert names[0] == names[1]
    work = Work("fit", packed_cube, FitOptions(), shared_body=True)
    assert dict(do_work(work, folder=tmp_path).files) == dict(first.files)
    # Another range of Poisson's ratio, or faceted elements, need other models.
    other = FitOptions(poisson_range=(0.0, 0.45), surface="flat")
    do_work(Work("body", packed_cube, other, {"mesh": "m"}), folder=tmp_path)
    before = len(list((tmp_path / "bodies").iterdir()))
    assert before > len(names[0])
    do_work(Work("fit", packed_cube, other, shared_body=True), folder=tmp_path)
    assert len(list((tmp_path / "bodies").iterdir())) == before


@pytest.mark.slow
def test_a_shared_body_that_is_solved_compressed_leaves_nothing(packed_cube, tmp_path, monkeypatch):
    monkeypatch.setattr(compressed, "LARGEST_DENSE", 0)
    work = Work("fit", packed_cube, FitOptions(), shared_body=True)
    outcome = do_work(work, folder=tmp_path / "one")
    assert "estimate.json" in outcome.files
    assert list((tmp_path / "one").iterdir()) == []


def _refusal(work, folder, **options):
    with pytest.raises(PalpateError) as raised:
        do_work(work, folder=folder, **options)
    return str(raised.value)


def test_bad_input_is_a_message_that_names_the_file_at_home(packed_cube, tmp_path):
    files = dict(packed_cube.files)
    files["cube/n01.csv"] = b"x,y\n1,2\n"
    message = _refusal(
        Work("fit", replace(packed_cube, files=files), FitOptions()), tmp_path / "there"
    )
    assert message.startswith(f"{packed_cube.root}/cube/n01.csv: ")
    assert "there" not in message


def test_a_file_that_is_missing_is_one_at_home(packed_cube, tmp_path):
    files = dict(packed_cube.files)
    del files["cube/mesh.ply"]
    bad = replace(packed_cube, files=files)
    # A worker's own folder may have a long path.
    message = _refusal(Work("fit", bad, FitOptions()), tmp_path / ("x" * 100))
    assert f"mesh: no such file: {packed_cube.root}/cube/mesh.ply" in message


def test_a_worker_s_full_disk_is_not_taken_for_the_session_s(packed_cube, tmp_path, monkeypatch):
    def full(path, _):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    work = Work("fit", packed_cube, FitOptions())
    monkeypatch.setattr(Path, "write_bytes", full)
    message = _refusal(work, tmp_path / "there")
    assert message.startswith(f"{tmp_path}/there/work-")
    assert "cannot be written (No space left on device)" in message
    assert packed_cube.root not in message
    assert list((tmp_path / "there").iterdir()) == []


def test_a_body_that_memory_cannot_hold_is_refused_before_any_work(packed_cube, tmp_path):
    work = Work("fit", packed_cube, FitOptions())
    message = _refusal(work, tmp_path, memory=4e8)
    with pytest.raises(InputError) as expected:
        check_memory(98, 1, available=4e8)
    assert "model for one probing would take 0.4 GB of memory; 0.4 GB can be used here" in message
    assert message == f"{packed_cube.root}/cube/mesh.ply: {expected.value}"


def test_motion_that_was_measured_is_taken(packed_cube, tmp_path):
    # What is no motion of these pictures is measured again, not believed: here there are none.
    motions = {"key": np.random.default_rng(0).bytes(100)}
    work = Work("fit", packed_cube, FitOptions(), {"n01": "key"}, motions)
    assert do_work(work, folder=tmp_path).files


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
    packed = pack_session(cube_session)
    assert set(packed.files) == {"mesh.ply", "cube/session.toml", "cube/n01.csv"}
    assert packed.session == "cube/session.toml"
    (tmp_path / "there").mkdir()
    unpack(packed.files, tmp_path / "there")
    assert (tmp_path / "there" / "cube" / "session.toml").read_text() == text


@pytest.mark.parametrize("name", ["../a", "/a", "b/../../a"])
def test_no_file_is_written_elsewhere(tmp_path, name):
    with pytest.raises(RecordError, match="leads out of the folder"):
        unpack({name: b""}, tmp_path)

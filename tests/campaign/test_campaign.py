"""A campaign as a whole: its pieces of work, on workers, interrupted, continued."""

import csv
import errno
import shutil
import sqlite3
from contextlib import contextmanager
from dataclasses import replace

import dask
import distributed
import numpy as np
import pytest
from campaign.conftest import NU, SHEAR
from pipeline.picture_session import with_pictures
from pipeline.seen_session import write_seen_session
from surfaces import box

from palpate.campaign import (
    FitOptions,
    Store,
    campaign,
    read_items,
    run_campaign,
    work,
    work as work_file,
)
from palpate.campaign.campaign import _pieces, _Run, body_work, motion_works, shared_meshes
from palpate.campaign.engine import Engine
from palpate.campaign.work import Work, do_work, pack_session
from palpate.disk import atomic_replacement
from palpate.errors import InputError, InUseError, RecordError
from palpate.geometry import write_mesh
from palpate.pipeline import MotionNotes, ProbingMotion, unread_probings
from palpate.records import folder_changes, read_session
from palpate.records.files import results

GIVEN = FitOptions(pose="given")


@pytest.fixture
def submitted(monkeypatch):
    """Works that were handed to workers, by kind and session."""
    works, submit = [], Engine.submit

    def seen(self, function, work, *others):
        works.append((work.kind, work.session.session))
        return submit(self, function, work, *others)

    monkeypatch.setattr(Engine, "submit", seen)
    return works


def _tree(folder):
    return {
        path.relative_to(folder): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.suffix != ".sqlite"
    }


def test_all_sessions_become_rows(cubes, scheduler, tmp_path, submitted):
    items = read_items(cubes)
    folder = tmp_path / "campaign"
    rows = run_campaign(items, folder, scheduler=scheduler)
    assert [(row.session, row.state) for row in rows] == [
        ("bad", "failed"), ("c0", "done"), ("c1", "done")
    ]  # fmt: skip
    assert f"{cubes}/bad/session.toml: format: is 'palpate-session/0'" in rows[0].message
    assert len({row.young_modulus for row in rows}) == 3
    with (folder / "table.csv").open() as file:
        read = list(csv.DictReader(file))
    assert [row["session"] for row in read] == [row.session for row in rows]
    assert float(read[1]["young_modulus"]) == rows[1].young_modulus
    results = sorted((folder / "results").iterdir())
    for path in results:
        kind, changed, sums = folder_changes(path)
        # Estimate, surface, list of inputs.
        assert (kind, changed, len(sums)) == ("fit", {}, 3)

    # What is done is not done again, even where the table is lost; what failed is tried again.
    before, handed = _tree(folder), list(submitted)
    submitted.clear()
    (folder / "campaign.sqlite").unlink()
    (cubes / "bad" / "session.toml").write_text((cubes / "c0" / "session.toml").read_text())
    again = run_campaign(items, folder, scheduler=scheduler)
    assert sorted(handed) == [("fit", f"{name}/session.toml") for name in ("bad", "c0", "c1")]
    assert submitted == [("fit", "bad/session.toml")]
    assert [row.young_modulus for row in again[1:]] == [row.young_modulus for row in rows[1:]]
    results = {name: text for name, text in _tree(folder).items() if name.parts[0] == "results"}
    assert results == {name: text for name, text in before.items() if name.parts[0] == "results"}


def test_two_sessions_of_the_same_content_are_one_piece_of_work(
    cubes, scheduler, tmp_path, submitted
):
    listed = tmp_path / "list.txt"
    other = tmp_path / "copy" / "c0"
    other.mkdir(parents=True)
    for file in (cubes / "c0").iterdir():
        (other / file.name).write_bytes(file.read_bytes())
    listed.write_text("cubes/c0\ncopy/c0, again\nnowhere\n")
    rows = run_campaign(read_items(listed), tmp_path / "campaign", scheduler=scheduler)
    assert len(submitted) == 1
    assert [row.state for row in rows] == ["done", "done", "failed"]
    assert rows[0].address == rows[1].address != ""
    assert "nowhere: no such file or folder" in rows[2].message


def test_motion_in_pictures_is_measured_once(cube, scheduler, tmp_path, submitted, monkeypatch):
    shutil.copytree(cube, tmp_path / "seen" / "cube")
    with_pictures(tmp_path / "seen" / "cube")
    asked = []

    def measure_pictures(session, *, known=None, pose):
        """What the model says of the pictures, in the place of cameras."""
        if known or not unread_probings(session):
            return known or {}
        asked.append(pose)
        field = read_session(cube).probings[0].displacement
        field = replace(field, vertex=np.flatnonzero(session.mesh.vertices[:, 2] > 0))
        note = f"{session.path.parent / 'rig.toml'}: was looked at"
        motion = ProbingMotion(field, MotionNotes(start=(note,)))
        return {session.probings[0].name: motion}

    monkeypatch.setattr(work_file, "measure_pictures", measure_pictures)
    items, folder = read_items(tmp_path / "seen"), tmp_path / "campaign"
    (first,) = run_campaign(items, folder, scheduler=scheduler)
    assert first.state == "done"
    assert f"{tmp_path}/seen/cube/rig.toml: was looked at" in first.message
    assert [kind for kind, _ in submitted] == ["motion", "fit"]
    # Other options ask for another fit, not for another look at the pictures.
    other = FitOptions(poisson_range=(0.0, 0.45))
    (second,) = run_campaign(items, folder, options=other, scheduler=scheduler)
    assert [kind for kind, _ in submitted] == ["motion", "fit", "fit"]
    assert asked == ["auto"]
    assert second.address != first.address
    # Another choice of the pose does.
    (third,) = run_campaign(
        items, folder, options=replace(other, pose="given"), scheduler=scheduler
    )
    assert [kind for kind, _ in submitted][3:] == ["motion", "fit"]
    assert asked == ["auto", "given"]
    assert third.address != second.address
    # The fit knows nothing of where the displacements come from: the model's own constants.
    assert first.young_modulus_low < 2 * SHEAR * (1 + NU) < first.young_modulus_high


def test_a_campaign_that_is_stopped_goes_on(cubes, scheduler, tmp_path, submitted, monkeypatch):
    items, folder = read_items(cubes), tmp_path / "campaign"
    saved = []

    def stopped(self, work, files, save=Store.save_result):
        save(self, work, files)
        saved.append(work.session.session)
        # After the result is there and before its row is: the worst moment.
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Store, "save_result", stopped)
        with pytest.raises(KeyboardInterrupt):
            run_campaign(items, folder, scheduler=scheduler)
    assert {row.state for row in Store(folder).rows()} <= {"waiting", "failed"}
    submitted.clear()
    rows = run_campaign(items, folder, scheduler=scheduler)
    assert [row.state for row in rows] == ["failed", "done", "done"]
    handed = {session for _, session in submitted} - {"bad/session.toml"}
    assert handed == {f"c{k}/session.toml" for k in range(2)} - {saved[0]}


@contextmanager
def _small_worker(*, threads):
    """Address of a scheduler with one worker of 0.8 GiB for all its threads.

    It lives in this process, whose memory after some thousand tests would make it pause.
    """
    pauses = {f"distributed.worker.memory.{k}": False for k in ("target", "spill", "pause")}
    with dask.config.set(pauses), distributed.LocalCluster(
        n_workers=1, threads_per_worker=threads, processes=False, protocol="tls",
        dashboard_address=":0", memory_limit="0.8GiB",
    ) as cluster:  # fmt: skip
        yield cluster.scheduler_address


def test_a_body_beyond_a_thread_s_share_of_memory_is_a_row(cube, tmp_path):
    # The program itself counts 0.4 GB: a worker of 0.8 GiB has that, its two threads have not.
    with _small_worker(threads=2) as address:
        (row,) = run_campaign(read_items(cube.parent), tmp_path / "c", scheduler=address)
    assert row.state == "failed"
    assert "for one probing would take 0.4 GB of memory; 0.4 GB can be used here" in row.message


def test_a_body_beyond_memory_does_not_keep_the_others_from_their_results(cubes, tmp_path):
    shutil.copytree(cubes / "c0", cubes / "large")
    write_mesh(cubes / "large" / "mesh.ply", box(size=(0.04, 0.04, 0.04), cells=18))
    with _small_worker(threads=1) as address:
        rows = run_campaign(read_items(cubes), tmp_path / "c", scheduler=address)
    assert {row.session: row.state for row in rows} == {
        "bad": "failed", "c0": "done", "c1": "done", "large": "failed"
    }  # fmt: skip
    refused = rows[-1].message
    assert refused.startswith(f"{cubes}/large/mesh.ply: the mesh has 1946 vertices")
    assert "for one probing would take 0.9 GB of memory; 0.8 GB can be used here" in refused


def test_only_one_process_works_on_a_campaign(cubes, tmp_path):
    folder = tmp_path / "campaign"
    folder.mkdir()
    with (
        atomic_replacement(folder / "table.csv"),
        pytest.raises(InUseError, match="is being written by"),
    ):
        run_campaign(read_items(cubes), folder)


def test_what_is_no_campaign_is_left_alone(cubes, tmp_path):
    with pytest.raises(InputError, match="is there and no campaign"):
        run_campaign(read_items(cubes), cubes)
    with pytest.raises(RecordError, match=r"holds no campaign.sqlite"):
        Store(tmp_path).rows()


def test_a_campaign_that_cannot_begin_leaves_nothing(cubes, tmp_path, monkeypatch):
    items, folder = read_items(cubes), tmp_path / "a" / "campaign"
    with pytest.raises(InputError, match="no scheduler answers at tls://nonsense"):
        run_campaign(items, folder, scheduler="tls://nonsense")
    assert not (tmp_path / "a").exists()

    def full(*_, **__):
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(sqlite3, "connect", full)
    with pytest.raises(RecordError, match="disk is full"):
        run_campaign(items, folder)
    assert not (tmp_path / "a").exists()


def test_a_disk_that_fills_ends_it(cubes, scheduler, tmp_path, monkeypatch):
    items, folder = read_items(cubes), tmp_path / "campaign"

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        # Of what is written last, the list of a result's files.
        patched.setattr(results, "sums_text", full)
        with pytest.raises(RecordError) as raised:
            run_campaign(items, folder, scheduler=scheduler)
    assert "No space left on device" in str(raised.value)
    assert "make room" in str(raised.value)
    assert list((folder / "results").iterdir()) == []
    (folder / "campaign.sqlite").write_bytes(b"cut off")
    with pytest.raises(RecordError, match="which is made anew from the results"):
        Store(folder).rows()


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """A session whose probings n01 and n02 share their pictures at rest, which n03 does not."""
    return write_seen_session(tmp_path_factory.mktemp("parts") / "seen")


@pytest.fixture
def folder(seen, tmp_path):
    """A copy of the session that may be changed, in a folder of its own."""
    return shutil.copytree(seen, tmp_path / "parts" / "seen")


@pytest.fixture
def begun(monkeypatch):
    """Works that a campaign hands to workers."""
    works, submit = [], _Run._submit

    def seen(self, work, before):
        works.append(work)
        return submit(self, work, before)

    monkeypatch.setattr(_Run, "_submit", seen)
    return works


def _pictures(work):
    names = {name.rpartition("/")[2] for name in work.session.files}
    return {name.rpartition("_c")[0] for name in names if name.endswith(".png")}


def test_a_work_has_the_pictures_of_its_probings_alone(seen):
    packed = pack_session(seen)
    shared, unshared = motion_works(seen, packed, GIVEN)
    assert list(shared.keys) == ["n01", "n02"]
    assert _pictures(shared) == {"rest", "n01_1", "n01_2", "n02"}
    assert list(unshared.keys) == ["n03"]
    assert _pictures(unshared) == {"other", "n03"}
    others = {name for name in packed.files if not name.endswith(".png")}
    assert others <= set(unshared.session.files)
    assert len({shared.digest, unshared.digest, Work("fit", packed, GIVEN).digest}) == 3


@pytest.mark.parametrize(
    ("instants", "expected"),
    [
        ([1, 2], [[0, 1]]),
        ([300], [[0]]),
        ([300, 1, 300], [[0], [1, 2]]),
        ([300, 300, 1], [[0], [1, 2]]),
        ([10] * 7, [[0, 1, 2], [3, 4, 5, 6]]),
        ([25, 24], [[0, 1]]),
        ([24, 1, 25], [[0, 1], [2]]),
    ],
)
def test_probings_with_many_instants_are_several_works(instants, expected):
    pieces = [
        [int(name) for name in piece]
        for piece in _pieces(dict(zip(map(str, range(9)), instants, strict=False)))
    ]
    assert pieces == expected
    assert all(sum(instants[k] for k in piece) >= min(25, sum(instants)) for piece in pieces)


@pytest.mark.slow
def test_one_session_s_pictures_are_measured_by_several_workers(
    seen, scheduler, tmp_path, begun, monkeypatch
):
    """The same bytes as in one piece: a start from the same pictures is the same start."""
    monkeypatch.setattr(campaign, "_LEAST_INSTANTS", 1)
    (row,) = run_campaign(
        read_items(seen.parent), tmp_path / "campaign", options=GIVEN, scheduler=scheduler
    )
    measured = [list(work.keys) for work in begun if work.kind == "motion"]
    assert (row.state, measured) == ("done", [["n01"], ["n02"], ["n03"]])
    whole = do_work(Work("fit", pack_session(seen), GIVEN), folder=tmp_path / "alone")
    result = Store(tmp_path / "campaign").result_at(row.address)
    for name, content in whole.files.items():
        assert (result / name).read_bytes() == content, name


def test_displacements_in_files_are_no_work(cube):
    assert motion_works(cube, pack_session(cube), GIVEN) == ()


@pytest.mark.slow
def test_motions_apart_give_the_bytes_of_one_fit(seen, scheduler, tmp_path, begun):
    campaign = tmp_path / "campaign"
    (row,) = run_campaign(read_items(seen.parent), campaign, options=GIVEN, scheduler=scheduler)
    assert (row.state, row.message != "") == ("done", True)
    assert [(work.kind, list(work.keys)) for work in begun] == [
        ("motion", ["n01", "n02"]), ("motion", ["n03"]), ("fit", ["n01", "n02", "n03"]),
    ]  # fmt: skip
    assert len(begun[-1].keys) == 3
    whole = do_work(Work("fit", pack_session(seen), GIVEN), folder=tmp_path / "alone")
    result = Store(campaign).result_at(row.address)
    for name, content in whole.files.items():
        assert (result / name).read_bytes() == content, name


@pytest.mark.slow
def test_what_is_measured_stays_so(folder, scheduler, tmp_path, begun):
    items, campaign = read_items(folder.parent), tmp_path / "campaign"

    def run():
        begun.clear()
        (row,) = run_campaign(items, campaign, options=GIVEN, scheduler=scheduler)
        return row, [(work.kind, list(work.keys)) for work in begun if work.kind == "motion"]

    # A picture that is no picture: the others are measured once for all.
    picture = folder / "n03_c0.png"
    good = picture.read_bytes()
    picture.write_bytes(b"nothing")
    row, works = run()
    assert row.state == "failed"
    assert str(picture) in row.message
    assert len(works) == 2
    picture.write_bytes(good)
    row, works = run()
    assert row.state == "done"
    assert works == [("motion", ["n03"])]
    # Another force asks for another fit alone.
    file = folder / "session.toml"
    file.write_text(file.read_text().replace("-1.2", "-1.3"))
    again, works = run()
    assert works == []
    assert again.address != row.address
    # So does nothing that has not changed.
    assert run() == (again, [])
    assert begun == []


def test_a_session_without_its_rig_is_a_row(folder, scheduler, tmp_path, begun):
    (folder / "rig.toml").unlink()
    (row,) = run_campaign(
        read_items(folder.parent), tmp_path / "campaign", options=GIVEN, scheduler=scheduler
    )
    assert row.state == "failed"
    assert "rig.toml" in row.message
    assert begun == []


def test_a_full_disk_ends_the_campaign_and_is_no_row(folder, scheduler, tmp_path, monkeypatch):
    def full(*_):
        raise RecordError("table: the disk is full")

    monkeypatch.setattr(Store, "is_done", full)
    with pytest.raises(RecordError, match="the disk is full"):
        run_campaign(read_items(folder.parent), tmp_path / "campaign", scheduler=scheduler)


@pytest.fixture
def local(scheduler, monkeypatch):
    """Workers of a campaign without `--scheduler`: those in this process."""
    start = campaign.started_engine
    monkeypatch.setattr(campaign, "started_engine", lambda *_, **__: start(scheduler, None))


def _kinds(begun):
    """All but the session that is none."""
    kinds = [(work.kind, work.session.session.partition("/")[0]) for work in begun]
    return [kind for kind in kinds if kind != ("fit", "bad")]


def test_a_body_is_the_mesh_whatever_is_measured_on_it(cubes, tmp_path):
    write_mesh(cubes / "bad" / "mesh.ply", box(size=(0.04, 0.04, 0.04), cells=3))
    shutil.copytree(cubes / "bad", cubes / "alone", ignore=shutil.ignore_patterns("session.toml"))
    text = (cubes / "c0" / "session.toml").read_text()
    (cubes / "alone" / "session.toml").write_text(text)
    meshes = shared_meshes(read_items(cubes))
    # The one that is no session has the mesh of "alone" beside it, and does not name it.
    assert sorted(meshes) == ["c0", "c1"]
    assert len(set(meshes.values())) == 1
    packed = [pack_session(cubes / name) for name in meshes]
    same = {body_work(session, GIVEN, meshes["c0"]).digest for session in packed}
    assert len(same) == 1
    assert same.isdisjoint({Work("fit", session, GIVEN).digest for session in packed})


@pytest.mark.slow
def test_fits_of_one_body_wait_for_what_they_share(cubes, local, tmp_path, begun):
    shutil.copytree(cubes / "c0", cubes / "other")
    write_mesh(cubes / "other" / "mesh.ply", box(size=(0.04, 0.04, 0.04), cells=3))
    rows = run_campaign(read_items(cubes), tmp_path / "campaign")
    assert [row.state for row in rows] == ["failed", "done", "done", "done"]
    assert _kinds(begun)[0] == ("body", "c0")
    assert sorted(_kinds(begun)[1:]) == [("fit", "c0"), ("fit", "c1"), ("fit", "other")]
    assert [work.shared_body for work in begun if work.kind == "fit"].count(True) == 2
    for name, row in (("c0", rows[1]), ("c1", rows[2])):
        alone = do_work(Work("fit", pack_session(cubes / name), FitOptions()), folder=tmp_path)
        result = Store(tmp_path / "campaign").result_at(row.address)
        for file, content in alone.files.items():
            assert (result / file).read_bytes() == content, (name, file)


@pytest.mark.slow
def test_few_sessions_are_read_while_a_body_is_computed(cubes, local, tmp_path, begun, monkeypatch):
    for number in range(2, 4):
        shutil.copytree(cubes / "c0", cubes / f"c{number}")
        file = cubes / f"c{number}" / "session.toml"
        file.write_text(file.read_text().replace("-1.2", f"-1.{number + 2}"))
    held = []

    def stored(self, work, outcome, store=_Run._store_outcome):
        if work.kind == "body":
            held.append(len(self._items_of))
        store(self, work, outcome)

    monkeypatch.setattr(_Run, "_store_outcome", stored)
    monkeypatch.setattr(campaign, "_FITS_PER_THREAD", 1)
    rows = run_campaign(read_items(cubes), tmp_path / "campaign")
    assert [row.state for row in rows] == ["failed"] + 4 * ["done"]
    # Two workers.
    assert held == [2]
    assert [kind for kind, _ in _kinds(begun)] == ["body"] + 4 * ["fit"]
    assert not (tmp_path / "campaign" / "bodies").exists()


def test_a_body_that_fails_leaves_each_fit_its_own_message(
    cubes, local, tmp_path, begun, monkeypatch
):
    def failing(*_, **__):
        raise InputError("the body failed")

    monkeypatch.setattr(work, "prepare_body", failing)
    rows = run_campaign(read_items(cubes), tmp_path / "campaign")
    assert [row.state for row in rows] == ["failed", "done", "done"]
    assert [kind for kind, _ in _kinds(begun)] == ["body", "fit", "fit"]


def test_workers_elsewhere_compute_each_body_for_themselves(cubes, scheduler, tmp_path, begun):
    run_campaign(read_items(cubes), tmp_path / "campaign", scheduler=scheduler)
    assert sorted(_kinds(begun)) == [("fit", "c0"), ("fit", "c1")]
    assert [work.shared_body for work in begun].count(True) == 2

"""A campaign as a whole: on workers, interrupted, gone on with."""

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
from surfaces import box

from palpate.campaign import FitOptions, Store, read_items, run_campaign, work as work_file
from palpate.campaign.engine import Engine
from palpate.disk import atomic_replacement
from palpate.errors import InputError, InUseError, RecordError
from palpate.geometry import write_mesh
from palpate.pipeline import MotionNotes, ProbingMotion, unread_probings
from palpate.records import folder_changes, read_session
from palpate.records.files import results


@pytest.fixture
def submitted(monkeypatch):
    """Works that were handed to workers, by kind and session."""
    works, submit = [], Engine.submit

    def seen(self, function, work):
        works.append((work.kind, work.session.session))
        submit(self, function, work)

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
    kept = []

    def stopped(self, work, package, save=Store.save_result):
        save(self, work, package)
        kept.append(work.session.session)
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
    assert handed == {f"c{k}/session.toml" for k in range(2)} - {kept[0]}


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
    assert "needs 0.4 GB of memory for one probing; 0.4 GB can be used here" in row.message


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
    assert "needs 0.9 GB of memory for one probing; 0.8 GB can be used here" in refused


def test_only_one_process_works_on_a_campaign(cubes, tmp_path):
    folder = tmp_path / "campaign"
    folder.mkdir()
    with (
        atomic_replacement([folder / "table.csv"]),
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
        patched.setattr(results, "write_text", full)
        with pytest.raises(RecordError) as raised:
            run_campaign(items, folder, scheduler=scheduler)
    assert "No space left on device" in str(raised.value)
    assert "make room" in str(raised.value)
    assert list((folder / "results").iterdir()) == []
    (folder / "campaign.sqlite").write_bytes(b"cut off")
    with pytest.raises(RecordError, match="which is made anew from the results"):
        Store(folder).rows()

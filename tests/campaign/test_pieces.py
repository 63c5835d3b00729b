"""What comes before a fit, as pieces of work of their own: motions in pictures, bodies."""

import shutil

import pytest
from pipeline.saved.seen_session import write_seen_session
from surfaces import box

from palpate.campaign import (
    FitOptions,
    Store,
    Work,
    campaign,
    do_work,
    pack_session,
    read_items,
    run_campaign,
    work,
)
from palpate.campaign.campaign import _pieces, _Run, body_work, motion_works, shared_meshes
from palpate.errors import InputError, RecordError
from palpate.geometry import write_mesh

GIVEN = FitOptions(pose="given")


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

    def seen(self, work):
        works.append(work)
        submit(self, work)

    monkeypatch.setattr(_Run, "_submit", seen)
    return works


def _pictures(work):
    names = {name.rpartition("/")[2] for name in work.session.package.files}
    return {name.rpartition("_c")[0] for name in names if name.endswith(".png")}


def test_a_work_has_the_pictures_of_its_probings_alone(seen):
    packed = pack_session(seen)
    shared, own = motion_works(seen, packed, GIVEN)
    assert list(shared.keys) == ["n01", "n02"]
    assert _pictures(shared) == {"rest", "n01_1", "n01_2", "n02"}
    assert list(own.keys) == ["n03"]
    assert _pictures(own) == {"other", "n03"}
    others = {name for name in packed.package.files if not name.endswith(".png")}
    assert others <= set(own.session.package.files)
    assert len({shared.digest, own.digest, Work("fit", packed, GIVEN).digest}) == 3


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
    found = [
        [int(name) for name in piece]
        for piece in _pieces(dict(zip(map(str, range(9)), instants, strict=False)))
    ]
    assert found == expected
    assert all(sum(instants[k] for k in piece) >= min(25, sum(instants)) for piece in found)


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
    for name, content in whole.package.files.items():
        assert (result / name).read_bytes() == content, name


def test_displacements_in_files_are_no_work(cube):
    assert motion_works(cube, pack_session(cube), GIVEN) == ()


@pytest.mark.slow
def test_motions_apart_give_the_bytes_of_one_fit(seen, scheduler, tmp_path, begun):
    campaign = tmp_path / "campaign"
    (row,) = run_campaign(read_items(seen.parent), campaign, options=GIVEN, scheduler=scheduler)
    assert (row.state, row.message != "") == ("done", True)
    assert [(work.kind, list(work.keys)) for work in begun] == [
        ("motion", ["n01", "n02"]), ("motion", ["n03"]), ("fit", []),
    ]  # fmt: skip
    assert len(begun[-1].motions) == 3
    whole = do_work(Work("fit", pack_session(seen), GIVEN), folder=tmp_path / "alone")
    assert whole.failure == ""
    result = Store(campaign).result_at(row.address)
    for name, content in whole.package.files.items():
        assert (result / name).read_bytes() == content, name


@pytest.mark.slow
def test_what_is_measured_stays_so(folder, scheduler, tmp_path, begun):
    items, campaign = read_items(folder.parent), tmp_path / "campaign"

    def run():
        begun.clear()
        (row,) = run_campaign(items, campaign, options=GIVEN, scheduler=scheduler)
        return row, [(work.kind, list(work.keys)) for work in begun]

    # A picture that is no picture: the others are measured once for all.
    picture = folder / "n03_c0.png"
    good = picture.read_bytes()
    picture.write_bytes(b"nothing")
    row, works = run()
    assert row.state == "failed"
    assert str(picture) in row.message
    assert [kind for kind, _ in works] == ["motion", "motion"]
    picture.write_bytes(good)
    row, works = run()
    assert row.state == "done"
    assert works == [("motion", ["n03"]), ("fit", [])]
    # Another force asks for another fit alone.
    file = folder / "session.toml"
    file.write_text(file.read_text().replace("-1.2", "-1.3"))
    row, works = run()
    assert works == [("fit", [])]
    # So does nothing that has not changed.
    assert run() == (row, [])


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
    return [each for each in kinds if each != ("fit", "bad")]


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
    same = {body_work(each, GIVEN, meshes["c0"]).digest for each in packed}
    assert len(same) == 1
    assert same.isdisjoint({Work("fit", each, GIVEN).digest for each in packed})


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
        for file, content in alone.package.files.items():
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
            held.append(sum(map(len, self._fits_after.values())))
        store(self, work, outcome)

    monkeypatch.setattr(_Run, "_store_outcome", stored)
    monkeypatch.setattr(campaign, "_HELD_PER_THREAD", 1)
    rows = run_campaign(read_items(cubes), tmp_path / "campaign")
    assert [row.state for row in rows] == ["failed"] + 4 * ["done"]
    # Two workers.
    assert held == [2]
    assert [kind for kind, _ in _kinds(begun)] == ["body"] + 4 * ["fit"]


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

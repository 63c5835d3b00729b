"""What can be said about cameras and pictures before any motion is measured."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from flow_samples import SHAPE, SIDE, rig
from surfaces import box

from palpate.errors import PalpateError
from palpate.pipeline import survey_cameras
from palpate.records import Contact, Images, Probing, Session, Step, write_rig


@pytest.fixture
def session(tmp_path):
    """Three steps of a cube that both cameras see whole, grey levels 30 to 219."""
    rng = np.random.default_rng(5)
    for name in ("c0", "c1"):
        for step in range(3):
            grey = rng.integers(30, 220, SHAPE, dtype=np.uint8)
            cv2.imwrite(str(tmp_path / f"s{step}_{name}.png"), grey)
    write_rig(tmp_path / "rig.toml", rig())
    steps = tuple(Step(f"s{k}", f"s{k}_{{camera}}.png") for k in range(3))
    nothing = np.zeros(0, dtype=np.int64)
    return Session(
        "cube", tmp_path / "session.toml", box(size=(SIDE,) * 3, cells=2), nothing, (), None, None,
        tmp_path / "rig.toml", (), steps,
    )  # fmt: skip


def repainted(session, name, change):
    file = str(session.path.parent / name)
    cv2.imwrite(file, change(cv2.imread(file, cv2.IMREAD_UNCHANGED)))


def test_every_picture_is_counted_and_the_mesh_is_seen(session):
    surveys, notes = survey_cameras(session)
    assert [(s.name, len(s.pictures)) for s in surveys] == [("c0", 3), ("c1", 3)]
    # The second camera stands 40 mm beside the first: 100 px of its 160 are past the cube.
    assert surveys[0].sees == 1.0
    assert 0.0 < surveys[1].sees < 1.0
    assert {p.size for s in surveys for p in s.pictures} == {SHAPE[::-1]}
    # Uniform from 30 to 219: the percentiles are 1.9 levels inside the ends.
    assert surveys[0].pictures[0].grey == pytest.approx((32, 217), abs=2)
    assert notes == ()


def test_without_a_rig_there_is_nothing_to_look_at(session, cube_probing):
    held = np.arange(2)
    measured = replace(
        session, rig=None, steps=(), held_triangles=held, probings=(cube_probing,)
    )  # fmt: skip
    assert survey_cameras(measured) == ((), ())


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            lambda grey: np.where(grey > 200, 255, grey).astype(np.uint8),
            "% of the pixels are white",
        ),
        (lambda grey: grey // 10, "1 of 3 pictures are dark"),
    ],
)
def test_bad_exposure_is_said_of_its_camera(session, change, says):
    repainted(session, "s1_c1.png", change)
    _, notes = survey_cameras(session)
    assert len(notes) == 1
    assert notes[0].startswith("Camera c1: ")
    assert says in notes[0]


def test_a_camera_that_looks_past_the_object_is_named(session):
    _, notes = survey_cameras(replace(session, mesh=box(size=(SIDE,) * 3, origin=(1.0, 0.0, 0.0))))
    assert [note.split(":")[0] for note in notes] == ["Camera c0", "Camera c1"]
    assert "no vertex of the mesh" in notes[0]


def test_a_picture_of_the_last_step_that_is_cut_off_is_refused(session):
    file = session.path.parent / "s2_c1.png"
    file.write_bytes(file.read_bytes()[:900])
    with pytest.raises(PalpateError, match="step 's2', camera 'c1'"):
        survey_cameras(session)


@pytest.mark.parametrize("copy", ["s1_c1.png", "s1_c0.png", "s0_c1.png"])
def test_one_picture_under_two_names_is_refused(session, copy):
    folder = session.path.parent
    (folder / copy).write_bytes((folder / "s0_c0.png").read_bytes())
    with pytest.raises(PalpateError, match=f"'{copy}' and 's0_c0.png' are the same picture"):
        survey_cameras(session)


def test_the_rest_may_be_copied_for_every_probing(session, cube_probing):
    folder = session.path.parent
    for name in ("c0", "c1"):
        (folder / f"s2_{name}.png").write_bytes((folder / f"s0_{name}.png").read_bytes())
    first = replace(cube_probing, images=Images("s0_{camera}.png", ("s1_{camera}.png",)))
    second = replace(first, name="n02", images=Images("s2_{camera}.png", ("s1_{camera}.png",)))
    shared = replace(session, steps=(), held_triangles=np.arange(2), probings=(first, second))
    survey_cameras(shared)
    images = Images("s0_{camera}.png", ("s2_{camera}.png",))
    still = replace(shared, probings=(replace(first, images=images),))
    with pytest.raises(PalpateError, match="are the same picture"):
        survey_cameras(still)


@pytest.fixture
def cube_probing():
    contact = Contact(np.array([0.02, 0.02, 0.04]), 0.006, "smooth")
    return Probing("n01", contact, np.array([0.0, 0.0, -1.2]), None, None, None, None, None)

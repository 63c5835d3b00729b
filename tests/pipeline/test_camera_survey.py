"""What can be said about cameras and pictures before any motion is measured."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from flow_samples import ABOVE, FOCAL, SHAPE, SIDE, camera, rig
from surfaces import box

from palpate.errors import PalpateError
from palpate.pipeline import survey_cameras, survey_view
from palpate.records import Contact, Images, Probing, Rig, Session, Step, write_rig
from palpate.vision import JointFlow


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


# Wave number of the painted texture [1 / px].
WAVE = 0.5


def painted(session, *, contrast=30.0, wave=WAVE):
    """The session with a texture of one wave number on the upper face, which both cameras see."""
    rng = np.random.default_rng(7)
    angle, phase = 2 * np.pi * rng.random((2, 60))
    across = wave * FOCAL / ABOVE * np.stack([np.cos(angle), np.sin(angle)])
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    cameras = camera(), camera("c1", x=0.7 * SIDE)
    for one, middle in zip(cameras, (0.5 * SIDE, 0.7 * SIDE), strict=True):
        x = middle + ABOVE * (column - 79.5) / FOCAL
        y = 0.5 * SIDE - ABOVE * (row - 59.5) / FOCAL
        waves = np.cos(x[..., None] * across[0] + y[..., None] * across[1] + phase)
        on = (x > 0) & (x < SIDE) & (y > 0) & (y < SIDE)
        grey = np.where(on, 120 + contrast * np.sqrt(2 / 60) * waves.sum(axis=2), 10.0)
        grey = np.clip(grey + rng.normal(0.0, 1.0, SHAPE), 0, 255).astype(np.uint8)
        cv2.imwrite(str(session.path.parent / f"s0_{one.name}.png"), grey)
    write_rig(session.path.parent / "rig.toml", Rig(cameras, 0, "rig.toml"))
    return replace(session, mesh=box(size=(SIDE,) * 3, cells=8))


def test_what_the_first_pictures_promise_is_told(session):
    found, _ = survey_view(painted(session))
    # The reference camera sees all of the face, the other one 0.92 of it; rims cut windows.
    assert 0.6 * found.points < found.followed <= found.points
    assert found.points == pytest.approx((SIDE * FOCAL / ABOVE / JointFlow().step) ** 2, rel=0.15)
    assert 20 <= found.vertices <= 81
    assert found.windows >= 12
    # Of waves in all directions the slope along one of two axes has half of the square; differences
    # of pixels see 4 % less of it.
    assert found.structure == pytest.approx([np.sqrt(2) / WAVE] * 2, rel=0.15)


@pytest.mark.parametrize(
    ("look", "says"),
    [
        ({"contrast": 0.2}, "of the windows have too little texture"),
        ({"wave": 0.1 * WAVE}, "is coarse or out of focus"),
    ],
)
def test_pictures_that_cannot_be_followed_well_are_named(session, look, says):
    _, notes = survey_view(painted(session, **look))
    assert any(says in note for note in notes), notes


def test_without_pictures_there_is_no_view(session, cube_probing):
    measured = replace(
        session, rig=None, steps=(), held_triangles=np.arange(2), probings=(cube_probing,)
    )
    assert survey_view(measured) == (None, ())


def test_pictures_that_show_nothing_in_common_are_no_reason_to_stop(session):
    found, notes = survey_view(session)
    assert found.points > 0
    assert notes[0].startswith("The rig cannot be checked against the pictures: ")

"""What can be said about a session before any fit."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from cube_session import cube_session as cube_session
from flow_samples import ABOVE, FOCAL, SHAPE, SIDE, camera, rig
from program_files import write_cells
from surfaces import box

from palpate.errors import CalibrationError, RecordError
from palpate.geometry import TriangleMesh
from palpate.pipeline import (
    ProbingSurvey,
    session_outlook,
    size_notes,
    survey_cameras,
    survey_field,
    survey_probing,
    survey_view,
    triangulated,
)
from palpate.records import (
    Contact,
    PictureTracks,
    Probing,
    Rig,
    Session,
    read_measured,
    read_rig,
    read_session,
    write_rig,
)
from palpate.records.session import Step
from palpate.vision import JointFlow, project

# Wave number of the painted texture [1 / px].
WAVE = 0.5


@pytest.fixture
def session(cube_session):
    return read_session(cube_session)


def test_figures_of_a_probing_have_their_closed_forms(session):
    survey = survey_probing(session, session.probings[0])
    # 218 vertices, 49 of them on the floor; one row is NaN.
    assert (survey.observed, survey.missing) == (218 - 49 - 1, 1)
    assert survey.median_displacement == pytest.approx(5e-4)
    # Every vector is (0.3, 0, -0.4) mm with 0.1 mm of sigma.
    assert survey.signal_to_noise == pytest.approx(5.0)
    # Two legs and a hypotenuse a triangle.
    assert survey.elements_per_radius == pytest.approx(0.006 / (0.04 / 6 * (2 + 2**0.5) / 3))
    # The four squares of 6.67 mm around a grid vertex: their diagonals pass it at 4.7 mm.
    assert survey.patch_triangles == 8
    # Everything free lies within eight radii (48 mm) of the top's centre.
    assert survey.near == survey.observed


def test_the_tangential_signal_is_that_along_the_surface(session):
    field = session.probings[0].displacement
    # On the top 0.3 of 0.5 mm lie along the surface.
    top = np.isclose(field.points[:, 2], 0.04) & (np.abs(field.points[:, :2] - 0.02) < 0.015).all(1)
    only = replace(field, displacement=np.where(top[:, None], field.displacement, np.nan))
    probing = replace(session.probings[0], displacement=only)
    survey = survey_probing(session, probing)
    assert survey.observed == 25
    assert survey.tangential_signal == pytest.approx(3.0)


def test_only_points_near_the_contact_count_as_near(session):
    contact = replace(session.probings[0].contact, radius=0.0015)
    survey = survey_probing(session, replace(session.probings[0], contact=contact))
    field = session.probings[0].displacement
    away = np.linalg.norm(field.points - contact.point, axis=1)
    # Eight radii are 12 mm: the grid of 6.67 mm has nine vertices there.
    assert survey.near == 9 == (away < 0.012).sum()


def test_a_field_without_any_measured_point_has_no_medians(session):
    field = session.probings[0].displacement
    nothing = replace(field, displacement=np.full_like(field.displacement, np.nan))
    survey = survey_field(nothing)
    assert (survey.observed, survey.missing) == (0, len(field.points))
    assert np.isnan([survey.median_displacement, survey.median_sigma]).all()
    probing = survey_probing(session, replace(session.probings[0], displacement=nothing))
    assert np.isnan(probing.signal_to_noise)


def test_medians_of_a_field(session):
    survey = survey_field(session.probings[0].displacement)
    assert survey.median_displacement == pytest.approx(5e-4)
    assert survey.median_sigma == pytest.approx(1e-4)


def test_what_the_data_promise_is_said_in_words(session):
    few = ProbingSurvey("a", 9, 2.0, 5, 0, 0.01, 20.0, 19.0, 19)
    bending = {"young_modulus": 0.021, "poisson_ratio": 0.3, "shear_modulus": 0.2}
    text = session_outlook(session, [few], bending)
    assert "Young's modulus to about 2.1 %, next to nothing about Poisson's ratio" in text
    all_told = session_outlook(session, [few], bending | {"poisson_ratio": 0.0041})
    assert "Poisson's ratio to about 0.004." in all_told
    nothing = dict.fromkeys(bending, np.inf)
    assert "next to nothing about Young's modulus" in session_outlook(session, [few], nothing)
    assert "tell" not in session_outlook(session, [few])
    enough = replace(few, near=20)
    coarse = replace(enough, elements_per_radius=0.5, signal_to_noise=2.9)
    text = session_outlook(session, [coarse])
    assert "below 3 sigma in 1 of 1 probing (a)" in text
    assert "smaller than an element in 1 probing:" in text
    for text in (session_outlook(session, [enough]), session_outlook(session, [few, coarse])):
        assert "No standard deviations are given" not in text
    silent = replace(enough, signal_to_noise=np.nan, tangential_signal=np.nan)
    assert "No standard deviations are given" in session_outlook(session, [silent])


@pytest.mark.parametrize(
    ("vertices", "cost"),
    [(4999, "about 4 minutes and 3.7 GB"), (20_000, "about 18 minutes and 4.1 GB")],
)
def test_what_a_large_mesh_costs_is_said(session, vertices, cost):
    assert size_notes(session) == []
    more = np.concatenate([session.mesh.vertices, np.zeros((vertices - 218, 3))])
    # Vertices that no triangle has are no mesh of any object; only their number is asked for.
    large = replace(session, mesh=TriangleMesh(more, session.mesh.triangles))
    (note,) = size_notes(large)
    assert f"{vertices} vertices: a fit will take {cost}" in note
    assert "palpate mesh --vertices 2000" in note


@pytest.fixture
def seen(tmp_path):
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


def repainted(seen, name, change):
    file = str(seen.path.parent / name)
    cv2.imwrite(file, change(cv2.imread(file, cv2.IMREAD_UNCHANGED)))


def test_every_picture_is_counted_and_the_mesh_is_seen(seen):
    surveys, notes = survey_cameras(seen)
    assert [(s.name, len(s.pictures)) for s in surveys] == [("c0", 3), ("c1", 3)]
    # The second camera stands 40 mm beside the first: 100 px of its 160 are past the cube.
    assert surveys[0].sees == 1.0
    assert 0.0 < surveys[1].sees < 1.0
    assert {p.size for s in surveys for p in s.pictures} == {SHAPE[::-1]}
    # Uniform from 30 to 219: the percentiles are 1.9 levels inside the ends.
    assert surveys[0].pictures[0].grey == pytest.approx((32, 217), abs=2)
    assert notes == ()


def test_without_a_rig_there_is_nothing_to_look_at(seen, cube_probing):
    held = np.arange(2)
    measured = replace(
        seen, rig=None, steps=(), held_triangles=held, probings=(cube_probing,)
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
def test_bad_exposure_is_said_of_its_camera(seen, change, says):
    repainted(seen, "s1_c1.png", change)
    _, notes = survey_cameras(seen)
    assert len(notes) == 1
    assert notes[0].startswith("Camera c1: ")
    assert says in notes[0]


def test_a_camera_that_looks_past_the_object_is_named(seen):
    _, notes = survey_cameras(replace(seen, mesh=box(size=(SIDE,) * 3, origin=(1.0, 0.0, 0.0))))
    assert [note.split(":")[0] for note in notes] == ["Camera c0", "Camera c1"]
    assert "no vertex of the mesh" in notes[0]


@pytest.fixture
def cube_probing():
    contact = Contact(np.array([0.02, 0.02, 0.04]), 0.006, "smooth")
    return Probing("n01", contact, np.array([0.0, 0.0, -1.2]), None, None, None, None, None)


def painted(seen, *, contrast=30.0, wave=WAVE):
    """The session with a texture of one wave number on the upper face, which both cameras see."""
    rng = np.random.default_rng(7)
    angle, phase = 2 * np.pi * rng.random((2, 60))
    across = wave * FOCAL / ABOVE * np.stack([np.cos(angle), np.sin(angle)])
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    cameras = camera(), camera("c1", x=0.7 * SIDE)
    for device, middle in zip(cameras, (0.5 * SIDE, 0.7 * SIDE), strict=True):
        x = middle + ABOVE * (column - 79.5) / FOCAL
        y = 0.5 * SIDE - ABOVE * (row - 59.5) / FOCAL
        waves = np.cos(x[..., None] * across[0] + y[..., None] * across[1] + phase)
        on = (x > 0) & (x < SIDE) & (y > 0) & (y < SIDE)
        grey = np.where(on, 120 + contrast * np.sqrt(2 / 60) * waves.sum(axis=2), 10.0)
        grey = np.clip(grey + rng.normal(0.0, 1.0, SHAPE), 0, 255).astype(np.uint8)
        cv2.imwrite(str(seen.path.parent / f"s0_{device.name}.png"), grey)
    write_rig(seen.path.parent / "rig.toml", Rig(cameras, 0, "rig.toml"))
    return replace(seen, mesh=box(size=(SIDE,) * 3, cells=8))


def test_what_the_first_pictures_promise_is_told(seen):
    survey, _ = survey_view(painted(seen))
    # The reference camera sees all of the face, the other one 0.92 of it; rims cut windows.
    assert 0.6 * survey.points < survey.followed <= survey.points
    assert survey.points == pytest.approx((SIDE * FOCAL / ABOVE / JointFlow().step) ** 2, rel=0.15)
    assert 20 <= survey.vertices <= 81
    assert survey.windows >= 12
    # Of waves in all directions the slope along one of two axes has half of the square; differences
    # of pixels see 4 % less of it.
    assert survey.structure == pytest.approx([np.sqrt(2) / WAVE] * 2, rel=0.15)


@pytest.mark.parametrize(
    ("look", "says"),
    [
        ({"contrast": 0.2}, "of the windows have too little texture"),
        ({"wave": 0.1 * WAVE}, "is coarse or out of focus"),
    ],
)
def test_pictures_that_cannot_be_followed_well_are_named(seen, look, says):
    _, notes = survey_view(painted(seen, **look))
    assert any(says in note for note in notes), notes


def test_without_pictures_there_is_no_view(seen, cube_probing):
    measured = replace(
        seen, rig=None, steps=(), held_triangles=np.arange(2), probings=(cube_probing,)
    )
    assert survey_view(measured) == (None, ())


def test_pictures_that_show_nothing_in_common_are_no_reason_to_stop(seen):
    survey, notes = survey_view(seen)
    assert survey.points > 0
    assert notes[0].startswith("The rig cannot be checked against the pictures: ")


@pytest.fixture(scope="module")
def pair(shared_data: Path) -> Rig:
    """Two cameras with lenses."""
    real_rig = read_rig(shared_data / "halfball_images" / "rig.toml")
    return Rig(real_rig.cameras[:2], 0, real_rig.source)


def _file(path: Path, rig: Rig, states: list[np.ndarray], *, version: str) -> Path:
    """What DuoDIC's second step writes of points [m] in some states: pixels from 1."""
    pixels = [project(camera, state) + 1.0 for camera in rig.cameras for state in states]
    criteria = [np.full((len(states[0]), 1), 0.01 * i) for i in range(len(pixels))]
    criteria[0][:] = np.nan
    criteria[1][2] = 0.9
    fields = {"Points": pixels, "CorCoeffVec": criteria}
    return write_cells(path, "DIC2DpairResults", fields, version=version)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_tracks_become_points(tmp_path: Path, pair: Rig, version: str) -> None:
    rng = np.random.default_rng(1)
    place = rng.uniform(-0.02, 0.02, size=(30, 3)) + np.array([0.0, 0.0, 0.02])
    moved = rng.normal(scale=1e-3, size=(30, 3))
    path = _file(tmp_path / "a.mat", pair, [place, place + moved, place], version=version)
    measured = read_measured("duodic", path, frame=1, triangulate=lambda t: triangulated(t, pair))
    # A rounding of pixels, 1e-13, seen from 0.6 m with 1400 px.
    np.testing.assert_allclose(measured.points, place, atol=1e-12)
    good = np.arange(30) != 2
    np.testing.assert_allclose(measured.displacement[good], moved[good], atol=1e-12)
    assert np.isnan(measured.displacement[2]).all()
    assert measured.poorly_correlated == 1


def test_real_matches_of_multidic(shared_data: Path) -> None:
    """A surface moved rigidly: lengths of its motion by the set's README, made another way."""
    folder = shared_data / "real" / "multidic_pair"
    rig = read_rig(folder / "calibrationObjectImages")
    swapped = replace(rig, cameras=rig.cameras[::-1])
    path = folder / "speckledObjectImages" / "DIC2DpairResults_C_201_C_202.mat"
    for frame, length in ((1, 0.420e-3), (2, 0.895e-3), (3, 1.389e-3), (4, 1.872e-3)):
        measured = read_measured(
            "multidic", path, frame=frame, triangulate=lambda t: triangulated(t, swapped)
        )
        shift = np.linalg.norm(np.nanmean(measured.displacement, axis=0))
        # Three digits are given.
        assert shift == pytest.approx(length, abs=6e-7)


def test_other_cameras_are_refused(pair: Rig) -> None:
    pixels = np.zeros((2, 5, 2))
    tracks = PictureTracks(pixels, pixels, ("201", "202"), None, ())
    one = Rig((*pair.cameras, replace(pair.cameras[0], name="c9")), 0, "rig.toml")
    with pytest.raises(CalibrationError, match=r"rig.toml: has the cameras c0, c1, c9; must have"):
        triangulated(tracks, one)


def test_places_are_no_tracks(tmp_path: Path, pair: Rig) -> None:
    with pytest.raises(RecordError, match="files of vic3d hold places, no pixels; leave --rig out"):
        read_measured("vic3d", tmp_path / "a.csv", triangulate=lambda t: triangulated(t, pair))
    path = write_cells(tmp_path / "a.mat", "a", {"Points": [np.zeros((4, 2))] * 3}, version="7.3")
    with pytest.raises(RecordError, match="Points holds 3 pictures; must be two or more"):
        read_measured("duodic", path, triangulate=lambda t: triangulated(t, pair))

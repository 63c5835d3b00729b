"""Sessions of the facility and their truth; the paper's numbers among themselves."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flow_samples import SHAPE, motion, sample
from lab.planned_sessions import planned_session
from paper.rigid_sessions import RIGID_SESSION, step_text

from palpate.errors import InputError, RecordError
from palpate.lab import Material, choose_variant, read_lab_config
from palpate.paper.motion import flow_rows, vertex_rows
from palpate.paper.sessions import (
    METHODS,
    PAPER_ALL_PROBES,
    PAPER_ANGLE_ERROR_ROTATION,
    PAPER_ANGLE_ERROR_X,
    PAPER_ANGLE_ERROR_Y,
    PAPER_COMPRESSION_MODULUS,
    PAPER_FLOW_LEFT_REAR,
    PAPER_FLOW_REAR_RIGHT,
    PAPER_PROBES,
    measured_session,
    reduced,
    rigid_steps,
    true_displacement,
    true_material,
)
from palpate.records import read_session

EXACT = 1e-12
CONFIG = """\
format = "palpate-lab/1"
name = "small"
[specimen]
shape = "toy"
radius = 0.035
edge = 0.008
[material]
young_modulus = 1e5
poisson_ratio = 0.3
[look]
size = 3.2e-3
[stage]
steps = 2
translation = [2.5e-3, 0, 0]
[head]
distance = 0.81
columns = 200
rows = 150
"""
FLOWS = (PAPER_FLOW_LEFT_REAR, PAPER_FLOW_REAR_RIGHT)
TURNS = (PAPER_ANGLE_ERROR_X, PAPER_ANGLE_ERROR_Y, PAPER_ANGLE_ERROR_ROTATION)


# Rigid motions


def change_truth(session, old, new):
    file = session.path.parent / "truth.toml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


def test_encoders_are_read_from_the_first_instant(rigid_session):
    first, second = rigid_steps(rigid_session)
    assert first[1] == pytest.approx(np.hypot(3e-3, 0.01), rel=EXACT)
    assert second[1] == pytest.approx(np.hypot(6e-3, 0.02), rel=EXACT)
    np.testing.assert_allclose(second[0][:3], np.c_[np.eye(3), [6e-3, 0, 0]], atol=1e-15)


def test_truth_of_another_run_is_refused(rigid_session):
    file = rigid_session.path.parent / "truth.toml"
    file.write_text("".join(step_text(k, 0.0) for k in range(2)))
    with pytest.raises(InputError, match="has 2 steps, the session 3"):
        rigid_steps(rigid_session)


@pytest.mark.parametrize("bad", ["3.0", "[[1.0, 0.0, 0.0]]", "[[1.0, 0.0], [0.0, 1.0], [0.0]]"])
def test_a_rotation_that_is_none_is_refused(rigid_session, bad):
    change_truth(rigid_session, "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]", bad)
    # That of the first instant says nothing and is not read.
    rigid_steps(rigid_session)
    change_truth(rigid_session, "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]", bad)
    with pytest.raises(RecordError, match=r"\[\[step\]\] R: .*must be three"):
        rigid_steps(rigid_session)


# True displacement and material


def turned(step):
    """A turn by a right angle about z and a way along x, for each step."""
    turn = np.linalg.matrix_power(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), step)
    return turn, [1e-3 * step, 0.0, 0.0]


@pytest.fixture
def staged(tmp_path):
    session = read_session(planned_session(tmp_path, RIGID_SESSION))
    tables = []
    for k in range(3):
        turn, way = turned(k)
        tables.append(f"[[step]]\nR = {turn.tolist()}\nt = {way}\nencoder = {way}\n")
    (tmp_path / "truth.toml").write_text("".join(tables))
    return session


@pytest.fixture
def probed(tmp_path):
    """A truth map of every third pixel of the sample: what it holds, others do not."""
    surface = sample().surface
    pixel = np.flatnonzero(surface.triangle.ravel() >= 0)[::3]
    point = surface.point.reshape(-1, 3)[pixel]
    np.savez(
        tmp_path / "truth_n01.npz", shape=np.array(SHAPE), pixel=pixel, X=point, U=motion(point)
    )
    return read_session(planned_session(tmp_path)), pixel


def test_a_rigid_step_moves_every_point_by_its_pose(staged):
    flow = sample().flow
    x, y, z = flow.point.T
    moved = true_displacement(staged, "s1", flow)
    np.testing.assert_allclose(moved, np.stack([-y - x + 1e-3, x - y, 0 * z], 1), atol=1e-15)
    # Two right angles, not the first step's one.
    moved = true_displacement(staged, "s2", flow)
    np.testing.assert_allclose(moved, np.stack([-2 * x + 2e-3, -2 * y, 0 * z], 1), atol=1e-15)


def test_a_probing_moves_a_point_as_its_pixel_says(probed):
    session, pixel = probed
    flow = sample().flow
    # A third of a pixel beside: the nearest pixel is still the same.
    moved = true_displacement(session, "n01", replace(flow, pixel=flow.pixel + 0.3))
    known = np.isin(flow.pixel @ [1, SHAPE[1]], pixel)
    assert 0.2 < known.mean() < 0.8
    np.testing.assert_allclose(moved[known], motion(flow.point[known]), atol=1e-15)
    assert np.isnan(moved[~known]).all()


def test_a_point_beside_the_picture_is_not_known(probed):
    flow = sample().flow
    for beside in ([-1.0, 0.0], [SHAPE[1], 0.0], [0.0, -1.0], [0.0, SHAPE[0]]):
        pixel = np.tile(np.where(np.equal(beside, 0.0), 60.0, beside), (len(flow.pixel), 1))
        moved = true_displacement(probed[0], "n01", replace(flow, pixel=pixel))
        assert np.isnan(moved).all()


def test_the_truth_stands_beside_the_session(tmp_path):
    session = read_session(planned_session(tmp_path))
    (tmp_path / "truth.toml").write_text("young_modulus = 52000.0\npoisson_ratio = 0.21\n")
    assert true_material(session) == Material(52e3, 0.21)


# The chain


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    file = tmp_path_factory.mktemp("config") / "small.toml"
    file.write_text(CONFIG)
    return read_lab_config(file)


def test_a_quick_configuration_is_the_same_on_a_coarser_chip(config):
    quick = reduced(replace(config, head=replace(config.head, focal=500.0)))
    assert (quick.head.columns, quick.head.rows, quick.head.focal) == (100, 75, 250.0)
    assert quick.look.size == pytest.approx(2 * config.look.size)
    assert quick.stage.steps == 2
    many = reduced(replace(config, stage=replace(config.stage, steps=8)))
    assert many.stage.steps == 3
    assert many.head.focal is None
    np.testing.assert_array_equal(many.stage.translation, config.stage.translation)


@pytest.mark.slow
def test_from_a_configuration_to_the_rows_of_both_methods(config, tmp_path: Path):
    said: list[tuple[str, float]] = []
    measured = measured_session(
        config,
        tmp_path,
        variant=choose_variant(),
        progress=lambda *arguments: said.append(arguments),
    )
    assert set(measured.flows) == set(METHODS)
    shares = [share for _, share in said]
    assert shares == sorted(shares)
    assert 0.9 < shares[-1] <= 1.0
    joint, paper = (flow_rows(measured, method) for method in ("joint", "lang-pai"))
    # 1.1 px/mm, cameras 0.1 m apart at 0.81 m: a tenth of a pixel, far more than the noise, is
    # 0.1 mm along the picture. Whole pixels, rounded once a step, are 0.9 mm.
    for step, (ours, theirs) in enumerate(zip(joint, paper, strict=True), start=1):
        assert ours.length.mean == pytest.approx(2.5e-3 * step, abs=0.1e-3)
        assert theirs.length.mean == pytest.approx(2.5e-3 * step, abs=0.9e-3 * step)
        assert ours.count > 20
        assert theirs.count > 1000
    assert joint[0].angle.std < paper[0].angle.std
    assert np.degrees(vertex_rows(measured, "joint")[1].angle.mean) < 5.0


@pytest.mark.parametrize("rows", [*FLOWS, *TURNS])
def test_eight_steps_each(rows):
    assert [row.step for row in rows] == list(range(1, 9))


@pytest.mark.parametrize("rows", FLOWS)
def test_the_motion_between_steps_is_two_and_a_half_millimetres(rows):
    for row in rows:
        assert row.command == pytest.approx(2.5e-3 * row.step, rel=1e-12)
        # The text: correct motion from encoders, which lag behind by up to 0.36 mm.
        assert 0.0 < row.command - row.encoder < 0.4e-3
        # The text: "about half a millimetre accuracy" of translation; a digit lost would show.
        assert abs(row.length.mean / row.encoder - 1.0) < 0.14
        assert 0.3e-3 < row.length.std < 1e-3


@pytest.mark.parametrize("rows", FLOWS)
def test_angles_are_in_radians_and_vary_less_with_greater_translation(rows):
    sigma = [row.angle.std for row in rows]
    assert sigma == sorted(sigma, reverse=True)
    assert min(row.angle.mean for row in rows) > 0.75
    assert max(row.angle.mean for row in rows) < 1.2


def test_errors_of_direction_are_printed_in_degrees():
    assert np.degrees(PAPER_ANGLE_ERROR_X[0].angle.mean) == pytest.approx(10.9142)
    assert np.degrees(PAPER_ANGLE_ERROR_Y[5].angle.std) == pytest.approx(9.994)
    assert all(row.length is row.command is None for row in TURNS[0] + TURNS[1])


def test_the_rotation_moves_vertices_by_what_was_commanded():
    for row in PAPER_ANGLE_ERROR_ROTATION:
        # Chords of 2, 4, ... degrees of the same circle; fewer far vertices are seen in the end.
        chord = np.sin(np.radians(row.step)) / np.sin(np.radians(1.0))
        assert row.command == pytest.approx(3.053e-3 * chord, rel=0.05)
        # Measured lengths fall behind, by 2 per cent at first and 8 in the end.
        assert 0.92 < row.length.mean / row.command < 0.985


@pytest.mark.parametrize("row", [*PAPER_PROBES.values(), PAPER_ALL_PROBES])
def test_constants_of_a_row_fit_together(row):
    # Printed to four digits of the shear modulus.
    ratio, shear, young = row
    assert young == pytest.approx(2.0 * shear * (1.0 + ratio), abs=1.1e-3)


def test_constants_are_those_the_text_speaks_of():
    ratios = [ratio for ratio, _, _ in PAPER_PROBES.values()]
    assert (len(ratios), min(ratios), max(ratios)) == (17, 0.1183, 0.2516)
    off = PAPER_COMPRESSION_MODULUS / PAPER_ALL_PROBES[2] - 1.0
    assert off == pytest.approx(0.024, abs=5e-4)

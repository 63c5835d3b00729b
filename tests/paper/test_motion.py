"""Reductions of tables 1 and 2 against motions in closed form; the chain once, small."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flow_samples import rig, sample

from palpate.errors import InputError, RecordError
from palpate.geometry import write_mesh
from palpate.lab import choose_variant, read_lab_config
from palpate.paper.motion import (
    METHODS,
    PaperSession,
    flow_row,
    flow_rows,
    measured_session,
    quickened,
    rigid_steps,
    vertex_row,
    vertex_rows,
)
from palpate.pipeline import MeasuredMotion, SessionFlow
from palpate.records import read_session
from palpate.vision import Outcome, VertexDisplacement

# Rounding of sums over a thousand points.
EXACT = 1e-12
AXIS = np.array([0.0, 0.0, 1.0])
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


def with_flow(vectors):
    """The sample's flow with displacements that repeat some vectors in turn."""
    flow = sample().flow
    count = len(flow.outcome)
    return replace(flow, displacement=np.resize(np.asarray(vectors, dtype=float), (count, 3)))


def turned(degrees):
    """Rotation about z as a motion."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    motion = np.eye(4)
    motion[:2, :2] = [[c, -s], [s, c]]
    return motion


def measured(displacement):
    count = len(displacement)
    return VertexDisplacement(
        np.asarray(displacement, dtype=float), np.zeros((count, 3, 3)), np.ones(count, dtype=int)
    )


# Table 1


def test_a_pure_translation_has_one_length_and_one_angle():
    row = flow_row(with_flow([[3e-3, 0, 4e-3]]), AXIS, step=3, encoder=0.1, command=0.2)
    assert row.length.mean == pytest.approx(5e-3, rel=EXACT)
    assert row.angle.mean == pytest.approx(np.arctan2(3, 4), rel=EXACT)
    assert row.length.std == pytest.approx(0.0, abs=1e-15)
    assert row.angle.std == pytest.approx(0.0, abs=1e-12)
    assert (row.step, row.encoder, row.command) == (3, 0.1, 0.2)
    assert row.points == len(sample().flow.outcome)


def test_mean_and_deviation_of_two_kinds_of_points():
    flow = with_flow([[1e-3, 0, 0], [0, 0, 3e-3]])
    if len(flow.outcome) % 2:
        flow = replace(flow, outcome=np.r_[int(Outcome.LOST), flow.outcome[1:]])
    row = flow_row(flow, AXIS, step=1, encoder=0.0, command=0.0)
    # Half of each: the deviation is half of the difference.
    assert row.length.mean == pytest.approx(2e-3, rel=EXACT)
    assert row.length.std == pytest.approx(1e-3, rel=EXACT)
    assert row.angle.mean == pytest.approx(np.pi / 4, rel=EXACT)
    assert row.angle.std == pytest.approx(np.pi / 4, rel=EXACT)


def test_rejected_points_do_not_count():
    flow = with_flow([[1e-3, 0, 0]])
    outcome, moved = flow.outcome.copy(), flow.displacement.copy()
    outcome[:10], moved[:10] = int(Outcome.SCORE), [0, 0, 1.0]
    row = flow_row(
        replace(flow, outcome=outcome, displacement=moved), AXIS, step=1, encoder=0.0, command=0.0
    )
    assert row.points == len(outcome) - 10
    assert row.length.mean == pytest.approx(1e-3, rel=EXACT)


def test_an_instant_without_flow_has_no_points():
    row = flow_row(None, AXIS, step=1, encoder=0.1, command=0.1)
    assert row.points == 0
    assert np.isnan([row.length.mean, row.length.std, row.angle.mean, row.angle.std]).all()


# Table 2


@pytest.mark.parametrize("degrees", [0.0, 1e-9, 0.5, 30.0])
def test_the_angle_error_is_the_turn_of_the_displacement(degrees):
    place = np.array([[0.01, 0, 0], [0, 0.02, 0], [0.03, 0.01, 0.05]])
    motion = turned(2.0)
    true = place @ (motion[:3, :3] - np.eye(3)).T
    row = vertex_row(measured(true @ turned(degrees)[:3, :3].T), place, motion, step=1)
    # Displacements lie across z: turned about it by an angle they are off by that angle; what is
    # left is the rounding of the true one, one in 1e14 of a displacement.
    assert np.degrees(row.angle_error.mean) == pytest.approx(degrees, abs=1e-11)
    assert np.degrees(row.angle_error.std) == pytest.approx(0.0, abs=1e-11)
    chord = 2.0 * np.sin(np.radians(1.0)) * np.linalg.norm(place[:, :2], axis=1)
    assert row.command == pytest.approx(chord.mean(), rel=1e-12)
    assert row.length.mean == pytest.approx(chord.mean(), rel=1e-12)
    assert row.length.std == pytest.approx(chord.std(), rel=1e-12)
    assert row.vertices == 3


def test_a_vertex_on_the_axis_counts_for_lengths_only():
    place = np.array([[0.0, 0, 0.02], [0.01, 0, 0]])
    motion = turned(90.0)
    row = vertex_row(measured([[0, 0, 0], [0, 0.01 * np.sqrt(2), 0]]), place, motion, step=1)
    assert row.vertices == 2
    # The other one really moves by (-1, 1, 0) cm.
    assert row.angle_error.mean == pytest.approx(np.pi / 4, rel=EXACT)
    assert row.angle_error.std == 0.0
    assert row.length.mean == pytest.approx(0.5 * np.sqrt(2) * 0.01, rel=EXACT)


def test_vertices_that_were_not_measured_are_left_out_of_the_command():
    place = np.array([[1.0, 0, 0], [0.01, 0, 0]])
    row = vertex_row(measured([[np.nan] * 3, [-0.01, 0.01, 0]]), place, turned(90.0), step=1)
    assert row.vertices == 1
    assert row.command == pytest.approx(np.sqrt(2) * 0.01, rel=EXACT)
    nothing = vertex_row(None, place, turned(90.0), step=1)
    assert nothing.vertices == 0
    assert np.isnan(nothing.angle_error.mean)


# Sessions and their truth


def step_text(k, way):
    r = "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]"
    return (
        f'[[step]]\nname = "s{k}"\nR = {r}\nt = [{way}, 0.0, 0.0]\n'
        f"encoder = [{way + 1e-3}, 0.0, {0.01 * k}]\n"
    )


@pytest.fixture
def session(tmp_path):
    """Three instants of the sample's cube, and their truth: 3 mm a step."""
    write_mesh(tmp_path / "mesh.ply", sample().mesh)
    (tmp_path / "rig.toml").write_text("")
    head = 'format = "palpate-session/1"\n[object]\nmesh = "mesh.ply"\nlength_unit = "m"\n'
    head += '[rig]\ncameras = "rig.toml"\n'
    steps = [f'[[step]]\nname = "s{k}"\nimages = "s{k}_{{camera}}.png"\n' for k in range(3)]
    (tmp_path / "session.toml").write_text(head + "".join(steps))
    (tmp_path / "truth.toml").write_text("".join(step_text(k, 3e-3 * k) for k in range(3)))
    return read_session(tmp_path)


def change_truth(session, old, new):
    file = session.path.parent / "truth.toml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


def test_encoders_are_read_from_the_first_instant(session):
    first, second = rigid_steps(session)
    assert first.encoder == pytest.approx(np.hypot(3e-3, 0.01), rel=EXACT)
    assert second.encoder == pytest.approx(np.hypot(6e-3, 0.02), rel=EXACT)
    np.testing.assert_allclose(second.motion[:3], np.c_[np.eye(3), [6e-3, 0, 0]], atol=1e-15)


def test_rows_of_a_session_follow_its_steps(session):
    one = sample()
    moved = MeasuredMotion("s1", None, True, one.picture, one.flow, one.vertices, None)
    lost = MeasuredMotion("s2", None, True, one.picture, None, None, "no pictures")
    found = PaperSession(session, {"joint": SessionFlow(rig(), (moved, lost), ())})
    flows, vertices = flow_rows(found, "joint"), vertex_rows(found, "joint")
    assert [row.step for row in flows] == [row.step for row in vertices] == [1, 2]
    assert [row.command for row in flows] == pytest.approx([3e-3, 6e-3], rel=EXACT)
    assert flows[0].points == len(one.flow.outcome)
    assert flows[1].points == vertices[1].vertices == 0
    # The sample moves along x; its cameras look down, along minus z.
    assert flows[0].angle.mean == pytest.approx(np.pi / 2, rel=EXACT)
    assert vertices[0].angle_error.mean == pytest.approx(0.0, abs=1e-12)
    assert vertices[0].command == pytest.approx(3e-3, rel=EXACT)
    assert vertices[0].length.mean < 0.3e-3


def test_truth_of_another_run_is_refused(session):
    file = session.path.parent / "truth.toml"
    file.write_text("".join(step_text(k, 0.0) for k in range(2)))
    with pytest.raises(InputError, match="has 2 steps, the session 3"):
        rigid_steps(session)


@pytest.mark.parametrize("bad", ["3.0", "[[1.0, 0.0, 0.0]]", "[[1.0, 0.0], [0.0, 1.0], [0.0]]"])
def test_a_rotation_that_is_none_is_refused(session, bad):
    change_truth(session, "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]", bad)
    # That of the first instant says nothing and is not read.
    rigid_steps(session)
    change_truth(session, "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]", bad)
    with pytest.raises(RecordError, match=r"\[\[step\]\] R: .*must be three"):
        rigid_steps(session)


def test_a_session_without_truth_is_refused(session):
    (session.path.parent / "truth.toml").unlink()
    with pytest.raises(RecordError, match=r"truth\.toml"):
        rigid_steps(session)


# The chain


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    file = tmp_path_factory.mktemp("config") / "small.toml"
    file.write_text(CONFIG)
    return read_lab_config(file)


def test_a_quick_configuration_is_the_same_on_a_coarser_chip(config):
    quick = quickened(replace(config, head=replace(config.head, focal=500.0)))
    assert (quick.head.columns, quick.head.rows, quick.head.focal) == (100, 75, 250.0)
    assert quick.look.size == pytest.approx(2 * config.look.size)
    assert quick.stage.steps == 2
    many = quickened(replace(config, stage=replace(config.stage, steps=8)))
    assert many.stage.steps == 3
    assert many.head.focal is None
    np.testing.assert_array_equal(many.stage.translation, config.stage.translation)


def test_from_a_configuration_to_the_rows_of_both_methods(config, tmp_path: Path):
    said: list[tuple[str, float]] = []
    found = measured_session(
        config, tmp_path, variant=choose_variant(), progress=lambda *one: said.append(one)
    )
    assert set(found.found) == set(METHODS)
    shares = [share for _, share in said]
    assert shares == sorted(shares)
    assert 0.9 < shares[-1] <= 1.0
    joint, paper = (flow_rows(found, method) for method in ("joint", "lang-pai"))
    # 1.1 px/mm, cameras 0.1 m apart at 0.81 m: a tenth of a pixel, far more than the noise, is
    # 0.1 mm along the picture. Whole pixels, rounded once a step, are 0.9 mm.
    for step, (ours, theirs) in enumerate(zip(joint, paper, strict=True), start=1):
        assert ours.length.mean == pytest.approx(2.5e-3 * step, abs=0.1e-3)
        assert theirs.length.mean == pytest.approx(2.5e-3 * step, abs=0.9e-3 * step)
        assert ours.points > 20
        assert theirs.points > 1000
    assert joint[0].angle.std < paper[0].angle.std
    assert np.degrees(vertex_rows(found, "joint")[1].angle_error.mean) < 5.0

"""Tables 1 and 2, and their pictures: rows against motions in closed form; refusals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flow_samples import rig, sample

from palpate.errors import InputError
from palpate.paper.motion import (
    PAPER,
    flow_curves,
    flow_picture,
    flow_row,
    flow_rows,
    flow_summary,
    motion_table,
    vertex_curves,
    vertex_row,
    vertex_rows,
    vertex_summary,
)
from palpate.paper.sessions import MotionRow, PaperSession, Spread
from palpate.pipeline import MeasuredMotion, SessionFlow
from palpate.records import Session
from palpate.records.session import Step
from palpate.vision import Outcome, VertexDisplacement

# Rounding of sums over a thousand points.
EXACT = 1e-12
AXIS = np.array([0.0, 0.0, 1.0])
ORANGE, BLUE = (0xD5, 0x5E, 0x00), (0x00, 0x72, 0xB2)


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
    assert row.count == len(sample().flow.outcome)


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
    assert row.count == len(outcome) - 10
    assert row.length.mean == pytest.approx(1e-3, rel=EXACT)


def test_an_instant_without_flow_has_no_points():
    row = flow_row(None, AXIS, step=1, encoder=0.1, command=0.1)
    assert row.count == 0
    assert np.isnan([row.length.mean, row.length.std, row.angle.mean, row.angle.std]).all()


# Table 2


@pytest.mark.parametrize("degrees", [0.0, 1e-9, 0.5, 30.0])
def test_the_angle_error_is_the_turn_of_the_displacement(degrees):
    points = np.array([[0.01, 0, 0], [0, 0.02, 0], [0.03, 0.01, 0.05]])
    motion = turned(2.0)
    true = points @ (motion[:3, :3] - np.eye(3)).T
    row = vertex_row(measured(true @ turned(degrees)[:3, :3].T), points, motion, step=1)
    # Displacements lie across z: turned about it by an angle they are off by that angle; what is
    # left is the rounding of the true one, one in 1e14 of a displacement.
    assert np.degrees(row.angle.mean) == pytest.approx(degrees, abs=1e-11)
    assert np.degrees(row.angle.std) == pytest.approx(0.0, abs=1e-11)
    chord = 2.0 * np.sin(np.radians(1.0)) * np.linalg.norm(points[:, :2], axis=1)
    assert row.command == pytest.approx(chord.mean(), rel=1e-12)
    assert row.length.mean == pytest.approx(chord.mean(), rel=1e-12)
    assert row.length.std == pytest.approx(chord.std(), rel=1e-12)
    assert row.count == 3


def test_a_vertex_on_the_axis_counts_for_lengths_only():
    points = np.array([[0.0, 0, 0.02], [0.01, 0, 0]])
    motion = turned(90.0)
    row = vertex_row(measured([[0, 0, 0], [0, 0.01 * np.sqrt(2), 0]]), points, motion, step=1)
    assert row.count == 2
    # The other one really moves by (-1, 1, 0) cm.
    assert row.angle.mean == pytest.approx(np.pi / 4, rel=EXACT)
    assert row.angle.std == 0.0
    assert row.length.mean == pytest.approx(0.5 * np.sqrt(2) * 0.01, rel=EXACT)


def test_vertices_that_were_not_measured_are_left_out_of_the_command():
    points = np.array([[1.0, 0, 0], [0.01, 0, 0]])
    row = vertex_row(measured([[np.nan] * 3, [-0.01, 0.01, 0]]), points, turned(90.0), step=1)
    assert row.count == 1
    assert row.command == pytest.approx(np.sqrt(2) * 0.01, rel=EXACT)
    nothing = vertex_row(None, points, turned(90.0), step=1)
    assert nothing.count == 0
    assert np.isnan(nothing.angle.mean)


# Rows of a session


def test_rows_of_a_session_follow_its_steps(rigid_session):
    cube = sample()
    moved = MeasuredMotion("s1", None, True, cube.picture, cube.flow, cube.vertices, None)
    lost = MeasuredMotion("s2", None, True, cube.picture, None, None, "no pictures")
    session = PaperSession(rigid_session, {"joint": SessionFlow(rig(), (moved, lost), ())})
    flows, vertices = flow_rows(session, "joint"), vertex_rows(session, "joint")
    assert [row.step for row in flows] == [row.step for row in vertices] == [1, 2]
    assert [row.command for row in flows] == pytest.approx([3e-3, 6e-3], rel=EXACT)
    assert flows[0].count == len(cube.flow.outcome)
    assert flows[1].count == vertices[1].count == 0
    # The sample moves along x; its cameras look down, along minus z.
    assert flows[0].angle.mean == pytest.approx(np.pi / 2, rel=EXACT)
    assert vertices[0].angle.mean == pytest.approx(0.0, abs=1e-12)
    assert vertices[0].command == pytest.approx(3e-3, rel=EXACT)
    assert vertices[0].length.mean < 0.3e-3


# Tables


def flow(step, *, off=0.0, std=1e-3, encoder_off=0.0, count=7):
    """A step of 2.5 mm that is measured too long by `off`; sigma of the angle: 8 degrees / step."""
    travel = 2.5e-3 * step
    angle = Spread(np.radians(60.0), np.radians(8.0) / step)
    length = Spread(travel + off, std)
    return MotionRow(step, angle, length, travel, travel + encoder_off, count)


def direction(step, error, *, length=None):
    return MotionRow(
        step, Spread(np.radians(error), np.radians(2 * error)),
        None if length is None else Spread(length, 0.5 * length), length,
    )  # fmt: skip


def test_steps_are_grouped_and_in_the_units_of_the_head():
    rows = {PAPER: (flow(1, count=None), flow(2, count=None)), "joint": (flow(1), flow(2))}
    table = motion_table("t", rows, of_flow=True)
    assert [(row[0], row[1]) for row in table.rows] == [
        (1, PAPER), (1, "joint"), (2, PAPER), (2, "joint"),
    ]  # fmt: skip
    assert table.columns[2:8] == (
        "angle (deg)", "sigma (deg)", "length (mm)", "sigma (mm)", "encoder (mm)", "command (mm)",
    )  # fmt: skip
    assert table.rows[2][2:8] == pytest.approx((60.0, 4.0, 5.0, 1.0, 5.0, 5.0))
    assert [row[8] for row in table.rows] == [None, 7, None, 7]


def test_the_worst_step_is_found_whichever_its_sign():
    rows = (flow(1, off=1e-4), flow(2, off=-3e-4, std=5e-3), flow(3, off=2e-4))
    table = flow_summary("t", {"x": {"joint": rows}})
    assert table.rows[0][:2] == ("x", "joint")
    assert table.rows[0][2:] == pytest.approx((-0.3, 5.0, 8.0, 3))


def test_the_paper_is_compared_with_its_encoder_others_with_the_command():
    reference, rows = ((flow(1, off=1e-4, encoder_off=-2e-4, count=n),) for n in (None, 7))
    table = flow_summary("t", {"x": {PAPER: reference, "joint": rows}})
    assert [row[2] for row in table.rows] == pytest.approx([0.3, 0.1])


def test_a_step_without_points_is_not_hidden():
    lost = MotionRow(2, Spread(np.nan, np.nan), Spread(np.nan, np.nan), 5e-3, 5e-3, 0)
    table = flow_summary("t", {"x": {"joint": (flow(1, off=1e-3), lost, flow(3))}})
    assert np.isnan(table.rows[0][2])
    assert np.isnan(table.rows[0][3])


def test_directions_have_lengths_only_where_they_are_printed():
    rows = {PAPER: (direction(1, 10.0),), "joint": (direction(1, 1.0, length=4e-3),)}
    table = motion_table("t", rows, of_flow=False)
    assert table.rows[0][2:4] == pytest.approx((10.0, 20.0))
    assert table.rows[0][4:] == (None, None, None, None)
    assert table.rows[1][2:7] == pytest.approx((1.0, 2.0, 4.0, 2.0, 4.0))


def test_the_summary_of_directions_has_the_first_and_the_last_step():
    rows = (direction(1, 9.0), direction(2, 30.0), direction(3, 3.0))
    table = vertex_summary("t", {"y": {"lang-pai": rows}})
    assert table.rows[0][:2] == ("y", "lang-pai")
    assert table.rows[0][2:] == pytest.approx((9.0, 18.0, 3.0, 6.0, 3))


def sample_session(monkeypatch):
    """The sample's motion under the name s1, and a lost one, s2."""
    cube = sample()
    monkeypatch.setattr("palpate.paper.motion.surface_map", lambda *_: cube.surface)
    motions = (
        MeasuredMotion("s1", None, True, cube.picture, cube.flow, cube.vertices, None),
        MeasuredMotion("s2", None, True, cube.picture, None, None, "torn picture"),
    )
    session = Session(
        name="", path=Path("session.toml"), mesh=cube.mesh, held_triangles=np.zeros(0, dtype=int),
        probings=(), density=None, gravity=None, rig=Path("rig.toml"), notes=(),
        steps=(Step("s0", "0.png"), Step("s1", "1.png"), Step("s2", "2.png")),
    )  # fmt: skip
    return PaperSession(session, {"joint": SessionFlow(rig(), motions, ())})


def flows(bias):
    return tuple(
        MotionRow(
            step, Spread(1.0, 0.1 / step), Spread(2.5e-3 * step + bias, 1e-4), 2.5e-3 * step, 0.0, 5
        )
        for step in (1, 2, 3)
    )


def directions(error):
    return tuple(MotionRow(step, Spread(np.radians(error), 0.1)) for step in (1, 2, 3))


def height_of(picture, colour, columns):
    """Mean row of the pixels of a colour in some columns."""
    near = np.abs(picture[:, columns, :3].astype(int) - colour).max(axis=2) < 30
    # Below the legend.
    rows = np.nonzero(near[60:])[0]
    assert len(rows)
    return rows.mean()


def test_a_motion_is_drawn_by_its_name(monkeypatch):
    picture = flow_picture(sample_session(monkeypatch), "joint", "s1", "a title")
    assert picture.dtype == np.uint8
    assert picture.shape[1] == pytest.approx(8.4 * 150, abs=1)
    # The length is drawn in colours: there is more than grey.
    assert (np.ptp(picture[..., :3].astype(int), axis=2) > 60).mean() > 0.1


def test_a_motion_that_was_not_measured_is_not_drawn(monkeypatch):
    session = sample_session(monkeypatch)
    with pytest.raises(InputError, match="'s2' cannot be drawn: torn picture"):
        flow_picture(session, "joint", "s2", "")


def test_a_larger_bias_is_drawn_higher():
    picture = flow_curves({"x": {"lang-pai": flows(1e-3), "joint": flows(1e-5)}})
    first_panel = slice(100, picture.shape[1] // 3)
    assert height_of(picture, ORANGE, first_panel) < height_of(picture, BLUE, first_panel) - 50


def test_directions_have_one_scale_in_all_panels():
    tests = {
        "x": {"joint": directions(1.0)}, "y": {"joint": directions(100.0)},
        "z": {"joint": directions(1.0)},
    }  # fmt: skip
    picture = vertex_curves(tests)
    third = picture.shape[1] // 3
    rows = [height_of(picture, BLUE, slice(k * third + 95, (k + 1) * third - 20)) for k in range(3)]
    assert rows[0] == pytest.approx(rows[2], abs=1.0)
    assert rows[1] < rows[0] - 50

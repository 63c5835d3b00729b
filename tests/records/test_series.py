"""A series of forces and motions: units, times of the contact, and what is doubtful about it."""

from pathlib import Path

import numpy as np
import pytest
from cube_session import cube_session as cube_session

from palpate.records import Series, read_session

KEY = "force = [0, 0, -1.2]"
NONE = np.zeros((0, 0, 3))


def with_series(folder: Path, head: str, rows: list[str], more: str = "") -> Series:
    file = folder / "session.toml"
    file.write_text(file.read_text().replace(KEY, f'{KEY}\nseries = "s.csv"\n{more}', 1))
    (folder / "s.csv").write_text("\n".join([head, *rows]) + "\n")
    series = read_session(folder).probings[0].series
    assert series is not None
    return series


def made(time, force) -> Series:
    time = np.asarray(time, dtype=float)
    tip = np.zeros((len(time), 3))
    return Series(time, np.asarray(force, float), len(time) - 1, tip, np.zeros(0, int), NONE, "s")


def test_columns_come_in_any_order_and_unit(cube_session):
    rows = [f"{1000 * t},{0.02 * min(t, 2)},{-600 * min(t, 2)},0,0,0,0" for t in range(9)]
    head = "t [ms],tz [cm],fz [mN],fx [mN],fy [mN],tx [cm],ty [cm]"
    series = with_series(cube_session, head, rows, 'measured_at = "6.2 s"')
    np.testing.assert_allclose(series.time, np.arange(9.0))
    # Along the force of the probing, which pushes down.
    np.testing.assert_allclose(series.force, np.minimum(0.6 * np.arange(9), 1.2))
    assert series.tip[-1] == pytest.approx([0.0, 0.0, 4e-4])
    assert series.reference == 6
    assert (series.contact, series.rise, series.hold, series.age) == (0.0, 2.0, 6.0, 6.0)
    assert series.notes == ()


def test_frames_hold_the_probing_s_own_points_in_any_order(cube_session):
    lines = (cube_session / "n01.csv").read_text().splitlines()
    (cube_session / "frame.csv").write_text("\n".join([lines[0], *lines[:0:-1][:-9]]) + "\n")
    rows = [f"{t},0,0,{-0.6 * min(t, 2)},{'frame.csv' if t in (3, 5) else ''}" for t in range(8)]
    series = with_series(cube_session, "t,fx,fy,fz,displacement", rows)
    measured = read_session(cube_session).probings[0].displacement
    np.testing.assert_array_equal(series.instant, [3, 5])
    assert series.frames.shape == (2, *measured.points.shape)
    # The first nine rows are not in the frame.
    assert np.isnan(series.frames[0, :9]).all()
    np.testing.assert_allclose(series.frames[0, 9:], measured.displacement[9:])


RAMP = np.minimum(np.arange(40) / 10.0, 1.0)
NOISE = 1e-3 * np.random.default_rng(0).standard_normal(40)


@pytest.mark.parametrize(
    ("time", "force", "says"),
    [
        (np.r_[0:5, 30:65], RAMP, "no force was read from 4 to 30 s"),
        (np.arange(40), np.minimum(RAMP + NOISE * (RAMP < 1.0), 1.0), "in a row are exactly 1 N"),
        (1e3 * np.arange(40), RAMP, "as in t \\[ms\\]"),
        (1e-4 * np.arange(40), RAMP, "lasts 0.0039 s"),
    ],
)
def test_what_is_doubtful_is_said(time, force, says):
    notes = made(time, force).notes
    assert len(notes) == 1
    with pytest.raises(AssertionError, match=says):
        raise AssertionError(notes[0])


@pytest.mark.parametrize(
    ("time", "force"),
    [
        (np.arange(40), RAMP),
        (np.arange(40), RAMP + NOISE),
        # A hold seen at times that grow by a third each has no gap.
        (np.r_[np.linspace(0, 1, 11), 1.3 ** np.arange(1, 30)], RAMP),
        # Nor has one that stood still for long before it was touched.
        (np.r_[0, 100 + np.arange(39)], np.r_[0, RAMP[:39]]),
    ],
)  # fmt: skip
def test_nothing_is_said_of_a_good_one(time, force):
    assert made(time, force).notes == ()


def test_the_contact_is_the_last_instant_before_the_force():
    series = made(np.arange(50), np.r_[np.full(5, 0.01), 0.0, np.linspace(0.1, 1, 10), np.ones(34)])
    assert series.contact == 5.0
    assert series.rise == 10.0

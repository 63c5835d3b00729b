"""Pictures of the paper's experiments: what they are made of, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from flow_samples import rig, sample

from palpate.errors import InputError
from palpate.paper.motion import flow_curves, flow_picture, vertex_curves
from palpate.paper.sessions import MotionRow, PaperSession, Spread
from palpate.pipeline import MeasuredMotion, SessionFlow
from palpate.records import Session, Step

ORANGE, BLUE = (0xD5, 0x5E, 0x00), (0x00, 0x72, 0xB2)


def measured(monkeypatch):
    """The sample's motion under the name s1, and a lost one, s2."""
    one = sample()
    monkeypatch.setattr("palpate.paper.motion.surface_map", lambda *_: one.surface)
    motions = (
        MeasuredMotion("s1", None, True, one.picture, one.flow, one.vertices, None),
        MeasuredMotion("s2", None, True, one.picture, None, None, "torn picture"),
    )
    session = Session(
        name="", path=Path("session.toml"), mesh=one.mesh, held_triangles=np.zeros(0, dtype=int),
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
    picture = flow_picture(measured(monkeypatch), "joint", "s1", "a title")
    assert picture.dtype == np.uint8
    assert picture.shape[1] == pytest.approx(8.4 * 150, abs=1)
    # The length is drawn in colours: there is more than grey.
    assert (np.ptp(picture[..., :3].astype(int), axis=2) > 60).mean() > 0.1


def test_motions_that_are_not_there_are_refused(monkeypatch):
    found = measured(monkeypatch)
    with pytest.raises(InputError, match="no motion 's7'; there are s1, s2"):
        flow_picture(found, "joint", "s7", "")
    with pytest.raises(InputError, match="'s2' cannot be drawn: torn picture"):
        flow_picture(found, "joint", "s2", "")


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

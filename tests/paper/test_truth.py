"""True displacement of the points of a flow: by the stage's motion, by a probing's truth map."""

from dataclasses import replace

import numpy as np
import pytest
from flow_samples import SHAPE, motion, sample
from lab.planned_sessions import planned_session

from palpate.errors import InputError, RecordError
from palpate.paper.truth import true_displacement
from palpate.records import read_session

STEPS = "".join(f'[[step]]\nname = "s{k}"\nimages = "s{k}_{{camera}}.png"\n' for k in range(3))
HEAD = """\
format = "palpate-session/1"
[object]
mesh = "mesh.ply"
length_unit = "m"
[rig]
cameras = "rig.toml"
"""


def turned(step):
    """A turn by a right angle about z and a way along x, for each step."""
    turn = np.linalg.matrix_power(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), step)
    return turn, [1e-3 * step, 0.0, 0.0]


@pytest.fixture
def staged(tmp_path):
    session = read_session(planned_session(tmp_path, HEAD + STEPS))
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


def test_what_is_not_there_is_refused(staged, probed):
    flow = sample().flow
    with pytest.raises(InputError, match="no step 's0' after the first; there are s1, s2"):
        true_displacement(staged, "s0", flow)
    with pytest.raises(InputError, match="no probing 'n03'; there are n01, n02"):
        true_displacement(probed[0], "n03", flow)
    with pytest.raises(RecordError, match=r"truth_n02\.npz: cannot be read as a truth map"):
        true_displacement(probed[0], "n02", flow)
    (probed[0].path.parent / "truth_n02.npz").write_bytes(b"no map")
    with pytest.raises(RecordError, match=r"truth_n02\.npz: cannot be read as a truth map"):
        true_displacement(probed[0], "n02", flow)

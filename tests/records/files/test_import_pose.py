"""Where another program's frame lies in the object's."""

import numpy as np
import pytest

from palpate.errors import RecordError
from palpate.records.files.import_pose import read_import_pose

TURN = "R = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]"


def _pose(tmp_path, text):
    path = tmp_path / "pose.toml"
    path.write_text(text)
    return read_import_pose(path)


@pytest.mark.parametrize(
    "text",
    [
        f'length_unit = "mm"\n{TURN}\nt = [1, 2, 3]',
        'length_unit = "mm"\nT = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]',
    ],
)
def test_pose(tmp_path, text):
    pose, notes = _pose(tmp_path, text)
    # x_object = R x_file + t: the file's x axis is the object's y axis.
    np.testing.assert_allclose(pose @ [1.0, 0.0, 0.0, 1.0], [1e-3, 1.002, 3e-3, 1.0], rtol=1e-15)
    assert notes == ()


def test_pose_typed_with_few_digits_is_made_a_rotation(tmp_path):
    text = 'length_unit = "m"\nR = [[0.866, -0.5, 0], [0.5, 0.866, 0], [0, 0, 1]]\nt = [0, 0, 0]'
    pose, notes = _pose(tmp_path, text)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-15)
    # The nearest rotation to two typed numbers is theirs over their length.
    assert pose[0, 0] == pytest.approx(0.866 / np.hypot(0.866, 0.5), rel=1e-14)
    assert "R was made orthogonal; it was 4e-05 off" in notes[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{TURN}\nt = [0, 0, 0]", "the key 'length_unit' is missing"),
        ('length_unit = "km"', "is 'km'.*allowed: um, mm, cm, m, in"),
        ('length_unit = "m"', "must have either R and t, or T; for example: length_unit"),
        (f'length_unit = "m"\n{TURN}', "the key 't' is missing"),
        (f'length_unit = "m"\n{TURN}\nt = [0, 0, 0]\nT = [1]', "must have either R and t, or T"),
        ('length_unit = "m"\nR = [[1, 0], [0, 1]]\nt = [0, 0, 0]', "must be 3 rows of 3 finite"),
        ('length_unit = "m"\nR = "I"\nt = [0, 0, 0]', "must be 3 rows of 3 finite numbers"),
        (
            'length_unit = "m"\nR = [[1, 0, 0], [0, 1, 0.1], [0, 0, 1]]\nt = [0, 0, 0]',
            "R: is no rotation: R R.T is 0.1 off the identity",
        ),
        (
            'length_unit = "m"\nR = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]\nt = [0, 0, 0]',
            "is a mirror image",
        ),
        (
            'length_unit = "m"\nT = [[1,0,0,0], [0,1,0,0], [0,0,1,0], [0,0,0,2]]',
            r"has the last row \[0.0, 0.0, 0.0, 2.0\]",
        ),
        ('length_unit = "m"\nrotation = 1', "unknown key 'rotation'"),
        ("length_unit =", "is not valid TOML"),
    ],
)
def test_pose_refusals(tmp_path, text, message):
    with pytest.raises(RecordError, match=message):
        _pose(tmp_path, text)


@pytest.mark.parametrize(("error", "refused"), [(0.9e-3, False), (1.1e-3, True)])
def test_a_rotation_may_be_off_by_a_thousandth(tmp_path, error, refused):
    # R R^T is (1 + error / 2)^2 in one place: off by the error, to its square.
    text = f'length_unit = "m"\nR = [[{1 + error / 2}, 0, 0], [0, 1, 0], [0, 0, 1]]\nt = [0, 0, 0]'
    if refused:
        with pytest.raises(RecordError, match="is no rotation"):
            _pose(tmp_path, text)
        return
    pose, notes = _pose(tmp_path, text)
    np.testing.assert_allclose(pose, np.eye(4), atol=1e-15)
    assert "made orthogonal" in notes[0]

"""The log of the tool's pose is read in the units that its headings name."""

from pathlib import Path

import numpy as np
import pytest

from palpate.errors import RecordError
from palpate.recording.record import read_poses


@pytest.mark.parametrize(
    ("heading", "seconds", "metres"),
    [
        ("time,x,y,z", 1.0, 1e-2),
        ("t [ms],x,y,z", 1e-3, 1e-2),
        ("time [s],x [mm],y [mm],z [mm]", 1.0, 1e-3),
    ],
)
def test_units_of_headings_count(
    tmp_path: Path, heading: str, seconds: float, metres: float
) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(f"{heading}\n0,1,2,3\n4,5,6,7\n")
    poses = read_poses(path, metres_per_unit=1e-2)
    np.testing.assert_allclose(poses.time, [0.0, 4.0 * seconds], rtol=1e-12)
    np.testing.assert_allclose(poses.position[1], metres * np.array([5.0, 6.0, 7.0]), rtol=1e-12)


@pytest.mark.parametrize(
    ("heading", "says"),
    [
        ("time [min],x,y,z", r"'time \[min\]' is in 'min'; must be in one of s, ms, us, ns"),
        ("time,x [px],y [px],z [px]", r"is in 'px'; must be in one of um, mm"),
        ("time,x [mm],y [mm],z [m]", "different units"),
    ],
)
def test_other_units_are_refused(tmp_path: Path, heading: str, says: str) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(f"{heading}\n0,1,2,3\n4,5,6,7\n")
    with pytest.raises(RecordError, match=says):
        read_poses(path, metres_per_unit=1.0)

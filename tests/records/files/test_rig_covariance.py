"""What is known of a rig, written and read again, and files that hold something else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palpate.errors import CalibrationError, RecordError
from palpate.records import (
    RigCovariance,
    covariance_file,
    read_rig_covariance,
    write_rig_covariance,
)

KNOWN = RigCovariance(("c0.fx", "c1.tx"), np.array([900.0, 0.1]), np.diag([0.25, 1e-10]), "x")


def test_what_was_written_is_read(tmp_path: Path) -> None:
    assert covariance_file(tmp_path / "rig.toml") is None
    write_rig_covariance(tmp_path, KNOWN, np.array([0.1, 0.1]))
    for place in (tmp_path, tmp_path / "rig.toml"):
        found = read_rig_covariance(covariance_file(place))
        assert found.names == KNOWN.names
        np.testing.assert_array_equal(found.value, KNOWN.value)
        np.testing.assert_array_equal(found.covariance, KNOWN.covariance)


def test_what_is_no_covariance_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "rig_covariance.npz"
    file.write_bytes(b"PK, and then nothing")
    with pytest.raises(RecordError, match=r"cannot be read as the covariance.*calibrate again"):
        read_rig_covariance(file)
    np.savez(file, format="palpate-rig-covariance/9")
    with pytest.raises(RecordError, match="its format is 'palpate-rig-covariance/9'"):
        read_rig_covariance(file)
    with pytest.raises(CalibrationError, match="not symmetric"):
        replace(KNOWN, covariance=np.array([[1.0, 0.5], [0.0, 1.0]]))

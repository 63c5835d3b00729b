"""Repeats of table 3 as a campaign: the estimates are those of plain fits, the rig is another."""

import shutil

import pytest
from cube_session import cube_session as cube_session

from benchmarks.table3_repeats import fitted, misjudged_session
from palpate.pipeline import fit_session
from palpate.records import read_rig, read_session


@pytest.mark.slow
def test_a_campaign_estimates_what_plain_fits_do(cube_session, tmp_path):
    file = cube_session / "session.toml"
    (estimate,) = fitted([file], tmp_path / "campaign")
    expected = fit_session(read_session(file)).estimate
    # Rounding, times the condition of the model.
    for name in ("poisson_ratio", "young_modulus"):
        constant, other = getattr(estimate, name), getattr(expected, name)
        assert constant.value == pytest.approx(other.value, rel=1e-6)
        assert constant.ci95 == pytest.approx(other.ci95, rel=1e-5, nan_ok=True)
    assert len(estimate.probes) == len(expected.probes) == 1


def test_a_misjudged_session_has_a_rig_of_its_own(shared_data, tmp_path):
    folder = tmp_path / "1"
    shutil.copytree(shared_data / "halfball_images", folder)
    plain, misjudged = (read_session(file) for file in (folder, misjudged_session(folder)))
    assert len(misjudged.probings) == len(plain.probings)
    for true, wrong in zip(*(read_rig(s.rig).cameras for s in (plain, misjudged)), strict=True):
        assert true.matrix[0, 0] != wrong.matrix[0, 0]
        # Focal lengths are off by a thousandth.
        assert true.matrix[0, 0] == pytest.approx(wrong.matrix[0, 0], rel=1e-2)

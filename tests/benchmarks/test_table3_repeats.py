"""Repeats of table 3 as a campaign: the estimates are those of plain fits, the pose as given."""

from dataclasses import replace

import pytest

from benchmarks.table3_repeats import fitted, misjudged_session
from palpate.lab import built_in, choose_variant, make_session, read_lab_config
from palpate.paper import reduced
from palpate.pipeline import fit_session, with_pictures_measured
from palpate.records import read_session


@pytest.fixture
def repeat(tmp_path):
    """Folder of one repeat, named by its seed: one probing of a coarse half ball, seen small."""
    text = built_in()["half-ball"].read_text(encoding="utf-8")
    coarse = text.replace("edge = 0.004", "edge = 0.01").replace(
        "element = 0.006", "element = 0.02"
    )
    (tmp_path / "coarse.toml").write_text(coarse, encoding="utf-8")
    config = read_lab_config(tmp_path / "coarse.toml")
    folder = tmp_path / "1"
    folder.mkdir()
    few = reduced(replace(config, seed=1, probes=config.probes[:1]))
    make_session(few, folder, variant=choose_variant())
    return folder


@pytest.mark.slow
def test_a_campaign_estimates_what_plain_fits_do(repeat, tmp_path):
    # The misjudged session: registered instead of as given, its pose would be another.
    file = misjudged_session(repeat)
    (estimate,) = fitted([file], tmp_path / "campaign")
    session = read_session(file)
    assert session.rig.name == "rig_misjudged.toml"
    expected = fit_session(with_pictures_measured(session, pose="given")).estimate
    # Rounding, times the condition of the model.
    for name in ("poisson_ratio", "young_modulus"):
        one, other = getattr(estimate, name), getattr(expected, name)
        assert one.value == pytest.approx(other.value, rel=1e-6)
        assert one.ci95 == pytest.approx(other.ci95, rel=1e-5)
    assert len(estimate.probes) == len(expected.probes) == 1

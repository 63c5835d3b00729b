"""The table [errors]: defaults, units, what is refused."""

import numpy as np
import pytest

from palpate.errors import InputError, RecordError
from palpate.records import EXACT
from palpate.records.error_priors import ErrorPriors, read_error_priors
from palpate.records.text.toml_table import read_toml


def _read(tmp_path, text, metres=1e-3):
    file = tmp_path / "session.toml"
    file.write_text(text)
    return read_error_priors(read_toml(file), metres_per_unit=metres)


def test_what_is_not_said_has_its_default(tmp_path):
    assert _read(tmp_path, "") == ErrorPriors()
    priors = _read(tmp_path, '[errors]\nforce_gain = "0.3 %"\ncontact_point = 0\n')
    assert priors == ErrorPriors(force_gain=0.003, contact_point=0.0)


def test_units(tmp_path):
    priors = _read(
        tmp_path,
        "[errors]\nforce_gain = 0.02\ncontact_point = 1.5\ncontact_radius = 0.2\n"
        'length_scale = "0.1 %"\nforce_direction = "1 deg"\nforce = 0.005\n'
        'pose = { translation = "0.02 cm", rotation = "0.01 rad" }\n'
        'support_compliance = "20 um/kPa"\n',
    )
    # Plain lengths are in the session's unit, here mm.
    expected = ErrorPriors(
        force_gain=0.02, force_direction=np.pi / 180, force=0.005, contact_point=1.5e-3,
        contact_radius=0.2, pose_translation=2e-4, pose_rotation=0.01, length_scale=1e-3,
        support_compliance=2e-8,
    )  # fmt: skip
    for name in ErrorPriors.__slots__:
        assert getattr(priors, name) == pytest.approx(getattr(expected, name), rel=1e-12)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("force_gian = 0.01", "did you mean 'force_gain'"),
        ("force_gain = -0.01", "the standard deviation of force gain is -0.01; must be at least 0"),
        ("force_gain = 0.9", "at most 0.5"),
        ('force_gain = "1 N"', 'must be a number with its unit: "1 %"'),
        ('contact_point = "x mm"', 'must be a number with its unit: "1 um", "1 mm"'),
        ("force_direction = 1", 'must be a number with its unit: "1 deg", "1 rad"'),
        ("force_gain = true", "must be a number"),
        ("force_gain = nan", "must be a number"),
        ('contact_point = "1e400 mm"', "must be a number"),
        ("pose = 3", "[errors] pose"),
        ('pose = { translations = "1 mm" }', "did you mean 'translation'"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, line, message):
    with pytest.raises(RecordError) as caught:
        _read(tmp_path, f"[errors]\n{line}\n")
    assert message in str(caught.value)
    assert "session.toml" in str(caught.value)


def test_exact_is_nothing_at_all():
    assert EXACT.contact_std("any") == 0.0 == len(EXACT.contact_points)
    assert EXACT.gain_std("any") == 0.0 == len(EXACT.force_gains)
    mappings = ("contact_points", "force_gains")
    numbers = [name for name in ErrorPriors.__slots__ if name not in mappings]
    assert all(getattr(EXACT, name) == 0.0 for name in numbers)
    with pytest.raises(InputError, match="contact point is 2; must be at least 0"):
        ErrorPriors(contact_point=2.0)


_PROBES = """
[[probe]]
name = "a"
contact = { point = [0, 0, 1], point_std = %s }
[[probe]]
name = "b"
contact = { point = [0, 0, 1] }
"""


def test_a_contact_may_be_known_otherwise_than_the_others(tmp_path):
    priors = _read(tmp_path, '[errors]\ncontact_point = "1 mm"\n' + _PROBES % 0.25)
    # In the session's unit, here mm.
    assert priors.contact_std("a") == pytest.approx(0.25e-3, rel=1e-12)
    assert priors.contact_std("b") == 1e-3
    assert _read(tmp_path, _PROBES % '"0.3 cm"').contact_std("a") == pytest.approx(3e-3, rel=1e-12)
    with pytest.raises(RecordError, match=r"'a' contact point_std: is 'x'; must be a number"):
        _read(tmp_path, _PROBES % '"x"')
    with pytest.raises(RecordError, match=r"session.toml.*contact point of 'a' is -0.001"):
        _read(tmp_path, _PROBES % -1)


_SENSORS = """
[[probe]]
name = "a"
force_sensor = "gauge"
[[probe]]
name = "b"
force_sensor = "weights"
"""


def test_every_force_sensor_may_have_a_gain_of_its_own(tmp_path):
    priors = _read(tmp_path, '[errors]\nforce_gain = { weights = "0.05 %" }\n' + _SENSORS)
    assert priors.gain_std("weights") == pytest.approx(5e-4, rel=1e-12)
    # The gauge has the default.
    assert priors.gain_std("gauge") == ErrorPriors().force_gain
    assert _read(tmp_path, "[errors]\nforce_gain = 0.02\n" + _SENSORS).gain_std("gauge") == 0.02


@pytest.mark.parametrize(
    ("gains", "probes", "message"),
    [
        ("{ weight = 0.001 }", _SENSORS, "did you mean 'weights'? (allowed: gauge, weights)"),
        ("{ gauge = 0.9 }", _SENSORS, "the force gain of 'gauge' is 0.9; must be at least 0"),
        ('{ gauge = "1 N" }', _SENSORS, '[errors] force_gain gauge: is \'1 N\'; must be'),
        ("{ gauge = 0.01 }", "", "no probing names its sensor; give every probing its"),
    ],
)  # fmt: skip
def test_gains_of_sensors_that_cannot_be(tmp_path, gains, probes, message):
    with pytest.raises(RecordError) as caught:
        _read(tmp_path, f"[errors]\nforce_gain = {gains}\n{probes}")
    assert message in str(caught.value)
    assert "session.toml" in str(caught.value)


def test_a_calibrated_rig_replaces_the_default_of_lengths_only(tmp_path):
    file = tmp_path / "session.toml"
    for text, expected in (("", 0.0), ("[errors]\nlength_scale = 0.001\n", 1e-3)):
        file.write_text(text)
        priors = read_error_priors(read_toml(file), metres_per_unit=1.0, calibrated=True)
        assert priors == ErrorPriors(length_scale=expected)

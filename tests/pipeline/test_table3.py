"""Table 3 of the paper from pictures and forces to constants, once, at full size."""

import numpy as np
import pytest

from palpate.lab import choose_variant, read_lab_config
from palpate.lab.config_files import built_in
from palpate.paper.constants import estimated_constants
from palpate.paper.sessions import measured_session, true_material


@pytest.mark.slow
def test_seventeen_probings_tell_what_the_half_ball_is_made_of(tmp_path):
    config = read_lab_config(built_in()["half-ball"])
    measured = measured_session(config, tmp_path, methods=("joint",), variant=choose_variant())
    truth = true_material(measured.session)
    estimate = estimated_constants(measured, "joint").result.estimate
    assert len(estimate.probes) == 17
    # The paper: E 2.4 % from its compression test, nu from 0.118 to 0.252 over the probings, so
    # that 0.02 is half of its spread. Twenty seeds of this bench: 0.54 % and 0.0024 rms.
    assert estimate.young_modulus.value == pytest.approx(truth.young_modulus, rel=0.024)
    assert estimate.poisson_ratio.value == pytest.approx(truth.poisson_ratio, abs=0.02)
    assert all(estimate.identifiable.values())
    shear = np.array([probe.shear_modulus.value for probe in estimate.probes])
    nu = np.array([probe.poisson_ratio.value for probe in estimate.probes])
    assert shear.std(ddof=1) < 0.05 * shear.mean()
    assert nu.std(ddof=1) < 0.03
    # The seventeen know more than the best of them does.
    widths = [np.ptp(probe.young_modulus.ci95) for probe in estimate.probes]
    assert np.ptp(estimate.young_modulus.ci95) < min(widths)

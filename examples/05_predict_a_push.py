"""Predict a push that was not fitted: the test that a model has to pass.

python examples/05_predict_a_push.py
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import palpate

HERE = Path(__file__).parent


def main() -> float:
    """Fit two probings of the half ball, predict a third; gives the share of what was measured
    within two standard deviations of the prediction."""
    session = palpate.read_session(HERE / "half_ball")
    given, other = session.probings[:2], session.probings[3]
    result = palpate.fit(replace(session, probings=given))
    (prediction,) = result.predict(replace(session, probings=(other,)))
    off = prediction.measured - prediction.predicted
    known = np.isfinite(off)
    # What the prediction may be off, and the noise of what was measured.
    sigma = np.hypot(prediction.std, prediction.noise)
    share = float(np.mean(np.abs(off[known]) < 2.0 * sigma[known]))
    moved = 1e3 * np.nanmax(np.linalg.norm(prediction.measured, axis=1))
    print(f"{prediction.name} moves points by up to {moved:.2f} mm")
    print(f"{100 * share:.0f} % of the components are within two standard deviations")
    return share


if __name__ == "__main__":
    main()

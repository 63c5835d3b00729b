"""halfball_probes: finite element displacements of 17 probings, clean and noisy."""

import tomllib

import numpy as np

from benchmarks.figure import ESTIMATION, Figure
from benchmarks.machine import SHARED
from benchmarks.options import Options
from benchmarks.session_observations import session_observations
from palpate.estimation import fisher_information
from palpate.pipeline import fit_session
from palpate.records import Estimate, Session, read_session

FOLDER = SHARED / "halfball_probes"


def measure(options: Options) -> list[Figure]:
    """Errors of E and nu from all probings, spread of nu over single ones."""
    truth = tomllib.loads((FOLDER / "truth.toml").read_text(encoding="utf-8"))
    clean = fit_session(read_session(FOLDER / "session_clean.toml")).estimate
    session = read_session(FOLDER / "session_noisy.toml")
    noisy = fit_session(session).estimate
    return [
        *_clean(clean, truth),
        *_noisy(noisy, truth),
        *_single(noisy, session, truth),
    ]


def _clean(estimate: Estimate, truth: dict[str, float]) -> list[Figure]:
    e, nu = estimate.young_modulus.value, estimate.poisson_ratio.value
    return [
        Figure(
            ESTIMATION,
            "halfball_probes clean, all probings: error of E",
            100 * abs(e / truth["young_modulus"] - 1),
            "%",
            note=f"E {e:.1f} Pa, truth {truth['young_modulus']:.0f} Pa; the finite elements' own"
            " error is 0.09 % in displacement",
        ),
        Figure(
            ESTIMATION,
            "halfball_probes clean, all probings: error of nu",
            abs(nu - truth["poisson_ratio"]),
            note=f"nu {nu:.5f}, truth {truth['poisson_ratio']}",
        ),
    ]


def _noisy(estimate: Estimate, truth: dict[str, float]) -> list[Figure]:
    constants = (("E", "young_modulus", "%"), ("nu", "poisson_ratio", ""))
    figures = []
    for symbol, name, unit in constants:
        constant = getattr(estimate, name)
        error = abs(constant.value - truth[name])
        shown = 100 * error / truth[name] if unit else error
        title = f"halfball_probes noisy (3 % outliers, 10 % NaN): error of {symbol}"
        note = (
            f"{symbol} {constant.value:.6g}, claimed sigma {constant.std:.2g}, truth"
            f" {truth[name]:.6g}"
        )
        figures += [
            Figure(ESTIMATION, title, shown, unit, note=note),
            Figure(ESTIMATION, f"{title}, in claimed sigmas", error / constant.std, note=note),
        ]
    return figures


def _single(estimate: Estimate, session: Session, truth: dict[str, float]) -> list[Figure]:
    """Spread of nu over the single probings of the noisy session over its bound."""
    nu = np.array([probe.poisson_ratio.value for probe in estimate.probes])
    constants = {name: truth[name] for name in ("poisson_ratio", "shear_modulus")}
    bound = np.array(
        [
            fisher_information([probe], **constants).bound()["poisson_ratio"]
            for probe in session_observations(session)
        ]
    )
    spread = float(nu.std(ddof=1))
    scaled = float(np.sqrt(np.mean(((nu - truth["poisson_ratio"]) / bound) ** 2)))
    return [
        Figure(
            ESTIMATION,
            "single noisy probings: sd of nu over probings, over mean Cramer-Rao sd",
            spread / float(bound.mean()),
            "x",
            note=f"nu {nu.min():.3f} to {nu.max():.3f}, sd {spread:.4f}, mean bound"
            f" {bound.mean():.4f} (Gaussian noise, outliers counted as good points); rms of"
            f" (nu - truth) / own bound {scaled:.2f}",
        )
    ]

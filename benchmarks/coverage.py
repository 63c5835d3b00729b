"""Do the 95 % intervals cover in 95 % of seeded repeats, and how near is the error to its bound?

Works with any probings whose displacements are exact: every repeat adds noise, gross outliers,
missing rows and force errors of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.estimation import (
    FitSettings,
    ProbeObservations,
    fisher_information,
    fit,
)

NAMES = ("poisson_ratio", "shear_modulus", "young_modulus")


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What is done to exact probings.

    Parameters
    ----------
    noise : (3,) float [m]          1 sigma in x, y and z
    force_noise : float             1 sigma per component over the length of the force
    outliers, missing : float       shares of the points
    outlier_sigmas : (float, float) length of a gross error in sigmas
    correlation_length : float [m]  of the noise, 0 = independent points
    noise_over_claim : float        true noise over the std that the probing claims
    force_scale_spread : float      1 sigma of an unclaimed scale error of each force
    """

    noise: tuple[float, float, float] = (3e-5, 3e-5, 8e-5)
    force_noise: float = 0.01
    outliers: float = 0.0
    missing: float = 0.0
    outlier_sigmas: tuple[float, float] = (10.0, 40.0)
    correlation_length: float = 0.0
    noise_over_claim: float = 1.0
    force_scale_spread: float = 0.0


@dataclass(frozen=True, slots=True)
class Coverage:
    """Outcome of the repeats.

    Parameters
    ----------
    repeats : int
    covered : constant -> share of the intervals that hold the truth
    error_over_bound : constant -> root mean square error over the Cramer-Rao bound
    width_over_bound : constant -> median interval over 2 * 1.96 bounds
    bias_over_bound : constant -> mean error over the bound
    """

    repeats: int
    covered: dict[str, float]
    error_over_bound: dict[str, float]
    width_over_bound: dict[str, float]
    bias_over_bound: dict[str, float]


def disturbed(
    probe: ProbeObservations, disturbance: Disturbance, rng: np.random.Generator
) -> ProbeObservations:
    """One probing with noise, outliers, missing rows and a force error, claims as configured."""
    n = len(probe.position)
    sigma = np.tile(disturbance.noise, (n, 1))
    moved = probe.displacement + disturbance.noise_over_claim * sigma * unit_noise(
        probe.position, disturbance.correlation_length, rng
    )
    wild = rng.random(n) < disturbance.outliers
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    length = rng.uniform(*disturbance.outlier_sigmas, size=(n, 1))
    moved = np.where(wild[:, None], moved + sigma * direction * length, moved)
    moved[rng.random(n) < disturbance.missing] = np.nan
    force_std = np.full(3, disturbance.force_noise * np.linalg.norm(probe.force))
    scale = 1 + disturbance.force_scale_spread * rng.normal()
    tip = probe.tip_displacement
    return replace(
        probe,
        displacement=moved,
        std=sigma,
        force=scale * probe.force + force_std * rng.normal(size=3),
        force_std=force_std,
        tip_displacement=None if tip is None else tip + 5e-5 * rng.normal(size=3),
        tip_displacement_std=None if tip is None else np.full(3, 5e-5),
    )


def measured_coverage(
    exact: Sequence[ProbeObservations],
    *,
    poisson_ratio: float,
    shear_modulus: float,
    disturbance: Disturbance,
    repeats: int = 500,
    seed: int = 0,
    settings: FitSettings | None = None,
) -> Coverage:
    """Fit seeded noisy repeats of exact probings and count.

    Parameters
    ----------
    exact : sequence of ProbeObservations   exact displacement and force
    poisson_ratio : float [-]               truth
    shear_modulus : float [Pa]              truth
    disturbance : Disturbance
    repeats, seed : int
    settings : FitSettings or None
    """
    young = 2 * shear_modulus * (1 + poisson_ratio)
    truth = dict(zip(NAMES, (poisson_ratio, shear_modulus, young), strict=True))
    errors: list[list[float]] = []
    inside: list[list[bool]] = []
    widths: list[list[float]] = []
    for repeat in range(repeats):
        rng = np.random.default_rng([seed, repeat])
        probes = [disturbed(probe, disturbance, rng) for probe in exact]
        if repeat == 0:
            bound = fisher_information(
                probes, poisson_ratio=poisson_ratio, shear_modulus=shear_modulus
            ).bound()
        intervals = fit(probes, settings=settings or FitSettings()).intervals
        errors.append([getattr(intervals, name).value - truth[name] for name in NAMES])
        ends = [getattr(intervals, name).ci95 for name in NAMES]
        inside.append([e[0] <= truth[name] <= e[1] for e, name in zip(ends, NAMES, strict=True)])
        widths.append([e[1] - e[0] for e in ends])
    limit = np.array([bound[name] for name in NAMES])
    error = np.array(errors)
    return Coverage(
        repeats=repeats,
        covered=_named(np.mean(inside, axis=0)),
        error_over_bound=_named(np.sqrt((error**2).mean(0)) / limit),
        width_over_bound=_named(np.median(widths, axis=0) / (2 * 1.96 * limit)),
        bias_over_bound=_named(error.mean(0) / limit),
    )


def _named(values: Float[np.ndarray, "3"]) -> dict[str, float]:
    return {name: round(float(value), 4) for name, value in zip(NAMES, values, strict=True)}


def unit_noise(
    position: Float[np.ndarray, "n 3"], length: float, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Noise of variance one, with a Gaussian correlation where a length is given [m]."""
    if length <= 0:
        return rng.normal(size=position.shape)
    squared = ((position[:, None] - position[None]) ** 2).sum(-1)
    covariance = np.exp(-squared / (2 * length**2)) + 1e-8 * np.eye(len(position))
    return np.linalg.cholesky(covariance) @ rng.normal(size=position.shape)

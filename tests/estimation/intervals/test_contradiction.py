"""Residuals that are noise, and residuals that no noise makes, on a half ball of 40 mm."""

import numpy as np
import pytest

from palpate.estimation.intervals.contradiction import contradiction
from palpate.estimation.intervals.validation import ProbeFit
from palpate.estimation.observations import ProbeObservations

RADIUS = 0.04
MOTION = 1e-3
TOP = np.array([0.0, 0.0, RADIUS])


class NoModel:
    """Stands for responses, which are not asked."""

    def value(self, poisson_ratio: float):
        raise NotImplementedError

    slope = value


def half_ball(count: int = 400) -> np.ndarray:
    """Even points on a half ball (a Fibonacci spiral), shuffled."""
    k = np.arange(count) + 0.5
    height, angle = k / count, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - height**2)
    points = RADIUS * np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)
    return np.random.default_rng(0).permutation(points)


def found(points, residual, std=None):
    """What contradicts a model that leaves a residual of a motion of 1 mm."""
    moved = np.tile([0.0, 0.0, -MOTION], (len(points), 1))
    support = RADIUS * np.stack([np.cos(a := np.linspace(0, 6, 20)), np.sin(a), 0 * a], axis=1)
    probe = ProbeObservations(
        name="n01", position=points, displacement=moved, std=std, force=np.array([0.0, 0, -1]),
        force_std=np.zeros(3), tip_displacement=None, tip_displacement_std=None,
        response=NoModel(), landmarks={"the contact": TOP[None], "the support": support},
    )  # fmt: skip
    weight = np.ones_like(residual)
    return contradiction(probe, ProbeFit("n01", moved - residual, residual, weight, None))


def noise(points, share, rng, length=0.0):
    """Noise of a share of the motion, shared over a length (Gaussian correlation)."""
    unit = rng.normal(size=points.shape)
    if length:
        square = ((points[:, None] - points) ** 2).sum(axis=2)
        root = np.linalg.cholesky(np.exp(-square / (2 * length**2)) + 1e-8 * np.eye(len(points)))
        unit = root @ unit
    return share * MOTION / 3**0.5 * unit


@pytest.mark.parametrize("length", [0.0, 4e-3])
@pytest.mark.parametrize("share", [0.01, 0.2])
@pytest.mark.parametrize("count", [30, 400, 1500])
def test_noise_does_not_contradict(share, length, count):
    rng, points = np.random.default_rng(3), half_ball(count)
    for _ in range(5):
        assert found(points, noise(points, share, rng, length)) is None


def test_gross_outliers_do_not_contradict():
    rng, points = np.random.default_rng(4), half_ball()
    for _ in range(20):
        residual = noise(points, 0.1, rng)
        wild = rng.random(len(points)) < 0.05
        residual[wild] += MOTION * rng.normal(size=(wild.sum(), 3))
        assert found(points, residual) is None


def test_points_that_claim_little_prove_little():
    """Where the surface turns away from the cameras noise is ten times as large, and shared."""
    rng, points = np.random.default_rng(5), half_ball()
    scale = np.where(points[:, 2] < 0.2 * RADIUS, 10.0, 1.0)[:, None]
    std = np.tile(0.02 * MOTION * scale, 3)
    blamed = 0
    for _ in range(10):
        residual = scale * noise(points, 0.02 * 3**0.5, rng, length=6e-3)
        assert found(points, residual, std) is None
        blamed += found(points, residual) is not None
    # Without the claims it often looks like a dent.
    assert blamed > 2


def bent(points, share):
    """What a support leaves that gives: a residual that grows over the whole body."""
    return share * MOTION * np.stack([0 * points[:, 0], points[:, 0], points[:, 0]], 1) / RADIUS


def dent(points, share):
    """What a misplaced contact leaves: a residual at one place."""
    away = np.linalg.norm(points - TOP, axis=1)
    return share * MOTION * np.exp(-0.5 * (away / 8e-3) ** 2)[:, None] * [1.0, 0.0, 1.0]


@pytest.mark.parametrize("share", [0.01, 0.1])
def test_a_bent_body_contradicts_wherever_noise_allows(share):
    rng, points = np.random.default_rng(5), half_ball()
    what = found(points, bent(points, 0.1) + noise(points, share, rng, 4e-3))
    assert what.name == "n01"
    # Root mean square of x over the radius of a half ball is sqrt(1/3), twice: 0.1 sqrt(2/3).
    assert what.share == pytest.approx(0.082, rel=0.2)
    assert abs(what.place[0]) > 0.5 * RADIUS


def test_a_dent_contradicts_and_its_place_is_named():
    rng, points = np.random.default_rng(6), half_ball()
    what = found(points, dent(points, 0.5) + noise(points, 0.02, rng))
    assert what.landmark == "the contact"
    # The median over 13 of 400 neighbours reaches 10 mm.
    assert np.linalg.norm(what.place - TOP) < 10e-3
    # The same residuals with the body lying on its side: the dent is at the rim.
    moved = np.stack([points[:, 2], points[:, 1], points[:, 0]], axis=1)
    assert found(moved, dent(points, 0.5) + noise(points, 0.02, rng)).landmark == "the support"


def test_what_ordinary_meshes_leave_does_not_contradict():
    rng, points = np.random.default_rng(7), half_ball()
    assert found(points, bent(points, 0.01) + noise(points, 0.005, rng)) is None
    assert found(points, dent(points, 0.05) + noise(points, 0.005, rng)) is None


def test_few_points_show_no_order():
    points = half_ball(29)
    assert found(points, bent(points, 0.5)) is None
    points = half_ball(60)
    assert found(points, bent(points, 0.5)) is not None


def test_points_that_were_not_measured_do_not_count():
    rng, points = np.random.default_rng(8), half_ball()
    residual = bent(points, 0.1) + noise(points, 0.02, rng)
    residual[rng.random(len(points)) < 0.3] = np.nan
    assert found(points, residual) is not None

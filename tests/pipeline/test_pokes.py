"""Fits of pokes of a block whose constants are known, on another mesh than the fit's."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from surfaces import box

from benchmarks import pokes
from palpate.errors import InputError
from palpate.estimation import FitSettings
from palpate.field import make_poke_model
from palpate.pipeline import Material, fit_session, pooled
from palpate.probe import dent
from palpate.records import Contact, Probing, Session, Sphere, Status, without_pictures
from palpate.records.error_priors import ErrorPriors

SHEAR, RATIO, SIZE = 8e3, 0.45, (0.04, 0.04, 0.02)
TOOL, DEPTH = Sphere(4e-3), 1e-3
CONSTANTS = {"shear_modulus": SHEAR, "poisson_ratio": RATIO}
SETTINGS = FitSettings(poisson_range=(0.4, 0.4999))


def session(count=5):
    """Pokes on a grid, half a millimetre to a millimetre deep, without their forces' noise."""
    mesh = box(size=SIZE, cells=8)
    held = np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] < 1e-9).all(axis=1))
    x = np.linspace(0.008, 0.032, count)
    probings = tuple(
        Probing(f"p{k}{m}", Contact(np.array([x[k], x[m], SIZE[2]]), 1e-3, "hertz", tool=TOOL),
                np.array([0.0, 0.0, -0.1]), np.zeros(3), np.array([0.0, 0.0, -DEPTH]),
                np.full(3, 1e-6), None, None)
        for k in range(count) for m in range(count)
    )  # fmt: skip
    priors = ErrorPriors(force_gain=0.01, tool_compliance=1e-5)
    return Session("block", Path(), mesh, held, probings, None, None, None, (), errors=priors)


@pytest.fixture(scope="module")
def poked():
    """With the forces that press the tool in so far, by finer elements than those of the fit."""
    given = session()
    regular = make_poke_model(given, elements=9000).regular(RATIO)
    depths = DEPTH * np.linspace(0.5, 1.0, len(regular))
    probings = []
    for probing, depth, more in zip(given.probings, depths, regular, strict=True):
        force = brentq(
            lambda f, more=more, depth=depth: dent(TOOL, f, **CONSTANTS) + more * f / SHEAR - depth,
            1e-6, 5.0,
        )  # fmt: skip
        down = np.array([0.0, 0.0, -1.0])
        probings.append(replace(probing, force=force * down, tip_displacement=depth * down))
    return replace(given, probings=tuple(probings))


def test_pokes_are_pooled_into_points(poked):
    assert without_pictures(poked)
    (together,) = pooled(poked).probings
    np.testing.assert_allclose(
        together.displacement.displacement, [probing.tip_displacement for probing in poked.probings]
    )
    assert not without_pictures(pooled(poked))


def test_constants_are_those_of_the_block(poked):
    """To 1 %: of the elements; the force's gain alone is assumed as well known."""
    result = fit_session(poked, settings=SETTINGS)
    estimate = result.estimate
    assert estimate.young_modulus.value == pytest.approx(2.0 * SHEAR * (1.0 + RATIO), rel=0.02)
    low, high = estimate.young_modulus.ci95
    assert low < 2.0 * SHEAR * (1.0 + RATIO) < high
    # A gain of 1 % is 1 % of E, and not 1.5, which it would be under a circle of fixed size.
    gain = next(entry for entry in estimate.budget if entry.source == "gain of the force sensor")
    assert gain.young_modulus == pytest.approx(0.01, rel=0.1)
    (made,) = result.predict(poked)
    np.testing.assert_allclose(made.predicted[:, 2], made.measured[:, 2], rtol=0.01)


def test_a_gain_that_is_off_moves_the_modulus_as_much(poked):
    louder = replace(
        poked,
        probings=tuple(replace(probing, force=1.2 * probing.force) for probing in poked.probings),
    )
    plain, loud = (
        fit_session(given, settings=SETTINGS).estimate.shear_modulus.value
        for given in (poked, louder)
    )
    assert loud / plain == pytest.approx(1.2, rel=1e-3)


def test_finite_strain_is_refused(poked):
    with pytest.raises(InputError, match="--strain small"):
        fit_session(poked, finite_strain=True)


@pytest.mark.slow
def test_a_block_of_two_halves_is_not_the_same_everywhere(poked):
    """Forces on one half are half as large again."""
    harder = tuple(
        replace(probing, force=(1.5 if probing.contact.point[0] > 0.02 else 1.0) * probing.force)
        for probing in poked.probings
    )
    result = fit_session(
        replace(poked, probings=harder), settings=SETTINGS, material=Material.FIELD
    )
    assert result.estimate.status is not Status.OK
    assert result.map is not None
    centre = result.map.nodes[result.map.tetrahedra].mean(axis=1)
    near = centre[:, 2] > 0.015
    halves = centre[:, 0] > 0.026, centre[:, 0] < 0.014
    stiff, soft = (float(np.median(result.map.log_modulus[near & side])) for side in halves)
    std = np.hypot(*(np.median(result.map.std[near & side]) for side in halves))
    # The law of dents: as much in force is as much in modulus. A smooth field of the evidence's
    # size stays behind a step.
    assert 0.5 * np.log(1.5) < stiff - soft < 1.1 * np.log(1.5)
    assert abs(stiff - soft - np.log(1.5)) < 2.0 * std


@pytest.mark.slow
def test_a_field_of_pokes_predicts_better_than_a_map_of_the_tips_stiffness(tmp_path, capsys):
    """Inclusions that no length of two elements tells from noise."""
    pokes.run(40, "inclusions", tmp_path, 0)
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if " pokes " in line]
    error = {words[3]: float(words[words.index("rms") + 1]) for words in lines}
    assert error["field"] < error["peer"] < error["homogeneous"]

"""The paper's numbers: what they must satisfy among themselves, and what its text says of them."""

import numpy as np
import pytest

from palpate.paper.sessions import (
    PAPER_ALL_PROBES,
    PAPER_ANGLE_ERROR_ROTATION,
    PAPER_ANGLE_ERROR_X,
    PAPER_ANGLE_ERROR_Y,
    PAPER_COMPRESSION_MODULUS,
    PAPER_FLOW_LEFT_REAR,
    PAPER_FLOW_REAR_RIGHT,
    PAPER_PROBES,
)

FLOWS = (PAPER_FLOW_LEFT_REAR, PAPER_FLOW_REAR_RIGHT)
TURNS = (PAPER_ANGLE_ERROR_X, PAPER_ANGLE_ERROR_Y, PAPER_ANGLE_ERROR_ROTATION)


@pytest.mark.parametrize("rows", [*FLOWS, *TURNS])
def test_eight_steps_each(rows):
    assert [row.step for row in rows] == list(range(1, 9))


@pytest.mark.parametrize("rows", FLOWS)
def test_the_motion_between_steps_is_two_and_a_half_millimetres(rows):
    for row in rows:
        assert row.command == pytest.approx(2.5e-3 * row.step, rel=1e-12)
        # The text: correct motion from encoders, which lag behind by up to 0.36 mm.
        assert 0.0 < row.command - row.encoder < 0.4e-3
        # The text: "about half a millimetre accuracy" of translation; a digit lost would show.
        assert abs(row.length.mean / row.encoder - 1.0) < 0.14
        assert 0.3e-3 < row.length.std < 1e-3


@pytest.mark.parametrize("rows", FLOWS)
def test_angles_are_in_radians_and_vary_less_with_greater_translation(rows):
    sigma = [row.angle.std for row in rows]
    assert sigma == sorted(sigma, reverse=True)
    assert min(row.angle.mean for row in rows) > 0.75
    assert max(row.angle.mean for row in rows) < 1.2


def test_errors_of_direction_are_printed_in_degrees():
    assert np.degrees(PAPER_ANGLE_ERROR_X[0].angle.mean) == pytest.approx(10.9142)
    assert np.degrees(PAPER_ANGLE_ERROR_Y[5].angle.std) == pytest.approx(9.994)
    assert all(row.length is row.command is None for row in TURNS[0] + TURNS[1])


def test_the_rotation_moves_vertices_by_what_was_commanded():
    for row in PAPER_ANGLE_ERROR_ROTATION:
        # Chords of 2, 4, ... degrees of the same circle; fewer far vertices are seen in the end.
        chord = np.sin(np.radians(row.step)) / np.sin(np.radians(1.0))
        assert row.command == pytest.approx(3.053e-3 * chord, rel=0.05)
        # Measured lengths fall behind, by 2 per cent at first and 8 in the end.
        assert 0.92 < row.length.mean / row.command < 0.985


@pytest.mark.parametrize("row", [*PAPER_PROBES, PAPER_ALL_PROBES])
def test_constants_of_a_row_fit_together(row):
    # Printed to four digits of the shear modulus.
    young = 2.0 * row.shear_modulus * (1.0 + row.poisson_ratio)
    assert row.young_modulus == pytest.approx(young, abs=1.1e-3)


def test_constants_are_those_the_text_speaks_of():
    assert len({row.node for row in PAPER_PROBES}) == 17
    assert {
        min(r.poisson_ratio for r in PAPER_PROBES),
        max(r.poisson_ratio for r in PAPER_PROBES),
    } == {
        0.1183,
        0.2516,
    }
    off = PAPER_COMPRESSION_MODULUS / PAPER_ALL_PROBES.young_modulus - 1.0
    assert off == pytest.approx(0.024, abs=5e-4)

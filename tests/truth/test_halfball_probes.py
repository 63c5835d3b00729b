"""Finite element truth of probings on a smooth half ball (`../shared/data/halfball_probes`), at the
true constants."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.bem import factorise, solve
from palpate.bem.elastic_map import sorted_state
from palpate.geometry import interpolation_matrix
from palpate.pipeline import make_object_model
from palpate.records import read_session

POISSON, SHEAR = 0.21, 52000.0 / 2 / 1.21
# From the pole to near the rim of the support.
PROBES = ("n01", "n05", "n11", "n17")


@pytest.fixture(scope="module")
def compared(shared_data):
    """Predicted and true displacements of each probing's points, then of its tips."""
    session = read_session(shared_data / "halfball_probes" / "session_clean.toml")
    probings = tuple(probing for probing in session.probings if probing.name in PROBES)
    model = make_object_model(replace(session, probings=probings))
    x = solve(factorise(model.system, POISSON), model.right.at(POISSON)) / SHEAR
    equations = model.tips.equations
    diagonal = equations.own[0] + POISSON * equations.own[1]
    matrix = equations.matrix[0] + POISSON * equations.matrix[1]
    right = equations.by_point(model.tips.right.at(POISSON)) / SHEAR
    fields, tips = [], []
    for probing, patch in zip(probings, model.loads.patch_of, strict=True):
        columns = slice(3 * patch, 3 * patch + 3)
        unknowns = x[:, columns] @ probing.force
        state = sorted_state(model.system, unknowns, SHEAR)
        surface = probing.displacement.surface
        nodes = model.system.surface.displacement
        at_points = interpolation_matrix(nodes, surface.triangle, surface.barycentric)
        fields.append((at_points @ state.displacement, probing.displacement.displacement))
        left = matrix[patch] @ unknowns - right[patch][:, columns] @ probing.force
        tips.append((np.linalg.solve(diagonal[patch], left), probing.tip_displacement))
    return fields, tips


def relative(pairs):
    return np.array([np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in pairs])


@pytest.mark.slow
def test_the_field_around_every_probing(compared):
    errors = relative(compared[0])
    # 1200 vertices, 0.2 to 0.4 % reached; the finite elements' own error is 0.1 % rms.
    assert errors.max() < 0.006


@pytest.mark.slow
def test_the_scale_of_the_field_is_the_stiffness(compared):
    predicted, true = (np.concatenate([pair[k].ravel() for pair in compared[0]]) for k in (0, 1))
    # A wrong scale would be a wrong modulus: the issue asks for 0.5 % in E.
    assert abs(predicted @ true / (true @ true) - 1) < 2e-3


@pytest.mark.slow
def test_the_tip_sinks_in_as_far(compared):
    errors = relative(compared[1])
    # The patch is three elements wide; 0.3 to 0.6 % reached, and the finite elements' tip is good
    # to 0.3 %.
    assert errors.max() < 0.008

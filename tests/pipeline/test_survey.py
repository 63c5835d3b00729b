"""What can be said about a session before any fit."""

from dataclasses import replace

import numpy as np
import pytest
from cube_session import cube_session as cube_session

from palpate.geometry import TriangleMesh
from palpate.pipeline import (
    ProbingSurvey,
    session_outlook,
    size_notes,
    survey_field,
    survey_probing,
)
from palpate.records import read_session


@pytest.fixture
def session(cube_session):
    return read_session(cube_session)


def test_figures_of_a_probing_have_their_closed_forms(session):
    survey = survey_probing(session, session.probings[0])
    # 218 vertices, 49 of them on the floor; one row is NaN.
    assert (survey.observed, survey.missing) == (218 - 49 - 1, 1)
    assert survey.median_displacement == pytest.approx(5e-4)
    # Every vector is (0.3, 0, -0.4) mm with 0.1 mm of sigma.
    assert survey.signal_to_noise == pytest.approx(5.0)
    # Two legs and a hypotenuse a triangle.
    assert survey.elements_per_radius == pytest.approx(0.006 / (0.04 / 6 * (2 + 2**0.5) / 3))
    # The four squares of 6.67 mm around a grid vertex: their diagonals pass it at 4.7 mm.
    assert survey.patch_triangles == 8
    # Everything free lies within eight radii (48 mm) of the top's centre.
    assert survey.near == survey.observed


def test_the_tangential_signal_is_that_along_the_surface(session):
    field = session.probings[0].displacement
    # On the top 0.3 of 0.5 mm lie along the surface.
    top = np.isclose(field.points[:, 2], 0.04) & (np.abs(field.points[:, :2] - 0.02) < 0.015).all(1)
    only = replace(field, displacement=np.where(top[:, None], field.displacement, np.nan))
    probing = replace(session.probings[0], displacement=only)
    survey = survey_probing(session, probing)
    assert survey.observed == 25
    assert survey.tangential_signal == pytest.approx(3.0)


def test_only_points_near_the_contact_count_as_near(session):
    contact = replace(session.probings[0].contact, radius=0.0015)
    survey = survey_probing(session, replace(session.probings[0], contact=contact))
    field = session.probings[0].displacement
    away = np.linalg.norm(field.points - contact.point, axis=1)
    # Eight radii are 12 mm: the grid of 6.67 mm has nine vertices there.
    assert survey.near == 9 == (away < 0.012).sum()


def test_a_field_without_any_measured_point_has_no_medians(session):
    field = session.probings[0].displacement
    nothing = replace(field, displacement=np.full_like(field.displacement, np.nan))
    survey = survey_field(nothing)
    assert (survey.observed, survey.missing) == (0, len(field.points))
    assert np.isnan([survey.median_displacement, survey.median_sigma]).all()
    probing = survey_probing(session, replace(session.probings[0], displacement=nothing))
    assert np.isnan(probing.signal_to_noise)


def test_medians_of_a_field(session):
    survey = survey_field(session.probings[0].displacement)
    assert survey.median_displacement == pytest.approx(5e-4)
    assert survey.median_sigma == pytest.approx(1e-4)


def test_what_the_data_promise_is_said_in_words(session):
    few = ProbingSurvey("a", 9, 2.0, 5, 0, 0.01, 20.0, 19.0, 19)
    assert "next to nothing about Poisson's ratio" in session_outlook(session, [few])
    enough = replace(few, near=20)
    assert "20 measured vectors lie within 8 contact radii" in session_outlook(session, [enough])
    # Two probings count together.
    assert "38 measured vectors" in session_outlook(session, [few, few])
    coarse = replace(enough, elements_per_radius=0.5, signal_to_noise=2.9)
    text = session_outlook(session, [coarse])
    assert "below 3 sigma in 1 of 1 probings (a)" in text
    assert "smaller than an element in 1 probings" in text
    for text in (session_outlook(session, [enough]), session_outlook(session, [few, coarse])):
        assert "No standard deviations are given" not in text
    silent = replace(enough, signal_to_noise=np.nan, tangential_signal=np.nan)
    assert "No standard deviations are given" in session_outlook(session, [silent])


@pytest.mark.parametrize(
    ("vertices", "cost"),
    [(4999, "about 4 minutes and 3.7 GB"), (20_000, "about 18 minutes and 4.1 GB")],
)
def test_what_a_large_mesh_costs_is_said(session, vertices, cost):
    assert size_notes(session) == []
    more = np.concatenate([session.mesh.vertices, np.zeros((vertices - 218, 3))])
    # Vertices that no triangle has are no mesh of any object; only their number is asked for.
    large = replace(session, mesh=TriangleMesh(more, session.mesh.triangles))
    (note,) = size_notes(large)
    assert f"{vertices} vertices: a fit will take {cost}" in note
    assert "palpate mesh --vertices 2000" in note

"""What is said about sessions that are possible but more likely a mistake."""

from pathlib import Path

import numpy as np
import pytest
from surfaces import box

from palpate.geometry import closest_points
from palpate.records import Contact, DisplacementField, Probing, Session
from palpate.records.session_checks import plausibility_notes


def _notes(thickness: float) -> str:
    mesh = box((0.1, thickness, 0.05), (20, 1, 10))
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    points = np.array([[0.05, 0.0, 0.05]])
    place = closest_points(mesh, points)
    field = DisplacementField(points, np.full((1, 3), 1e-4), None, None, place, "")
    contact = Contact(np.array([0.05, 0.0, 0.03]), 0.005, "smooth")
    probing = Probing("n", contact, np.array([0.0, 1.0, 0.0]), None, None, None, field, None)
    session = Session("s", Path(), mesh, held, (probing,), None, None, None, ())
    return " ".join(plausibility_notes(session))


def test_a_plate_too_thin_for_its_triangles_is_noted() -> None:
    """Edges of 5 to 7 mm."""
    text = _notes(0.002)
    assert "2 mm thin" in text
    assert "bending" in text
    # 5.7 mm on average: (5.7 / (1.7 * 2))^2 times as many triangles.
    wanted = float(text.split("about ")[1].split(" vertices")[0])
    assert wanted == pytest.approx(21 * 11 * 2 * (5.7 / 3.4) ** 2, rel=0.2)


def test_a_plate_as_thick_as_its_triangles_is_not() -> None:
    assert "bending" not in _notes(0.005)

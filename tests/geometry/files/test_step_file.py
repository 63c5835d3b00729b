"""STEP files: the unit is their own, and what is drawn becomes a sound surface."""

from pathlib import Path

import numpy as np
import pytest
from drawn_ball import INCH, MILLIMETRE, written_ball

from palpate.errors import MeshError
from palpate.geometry import enclosed_volume, read_mesh

pytest.importorskip("cascadio", reason="needs cascadio, the extra `cad`, which is not installed")


@pytest.mark.parametrize(("unit", "metres"), [(MILLIMETRE, 1e-3), (INCH, 25.4e-3)])
def test_a_drawing_has_its_own_unit(tmp_path: Path, unit: str, metres: float) -> None:
    """Whatever unit is said for files that have none."""
    mesh = read_mesh(written_ball(tmp_path, unit), metres_per_unit=0.01)
    away = np.linalg.norm(mesh.vertices - [10.0 * metres, 0.0, 0.0], axis=1)
    # Vertices lie on the ball, in single precision; chords cut 0.05 % of the edges' length off.
    np.testing.assert_allclose(away, 30.0 * metres, rtol=1e-6)
    volume = 4.0 / 3.0 * np.pi * (30.0 * metres) ** 3
    assert enclosed_volume(mesh) == pytest.approx(volume, rel=2e-3)


@pytest.mark.parametrize(
    ("right", "wrong"),
    [("#16=CLOSED_SHELL", "#96=CLOSED_SHELL"), ("ENDSEC;\nEND-ISO-10303-21;\n", "")],
    ids=["a reference to what is not there", "cut off"],
)
def test_a_damaged_drawing_is_refused(tmp_path: Path, right: str, wrong: str) -> None:
    file = written_ball(tmp_path, MILLIMETRE)
    file.write_text(file.read_text().replace(right, wrong))
    with pytest.raises(MeshError, match="no solid can be read of this STEP file") as caught:
        read_mesh(file)
    assert "export it again" in str(caught.value)

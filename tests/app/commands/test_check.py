"""`palpate check`: the figures it prints, and the refusals of bad sessions."""

import cv2
import numpy as np
import pytest
from flow_samples import SHAPE, rig

from palpate.records import write_rig


def test_figures_of_the_surface_and_the_support_are_printed(palpate, cube_session):
    code, out, err = palpate("check", cube_session)
    assert (code, err) == (0, "")
    assert "a [bold] cube" in out
    for text in ("218, 432", "40 x 40 x 40 mm", "64 cm^3", "96 cm^2", "72 triangles, 16 cm^2"):
        assert text in out
    assert "palpate fit` decides" in out


def test_bad_session_ends_with_two(palpate, cube_session):
    file = cube_session / "session.toml"
    file.write_text(file.read_text().replace("force =", "forse ="))
    code, _, err = palpate("check", cube_session)
    assert code == 2
    assert "unknown key 'forse'; did you mean 'force'" in err
    assert err.count("\n") == 1


def test_shared_beam_promises_no_poisson_ratio(palpate, shared_data):
    """Needs ../shared."""
    code, out, _ = palpate("check", shared_data / "real" / "dragonskin_beam")
    assert code == 0
    assert "outside small deformation" in " ".join(out.split())
    assert "next to nothing about Poisson's ratio" in " ".join(out.split())


def test_a_rigid_motion_is_checked_with_its_cameras_and_pictures(palpate, cube_session):
    rng = np.random.default_rng(1)
    for name in ("a_c0", "a_c1", "b_c0", "b_c1"):
        grey = rng.integers(20, 230, SHAPE, dtype=np.uint8)
        cv2.imwrite(str(cube_session / f"{name}.png"), grey)
    write_rig(cube_session / "rig.toml", rig())
    file = cube_session / "session.toml"
    head = file.read_text().split("[support]")[0]
    steps = [f'[[step]]\nname = "{k}"\nimages = "{k}_{{camera}}.png"\n' for k in "ab"]
    file.write_text(f'{head}[rig]\ncameras = "rig.toml"\n{"".join(steps)}')
    code, out, err = palpate("check", cube_session)
    assert (code, err) == (0, "")
    for text in ("2 cameras", "160 x 120", "2 steps of a rigid motion"):
        assert text in out
    (cube_session / "b_c1.png").unlink()
    code, _, err = palpate("check", cube_session)
    assert code == 2
    assert "step 'b', camera 'c1'" in err


@pytest.mark.parametrize("command", ["check", "fit"])
def test_a_model_that_memory_cannot_hold_is_refused_at_once(
    palpate, cube_session, monkeypatch, command
):
    # 218 vertices need 9 MB beside the program's 0.3 GB.
    monkeypatch.setattr("palpate.bem.system.memory._machine_memory", lambda: 0.34e9)
    code, _, err = palpate(command, cube_session)
    assert code == 2
    assert "mesh.ply: the mesh has 218 vertices" in err
    assert "decimate" in err

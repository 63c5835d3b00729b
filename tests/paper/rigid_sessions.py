"""A session of three instants of a rigid object, 3 mm a step, with its truth."""

import pytest
from flow_samples import sample

from palpate.geometry import write_mesh
from palpate.records import read_session

RIGID_SESSION = """\
format = "palpate-session/1"
[object]
mesh = "mesh.ply"
length_unit = "m"
[rig]
cameras = "rig.toml"
""" + "".join(f'[[step]]\nname = "s{k}"\nimages = "s{k}_{{camera}}.png"\n' for k in range(3))


def step_text(k, travel):
    """A step of truth.toml, by `travel` along x; the encoder begins at 1 mm and has a drift."""
    r = "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]"
    return (
        f'[[step]]\nname = "s{k}"\nR = {r}\nt = [{travel}, 0.0, 0.0]\n'
        f"encoder = [{travel + 1e-3}, 0.0, {0.01 * k}]\n"
    )


@pytest.fixture
def rigid_session(tmp_path):
    """The sample's cube at three instants, and their truth."""
    write_mesh(tmp_path / "mesh.ply", sample().mesh)
    (tmp_path / "rig.toml").write_text("")
    (tmp_path / "session.toml").write_text(RIGID_SESSION)
    (tmp_path / "truth.toml").write_text("".join(step_text(k, 3e-3 * k) for k in range(3)))
    return read_session(tmp_path)

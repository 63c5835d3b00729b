"""Supports that move, grips that are pulled and further loads, as sessions give them."""

import numpy as np
import pytest
from surfaces import box

from palpate.errors import InputError
from palpate.geometry import triangle_areas, write_mesh
from palpate.records import FREE, GIVEN, RIGID, Contact, Load, Support, read_session
from palpate.records.support import RigidMotion

SESSION = """\
format = "palpate-session/1"
[object]
mesh = "mesh.ply"
length_unit = "mm"
[[support]]
plane = { point = [0, 0, 0], normal = [1, 0, 0], tolerance = 0.001 }
motion = "given"
[[support]]
plane = { point = [40, 0, 0], normal = [1, 0, 0], tolerance = 0.001 }
motion = "free"
[[probe]]
name = "pulled"
contact = { support = 2 }
force = [2, 0, 0]
displacement = "n.csv"
support_displacement = "foot.csv"
[[probe]]
name = "inflated"
displacement = "m.csv"
support_motion = { translation = [0.1, 0, 0], rotation = [0, 0, 0.002] }
[[probe.load]]
contact = { triangles = "top.txt" }
pressure = 2000
[[probe.load]]
contact = { point = [20, 5, 0], radius = 3, profile = "smooth" }
force = [0, 0, 0.5]
"""


@pytest.fixture
def session(tmp_path):
    mesh = box(size=(40.0, 10.0, 10.0), cells=(4, 2, 2))
    write_mesh(tmp_path / "mesh.ply", mesh)
    (tmp_path / "session.toml").write_text(SESSION)
    top = np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] > 9.99).all(axis=1))
    (tmp_path / "top.txt").write_text("".join(f"{index}\n" for index in top[::-1]))
    head = "x,y,z,ux,uy,uz\n"
    (tmp_path / "n.csv").write_text(head + "20,0,5,0.1,0,0\n")
    (tmp_path / "m.csv").write_text(head + "20,0,5,0.12,0,0\n")
    (tmp_path / "foot.csv").write_text(head + "0,1,1,0.1,0,0\n0,9,1,0.1,0,0\n0,1,9,0.1,0,0\n")
    return read_session(tmp_path)


def test_supports_and_their_motions(session):
    assert [support.motion for support in session.supports] == [GIVEN, FREE]
    areas = triangle_areas(session.mesh)
    for support in session.supports:
        assert areas[support.triangles].sum() == pytest.approx(1e-4)
    np.testing.assert_array_equal(
        session.held_triangles, np.sort(np.concatenate([s.triangles for s in session.supports]))
    )
    pulled, inflated = session.probings
    np.testing.assert_allclose(pulled.support_displacement.displacement[:, 0], 1e-4)
    np.testing.assert_allclose(inflated.support_motion.translation, [1e-4, 0, 0])
    np.testing.assert_array_equal(inflated.support_motion.rotation, [0, 0, 0.002])


def test_a_force_on_a_support(session):
    contact = session.probings[0].contact
    assert contact.profile == RIGID
    np.testing.assert_array_equal(contact.triangles, session.supports[1].triangles)
    np.testing.assert_allclose(contact.point, [0.04, 0.005, 0.005])


def test_further_loads(session):
    probing = session.probings[1]
    pressure, force = probing.loads
    assert (pressure.pressure, pressure.force) == (2000.0, None)
    # The middle of a top face of 40 x 10 mm.
    np.testing.assert_allclose(pressure.contact.point, [0.02, 0.005, 0.01], atol=1e-12)
    assert triangle_areas(session.mesh)[pressure.contact.triangles].sum() == pytest.approx(4e-4)
    assert force.contact.radius == pytest.approx(3e-3)
    np.testing.assert_array_equal(force.force, [0, 0, 0.5])
    # Without a tool of its own it is at its first load, without force.
    assert probing.contact is pressure.contact
    assert not probing.force.any()


def test_records_refuse_what_cannot_be():
    point, triangle = np.zeros(3), np.array([3])
    with pytest.raises(InputError, match="has no radius"):
        Contact(point, 0.1, "uniform", triangle)
    with pytest.raises(InputError, match="traction is 'hertz'"):
        Contact(point, None, "hertz", triangle)
    with pytest.raises(InputError, match="as the contact and force of the probing"):
        Load(Contact(point, None, RIGID, triangle), np.ones(3))
    with pytest.raises(InputError, match="motion is 'loose'"):
        Support(triangle, "loose")
    with pytest.raises(InputError, match=r"rotation is 0\.06 rad"):
        RigidMotion(point, np.array([0.0, 0.06, 0.0]))

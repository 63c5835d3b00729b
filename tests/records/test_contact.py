"""Contacts and the pressures of tools: their resultants, and a shape that is new."""

import numpy as np
import pytest
from scipy.integrate import quad
from surfaces import hull_mesh

from palpate.errors import InputError, RecordError
from palpate.geometry import write_mesh
from palpate.records import SLIDES, Cone, Contact, ConvexMesh, Sphere, read_session
from palpate.records.contact import PRESSURES, contact_profiles, grid_traction


@pytest.mark.parametrize(
    ("profile", "resultant"), [("smooth", 1 / 6), ("uniform", 1 / 2), ("hertz", 1 / 3)]
)
def test_resultant_of_each_pressure(profile, resultant):
    """The integral of p(s) s ds from 0 to 1, by hand."""
    pressure = PRESSURES[profile]
    integral, _ = quad(lambda s: s * pressure(np.array([s]))[0], 0.0, 1.0)
    # quad's own error; Hertz's square root at the rim costs most of it.
    assert integral == pytest.approx(resultant, rel=1e-8)
    assert pressure(np.zeros(1)) == 1.0
    assert not pressure(np.array([1.0, 1.5, 40.0])).any()
    inside = pressure(np.linspace(0.0, 0.99, 30))
    assert (inside > 0.0).all()
    assert (np.diff(inside) <= 0.0).all()


def test_a_contact_needs_a_radius_unless_it_is_a_vertex():
    point = np.zeros(3)
    assert Contact(point, None, "vertex").radius is None
    assert Contact(point, 1e-9, "hertz").radius == 1e-9
    for radius, profile in (
        (None, "hertz"), (-1.0, "hertz"), (0.0, "uniform"), (1.0, "vertex"), (np.nan, "smooth"),
        (np.inf, "smooth"),
    ):  # fmt: skip
        with pytest.raises(InputError, match="radius is"):
            Contact(point, radius, profile)


def test_an_unknown_profile_is_refused():
    text = "'conical'; must be one of smooth, uniform, hertz, flat, cone, vertex"
    with pytest.raises(InputError, match=text):
        Contact(np.zeros(3), 0.1, "conical")


def test_a_coefficient_of_friction_is_refused_under_a_measured_force():
    with pytest.raises(InputError, match=r"friction is 0.3; .* slides \(0\) or sticks"):
        Contact.under(Sphere(5e-3, friction=0.3), np.zeros(3))


def test_a_new_tool_shape_is_one_line(edited, monkeypatch):
    """A tent is registered: sessions may name it from then on."""
    monkeypatch.setitem(PRESSURES, "tent", lambda s: np.clip(1.0 - s, 0.0, None))
    assert contact_profiles() == ("smooth", "uniform", "hertz", "flat", "cone", "tent", "vertex")
    session = read_session(edited('"smooth"', '"tent"'))
    assert session.probings[0].contact.profile == "tent"


def test_a_tool_is_named_instead_of_a_radius(edited):
    contact = 'radius = 0.006, profile = "smooth"'
    session = read_session(edited(contact, 'tool = "sphere", tool_radius = "8 mm"'))
    contact = session.probings[0].contact
    assert contact.tool == Sphere(8e-3)
    # The search starts small: a cube of 4 cm is 6.9 cm across.
    assert contact.radius == pytest.approx(0.05 * 0.04 * np.sqrt(3.0))


def test_a_cone_has_an_angle(edited):
    contact = 'radius = 0.006, profile = "smooth"'
    cone = 'tool = "cone", tool_radius = "8 mm", tool_angle = "60 deg"'
    contact = read_session(edited(contact, cone)).probings[0].contact
    assert contact.tool is not None
    assert contact.tool.angle == pytest.approx(np.pi / 3)
    assert isinstance(contact.tool, Cone)


def _punch(folder, half=(0.004, 0.002, 0.01)):
    """A bar of these half sides [m], its lower face about the origin, written as a file."""
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    mesh = hull_mesh(np.array(half) * (corners + np.array([0.0, 0.0, 1.0])))
    write_mesh(folder / "punch.stl", mesh)


def test_a_tool_of_any_convex_shape_is_a_mesh_in_a_file(edited):
    tool = 'tool = "mesh", tool_mesh = "punch.stl", tool_rotation = [0, 0, 1.5707963267948966]'
    folder = edited('radius = 0.006, profile = "smooth"', tool)
    _punch(folder)
    contact = read_session(folder).probings[0].contact
    assert contact.tool is not None
    assert isinstance(contact.tool, ConvexMesh)
    assert contact.tool.friction == SLIDES
    assert contact.tool.radius == pytest.approx(0.002)
    # A quarter turn about z: the long side lies along y, the lower face stays.
    for normal, offset in [([0, 1, 0], 0.004), ([1, 0, 0], 0.002), ([0, 0, -1], 0.0)]:
        there = np.abs(contact.tool.faces[:, :3] - normal).max(axis=1) < 1e-6
        assert contact.tool.faces[there, 3] == pytest.approx([offset], abs=1e-9)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('tool = "mesh"', "the key 'tool_mesh' is missing"),
        ('tool = "mesh", tool_mesh = "no.stl"', "no.stl"),
        ('tool = "mesh", tool_mesh = "n.csv", tool_radius = 3', "unknown key 'tool_radius'"),
        ('tool = "cone", tool_radius = 3', "tool_angle: is missing; a tool 'cone' needs it"),
        ('tool = "cone", tool_radius = 3, tool_angle = "5 deg"', "5 degrees; must be from 29"),
        (
            'tool = "flat", tool_radius = 3, tool_angle = "60 deg"',
            "tool_angle: a tool 'flat' has none",
        ),
        ('tool = "ring", tool_radius = 3, tool_inner_radius = 4', "below tool_radius"),
        ('tool = "wedge", tool_radius = 3', "allowed: sphere, flat"),
        ('tool = "sphere"', "tool_radius"),
        ('tool = "sphere", tool_radius = -3', "tool_radius is -3"),
        ('tool = "sphere", tool_radius = "3 inch"', "inch"),
        ('tool = "sphere", tool_radius = 3, friction = "glue"', "allowed: slides, sticks"),
        ('tool = "sphere", tool_radius = 3, radius = 2', "radius"),
    ],
)
def test_bad_tools(edited, text, message):
    with pytest.raises(RecordError, match=message):
        read_session(edited('radius = 0.006, profile = "smooth"', text))


def test_an_average_over_directions_is_that_of_all_directions():
    # A pressure that rises along the first axis is at any distance as large as in the middle.
    middle = (np.arange(60) + 0.5) / 60.0 * 2.0 - 1.0
    slope = np.tile(2.0 + middle[:, None], (1, 60))
    axes = np.array([[0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    shape = grid_traction(axes, 1.0, 0.9, slope, np.zeros_like(slope))
    # It is tabulated at 257 distances.
    np.testing.assert_allclose(shape.mean(np.linspace(0.0, 0.99, 5)), 2.0, rtol=1e-4)
    at_end = shape.at(0.9 * axes[:1])
    np.testing.assert_allclose(at_end, 2.9, rtol=1e-12)

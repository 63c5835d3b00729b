"""Sessions: what a good one becomes, and the message for each kind of bad one."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation
from surfaces import box, joined, sphere

from palpate.errors import InputError, MeshError, RecordError
from palpate.geometry import TriangleMesh, enclosed_volume, triangle_areas, write_mesh
from palpate.records import RATIO, YOUNG, observed_rows, read_session
from palpate.records.files.session import (
    displacement_line,
    import_plan,
    named_displacements,
    with_displacements,
)


def test_a_good_session_is_read_in_si_units(session_folder):
    session = read_session(session_folder)
    assert session.name == "test cube"
    assert session.path == session_folder / "session.toml"
    assert session.notes == ()
    assert triangle_areas(session.mesh)[session.held_triangles].sum() == pytest.approx(0.04**2)
    first, second = session.probings
    assert (first.name, first.contact.profile) == ("n01", "smooth")
    assert first.contact.radius == 0.006
    assert first.force_std.tolist() == [0.012] * 3
    assert first.tip_displacement_std.tolist() == [5e-5] * 3
    assert second.contact.radius is None
    assert second.tip_displacement is None
    assert (~observed_rows(second.displacement)).sum() == 1
    assert session.density == 1000.0
    assert session.gravity is None


def test_a_file_name_is_as_good_as_its_folder(session_folder):
    (session_folder / "session.toml").rename(session_folder / "other.toml")
    assert read_session(session_folder / "other.toml").name == "test cube"
    with pytest.raises(
        RecordError, match=r"no session file session\.toml; it has 'other\.toml': name"
    ):
        read_session(session_folder)


def test_only_the_named_probings_are_read(session_folder):
    (session_folder / "n01.csv").unlink()
    assert [p.name for p in read_session(session_folder, probes=["n02"]).probings] == ["n02"]
    with pytest.raises(RecordError, match="no probing 'n1'; did you mean 'n01'"):
        read_session(session_folder, probes=["n1"])


REGIONS = """
[[region]]
name = "insert"
surface = "insert.ply"
young_modulus = "90 kPa"
young_modulus_std = "5 kPa"
[[region]]
name = "skin"
skin = "2 mm"
[[region]]
name = "patch"
skin = 0.001
faces = { plane = { point = [0, 0, 0.04], normal = [0, 0, 1], tolerance = 1e-6 } }
ratio = 2.0
[[region]]
name = "layer"
plane = { point = [0, 0, 0.01], normal = [0, 0, 2] }
thickness = "4 mm"
[[region]]
name = "box"
box = { min = [0, 0, 0], max = [0.01, 0.02, 0.01] }
"""


def with_regions(folder, text=REGIONS):
    write_mesh(folder / "insert.ply", sphere(2, 0.005))
    file = folder / "session.toml"
    file.write_text(file.read_text() + text)
    return read_session(folder)


def test_regions_are_read_in_si_units(session_folder):
    session = with_regions(session_folder)
    insert, skin, patch, layer, part = session.regions
    assert (insert.known, insert.value, insert.std) == (YOUNG, 9e4, 5e3)
    assert (skin.known, patch.known, patch.value, patch.std) == ("", RATIO, 2.0, 0.0)
    # All that is not held, and the top alone.
    free = len(session.mesh.triangles) - len(session.held_triangles)
    assert len(skin.shape.faces.triangles) == free
    assert skin.shape.thickness == 0.002
    top = triangle_areas(patch.shape.faces).sum()
    assert top == pytest.approx(0.04**2)
    heights = np.array([[0.0, 0.0, z] for z in (0.009, 0.011, 0.013, 0.015)])
    assert layer.shape.contains(heights).tolist() == [False, True, True, False]
    # Of a slab, half the volume over the area is its thickness.
    assert part.shape.thickness == pytest.approx(0.004)
    radius = 0.005
    assert insert.shape.thickness == pytest.approx(2.0 * radius / 3.0, rel=0.05)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('skin = "2 mm"', "", "says where it is by none"),
        ('skin = "2 mm"', 'skin = "2 mm"\nbox = {}', "by box and skin; give one of surface"),
        ('skin = "2 mm"', 'skin = "0 mm"', "skin.*must be positive"),
        ('skin = "2 mm"', 'skin = "2 mm"\nthickness = 1', "thickness.*belongs to plane"),
        ('name = "skin"', 'name = "insert"', "'insert' is that of another region"),
        ("ratio = 2.0", "ratio = 2.0\nshear_modulus = 1e4", "ratio.*is given beside shear_modulus"),
        ("ratio = 2.0", "ratio_std = 2.0", "ratio_std.*is given without ratio"),
        ("ratio = 2.0", "ratio = -2.0", "ratio is -2; must be"),
        ('"90 kPa"', '"90 m"', "young_modulus.*must be a number with its unit"),
        ("max = [0.01, 0.02, 0.01]", "max = [0.01, 0.02, 0]", "box.*has no volume"),
        ("normal = [0, 0, 2]", "normal = [0, 0, 0]", "normal.*is the zero vector"),
        ("point = [0, 0, 0.04], n", "point = [0, 0, 0.09], n", "faces.*has no triangle"),
        ('"insert.ply"', '"inlay.ply"', "inlay.ply"),
    ],
)
def test_a_region_that_cannot_be_says_why(session_folder, old, new, message):
    assert old in REGIONS
    with pytest.raises(RecordError, match=message):
        with_regions(session_folder, REGIONS.replace(old, new, 1))


def test_an_open_insert_is_refused(session_folder):
    with_regions(session_folder)
    ball = sphere(2, 0.005)
    write_mesh(session_folder / "insert.ply", TriangleMesh(ball.vertices, ball.triangles[1:]))
    with pytest.raises(RecordError, match=r"insert\.ply: the surface is open"):
        read_session(session_folder)


def test_every_length_is_converted(edited):
    """The same cube written in millimetres, density and force in SI as ever."""
    metres = read_session(edited('length_unit = "m"', 'length_unit = "m"'))
    folder = edited('length_unit = "m"', 'length_unit = "mm"')
    text = (folder / "session.toml").read_text()
    for old, new in (
        ("[0.02, 0.02, 0.04], radius = 0.006", "[20, 20, 40], radius = 6"),
        ("[0.04, 0.02, 0.03]", "[40, 20, 30]"),
        ("-0.0021", "-2.1"),
        ("5e-5", "5e-2"),
        ("1e-6", "1e-3"),
    ):
        text = text.replace(old, new)
    (folder / "session.toml").write_text(text)
    write_mesh(folder / "mesh.ply", box(size=(40.0, 40.0, 40.0), cells=4))
    for name in ("n01.csv", "n02.csv"):
        table = np.genfromtxt(folder / name, delimiter=",", skip_header=1)
        header = "x,y,z,ux,uy,uz"
        np.savetxt(folder / name, 1000.0 * table, delimiter=",", header=header, comments="")
    millimetres = read_session(folder)
    assert millimetres.notes == ()
    assert np.array_equal(millimetres.held_triangles, metres.held_triangles)
    assert enclosed_volume(millimetres.mesh) == pytest.approx(0.04**3, rel=1e-12)
    for a, b in zip(millimetres.probings, metres.probings, strict=True):
        # Nine digits are in the files.
        np.testing.assert_allclose(a.contact.point, b.contact.point, rtol=1e-12)
        np.testing.assert_allclose(a.displacement.points, b.displacement.points, atol=1e-10)
        np.testing.assert_allclose(
            a.displacement.displacement, b.displacement.displacement, atol=1e-12
        )
    assert millimetres.probings[0].contact.radius == pytest.approx(0.006)
    assert millimetres.probings[0].tip_displacement[2] == pytest.approx(-0.0021)
    assert millimetres.probings[0].tip_displacement_std[0] == pytest.approx(5e-5)
    assert millimetres.probings[0].force.tolist() == [0.0, 0.0, -1.2]
    assert millimetres.probings[0].force_std.tolist() == [0.012] * 3


@pytest.mark.parametrize(("unit", "metres"), [("in", 0.0254), ("cm", 0.01), ("mm", 0.001)])
def test_every_unit_has_its_length(edited, unit, metres):
    # A thousandth of the size bears a millionth of the force.
    edited("force = [0, 0, -1.2]", "force = [0, 0, -1.2e-6]")
    session = read_session(edited('length_unit = "m"', f'length_unit = "{unit}"'))
    assert enclosed_volume(session.mesh) == pytest.approx((0.04 * metres) ** 3, rel=1e-12)
    assert session.probings[0].contact.radius == pytest.approx(0.006 * metres, rel=1e-15)
    assert session.metres_per_unit == metres


# One spoilt piece of session.toml each: what replaces what, and what the message must say.
BAD_TEXT = [
    ('format = "palpate-session/1"', 'format = "palpate-session/2"', r"format: is 'palpate-sess"),
    ('format = "palpate-session/1"', "", "the key 'format' is missing"),
    ('format = "palpate', "format = palpate", "not valid TOML.*line 1"),
    ("length_unit", "lenght_unit", r"\[object\]: unknown key 'lenght_unit'; did you mean 'length_"),
    ('length_unit = "m"', 'length_unit = "mn"', r"\[object\] length_unit: is 'mn'; did you mean"),
    ('length_unit = "m"', "", r"\[object\]: the key 'length_unit' is missing"),
    ("[support]", "[suport]", "unknown key 'suport'; did you mean 'support'"),
    ('mesh = "mesh.ply"', 'mesh = "mash.ply"', r"\[object\] mesh: no such file: .*did you mean 'm"),
    ('mesh = "mesh.ply"', "mesh = 3", r"\[object\] mesh: is 3; must be a text"),
    ("density = 1000.0", "density = -1", "density is -1.0; must be positive"),
    ("density = 1000.0", "density = nan", "density: is nan; must be a finite number"),
    ("density = 1000.0", "density = true", "density: is True; must be a finite number"),
    ("normal = [0, 0, 2]", "normal = [0, 0, 0]", r"\[support\] plane normal: is the zero vector"),
    ("normal = [0, 0, 2]", "normal = [0, 0]", r"normal: is \[0, 0\]; must be three finite numbers"),
    ("tolerance = 1e-6", "tolerance = -1", r"tolerance: is -1.0; must not be negative"),
    ("tolerance = 1e-6", "tolerence = 1e-6", "did you mean 'tolerance'"),
    ("force = [0, 0, -1.2]", "force = [0, 0, 0]", r"\[\[probe\]\] 'n01': force is zero"),
    ("force = [0, 0, -1.2]", "force = 1.2", r"'n01' force: is 1.2; must be three finite numbers"),
    ("force = [0, 0, -1.2]", "", r"\[\[probe\]\] 'n01': the key 'force' is missing"),
    (
        "force_std = 0.012",
        "force_std = -0.1",
        r"'n01': force_std is \[-0.1, .*; must not be neg",
    ),
    ("force_std = 0.012", 'force_std = "1 %"', "force_std: is '1 %'; must be a finite number, or"),
    (
        "tip_displacement_std = 5e-5",
        "tip_displacement_std = 0",
        "tip_displacement_std is .*; must be positive",
    ),
    ("tip_displacement = [0, 0, -0.0021]", "", "is given without tip_displacement"),
    ("radius = 0.006, ", "", "'n01': radius is missing; profile 'smooth' needs one"),
    ("radius = 0.006", "radius = 0", "'n01': radius is 0.0; must be a positive length"),
    ('"smooth"', '"smoth"', "'n01' contact profile: is 'smoth'; did you mean 'smooth'"),
    ('profile = "vertex"', 'profile = "vertex", radius = 1', "'n02': radius is 1.0 with profile"),
    (
        'name = "n02"',
        'name = "n01"',
        "probing 'n01': there are files named 'n01' already",
    ),
    ('name = "n02"', "", r"\[\[probe\]\] number 2: the key 'name' is missing"),
    ('"n01.csv"', '"n03.csv"', "'n01' displacement: no such file: .*did you mean 'n0"),
    ('displacement = "n02.csv"', "", "'n02' displacement: the key is missing: give the measured"),
    ("[0.02, 0.02, 0.04]", "[0.02, 0.02, 0.05]", "contact misses the surface: its point is 0.01 m"),
    ("[0.04, 0.02, 0.03]", "[0.09, 0.02, 0.03]", "misses the surface: .* three mean edge lengths"),
    ("[0.02, 0.02, 0.04]", "[0.0, 0.02, 0.004]", "partly on the support: its point is 0.004 m"),
    ("[0.04, 0.02, 0.03]", "[0.04, 0.02, 0.0]", "partly on the support: the nearest vertex"),
    ("[[probe]]", "[gravity]\nacceleration = [0, 0]\n[[probe]]", "acceleration: is .*three finite"),
    ("[[probe]]", '[rig]\ncameras = "rig.toml"\n[[probe]]', r"\[rig\] cameras: no such file"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD_TEXT)
def test_a_bad_session_file_is_told_where_and_what(edited, old, new, message):
    folder = edited(old, new)
    with pytest.raises(RecordError, match=message) as caught:
        read_session(folder)
    assert str(caught.value).startswith(str(folder / "session.toml"))


def test_far_side_of_a_thin_object_is_no_contact(session_folder):
    """A sheet of 4 mm held below, pressed above with a radius of 6 mm."""
    write_mesh(session_folder / "mesh.ply", box(size=(0.04, 0.04, 0.004), cells=8))
    text = (session_folder / "session.toml").read_text().replace("0.02, 0.04]", "0.02, 0.004]")
    (session_folder / "session.toml").write_text(text)
    (session_folder / "n01.csv").write_text("x,y,z,ux,uy,uz\n0.02,0.01,0.004,0,0,-1e-4\n")
    assert len(read_session(session_folder, probes=["n01"]).probings) == 1


def test_gravity_at_rest_is_not_a_load_of_the_push(edited):
    edited("[[probe]]", "[gravity]\nacceleration = [0, 0, -9.81]\nat_rest = true\n[[probe]]")
    session = read_session(edited("n01", "n01"))
    assert session.added_gravity is None
    assert session.gravity.tolist() == [0.0, 0.0, -9.81]
    with pytest.raises(RecordError, match="at_rest: is 1; must be true or false"):
        read_session(edited("at_rest = true", "at_rest = 1"))


def test_gravity_needs_a_density(edited):
    edited("[[probe]]", "[gravity]\nacceleration = [0, 0, -9.81]\n[[probe]]")
    assert read_session(edited("n01", "n01")).gravity.tolist() == [0.0, 0.0, -9.81]
    with pytest.raises(RecordError, match="gravity is given without a density; give it in kg"):
        read_session(edited("density = 1000.0", ""))


def test_a_radius_may_have_a_unit(edited):
    session = read_session(edited("radius = 0.006", 'radius = "6 mm"'))
    assert session.probings[0].contact.radius == pytest.approx(0.006, rel=1e-12)
    with pytest.raises(RecordError, match="contact radius: is '6 feet'; must be a number with its"):
        read_session(edited('radius = "6 mm"', 'radius = "6 feet"'))


def test_a_session_of_nothing_is_refused(session_folder):
    file = session_folder / "session.toml"
    file.write_text(file.read_text().partition("[[probe]]")[0])
    with pytest.raises(RecordError, match=r"toml: the session has no probings"):
        read_session(session_folder)


# ---------------------------------------------------------------- the support


def _support(edited, text):
    return edited("plane = { point = [0, 0, 0], normal = [0, 0, 2], tolerance = 1e-6 }", text)


def test_selectors_are_united(edited):
    folder = _support(
        edited,
        "plane = [{ point = [0, 0, 0], normal = [0, 0, -3], tolerance = 1e-6 }]\n"
        "box = { min = [-1, -1, -1], max = [0.041, 0.0001, 0.011] }\n"
        'triangles = "support.txt"',
    )
    (folder / "support.txt").write_text("# the last one\n191\n\n191 # again\n")
    session = read_session(folder, probes=["n01"])
    # Floor, one row of the four cells high side y = 0, and the listed triangle.
    area = 0.04**2 + 0.04 * 0.01 + triangle_areas(session.mesh)[191]
    assert triangle_areas(session.mesh)[session.held_triangles].sum() == pytest.approx(area)


def test_empty_support_tells_how_far_the_plane_is(edited):
    folder = edited("plane = { point = [0, 0, 0]", "plane = { point = [0, 0, -0.003]")
    with pytest.raises(RecordError, match=r"support is empty: .* plane is 0\.003 m off"):
        read_session(folder)
    with pytest.raises(RecordError, match=r"\[support\]: is empty; give at least one of"):
        read_session(
            edited("plane = { point = [0, 0, -0.003], normal = [0, 0, 2], tolerance = 1e-6 }", "")
        )


def test_tolerance_of_a_plane_is_in_the_unit_of_lengths(edited):
    edited('length_unit = "m"', 'length_unit = "cm"')
    folder = edited(
        "[0, 0, 0], normal = [0, 0, 2], tolerance = 1e-6",
        "[0, 0, -0.003], normal = [0, 0, 2], tolerance = 0.002",
    )
    # 0.003 cm off, 0.002 cm allowed.
    with pytest.raises(RecordError, match=r"plane is 3e-05 m off, its tolerance is 2e-05 m"):
        read_session(folder)
    assert len(read_session(edited("tolerance = 0.002", "tolerance = 0.004")).held_triangles) == 32


def test_stiffness_of_a_bed_under_the_support(edited):
    folder = edited("[support]", '[support]\nstiffness = "2 kPa/mm"')
    session = read_session(folder)
    assert session.supports[0].stiffness == pytest.approx(2e6, rel=1e-12)
    assert session.supports[0].compliance == pytest.approx(5e-7, rel=1e-12)
    assert not any("would sink" in note for note in session.notes)
    # 1.2 N over 16 cm^2 on a thousandth of that: 0.38 m, where nothing moved more than 2 mm.
    session = read_session(edited('"2 kPa/mm"', "2e3"))
    assert any("would sink 0.375 m into support 1" in note for note in session.notes)
    assert read_session(edited("stiffness = 2e3", "")).supports[0].stiffness is None


def test_bad_selectors_are_refused(edited):
    folder = _support(edited, "box = { min = [1, 0, 0], max = [0, 1, 1] }")
    with pytest.raises(RecordError, match="min: exceeds max"):
        read_session(folder)
    edited("box = { min = [1, 0, 0], max = [0, 1, 1] }", 'triangles = "support.txt"')
    with pytest.raises(RecordError, match="triangles: no such file"):
        read_session(folder)
    for word in ("192", "-1", "2.5", "two"):
        (folder / "support.txt").write_text(f"0\n{word}\n")
        with pytest.raises(RecordError, match=rf"line 2: '{word}' is not a triangle.* 0 to 191"):
            read_session(folder)
    edited('triangles = "support.txt"', "plane = 3")
    with pytest.raises(RecordError, match="plane: is 3; must be a table or a list of tables"):
        read_session(folder)


# ---------------------------------------------------------------- the mesh


def test_mesh_failures_name_the_file(session_folder):
    cube = box(size=(0.04, 0.04, 0.04), cells=4)
    far = sphere(1, radius=0.01)
    for bad, message in (
        (TriangleMesh(cube.vertices, cube.triangles[1:]), "the surface is open"),
        (joined(cube, TriangleMesh(far.vertices + 1.0, far.triangles)), "2 separate components"),
        (
            TriangleMesh(cube.vertices, np.concatenate([cube.triangles, cube.triangles[:1]])),
            "share all three vertices",
        ),
    ):
        write_mesh(session_folder / "mesh.ply", bad)
        with pytest.raises(MeshError, match=rf"mesh\.ply: .*{message}"):
            read_session(session_folder)


def test_inward_mesh_is_turned_and_said(session_folder):
    cube = box(size=(0.04, 0.04, 0.04), cells=4)
    write_mesh(session_folder / "mesh.ply", TriangleMesh(cube.vertices, cube.triangles[:, ::-1]))
    session = read_session(session_folder)
    assert enclosed_volume(session.mesh) > 0.0
    assert session.notes == (
        "mesh.ply: All triangles of the mesh faced inward; they were turned outward.",
    )


# ---------------------------------------------------------------- observed points, plausibility


def test_points_all_on_the_support_are_refused(session_folder):
    (session_folder / "n01.csv").write_text(
        "x,y,z,ux,uy,uz\n0.01,0.01,0,0,0,1e-4\n0.02,0.01,0,0,0,1e-4\n0.02,0.02,0.04,nan,0,0\n"
    )
    with pytest.raises(RecordError, match=r"'n01': all 2 measured points of .* on the support"):
        read_session(session_folder)


def test_one_free_point_suffices(session_folder):
    (session_folder / "n01.csv").write_text(
        "x,y,z,ux,uy,uz\n0.01,0.01,0,0,0,0\n0.02,0.01,0.04,0,0,-1e-3\n"
    )
    assert len(read_session(session_folder).probings[0].displacement.points) == 2


def test_mesh_in_millimetres_declared_metres_is_noted(session_folder):
    """Mesh and points 1000 times too large, displacements in metres."""
    text = (session_folder / "session.toml").read_text()
    text = text.replace("[0.02, 0.02, 0.04], radius = 0.006", "[20, 20, 40], radius = 6")
    text = text.replace("[0.04, 0.02, 0.03]", "[40, 20, 30]")
    (session_folder / "session.toml").write_text(text)
    write_mesh(session_folder / "mesh.ply", box(size=(40.0, 40.0, 40.0), cells=4))
    for name, x in (("n01.csv", 20), ("n02.csv", 25)):
        (session_folder / name).write_text(f"x,y,z,ux,uy,uz\n{x},10,40,0,0,-1e-4\n")
    with pytest.raises(RecordError, match="of a body too soft for its weight"):
        read_session(session_folder)
    # With a force that could be, the size is still doubted.
    (session_folder / "session.toml").write_text(
        text.replace("-1.2]", "-1e5]").replace("-1, 0, 0", "-1e5, 0, 0")
    )
    notes = read_session(session_folder).notes
    assert "69.3 m across, an implausible size: is the mesh in another unit" in notes[0]
    assert any("n02: the largest displacement of 0.0001 m is implausibly small" in n for n in notes)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("force = [0, 0, -1.2]", "force = [0, 0, 1.2]", "the tool pulls"),
        ("[0, 0, -0.0021]", "[0, 0, 0.0021]", "the tip moved against the force"),
        ("[0, 0, -0.0021]", "[0, 0, -0.009]", "13 % of the object's size, outside small"),
        ("[0, 0, -0.0021]", "[0, 0, -0.04]", "implausibly large"),
        ("force = [0, 0, -1.2]", "force = [0, 0, -2e-3]", "of about 58 Pa, softer"),
        ("force_std = 0.012", "force_std = 12", "force_std exceeds the force"),
        ("radius = 0.006", "radius = 0.00003", "contact radius of 3e-05 m is implausible"),
    ],
)
def test_likely_mistakes_are_noted(edited, old, new, message):
    notes = read_session(edited(old, new)).notes
    assert any("Probing n01" in note and message in note for note in notes)


def test_what_a_gauge_of_one_axis_does_not_see_is_no_mistake(edited):
    notes = read_session(edited("force_std = 0.012", "force_std = [10, 10, 0.012]")).notes
    assert not any("force_std" in note for note in notes)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[0, 0, -0.0021]", "[0, 0, -0.1]", "more than the body of 0.0693 m across"),
        # A cube of 40 mm that 1e12 N press by 2 mm: F / (s d) = 1e16 Pa.
        (
            "force = [0, 0, -1.2]",
            "force = [0, 0, -1e12]",
            r"of 2\.6e\+06 GPa or more, stiffer than",
        ),
        (
            "force = [0, 0, -1.2]",
            "force = [0, 0, -1e-6]",
            r"of 0\.\d+ Pa or less, of a body too soft",
        ),
        # 1 MN over a circle of 6 mm.
        (
            "force = [0, 0, -1.2]",
            "force = [0, 0, -1e6]",
            r"a pressure of 8\.8 GPa at the contact, more than .* about 29 GPa",
        ),
        ("radius = 0.006", "radius = 0.036", "the contact is wider than the body"),
    ],
)
def test_what_no_body_does_is_refused(edited, old, new, message):
    with pytest.raises(RecordError, match=f"'n01': .*{message}"):
        read_session(edited(old, new))


@pytest.mark.parametrize("shared", [True, False])
def test_one_measurement_for_two_probings_is_refused(edited, shared):
    folder = edited('"n02.csv"', '"n01.csv"') if shared else edited("n02", "n02")
    if not shared:
        (folder / "n02.csv").write_bytes((folder / "n01.csv").read_bytes())
    with pytest.raises(
        RecordError, match=r"probing 'n02' have the same displacement, .* in probing 'n01'"
    ):
        read_session(folder)
    assert len(read_session(folder, probes=["n02"]).probings) == 1


def test_shared_sessions_are_read(shared_data):
    """Needs ../shared."""
    noisy = read_session(shared_data / "halfball_probes")
    assert len(noisy.probings) == 17
    assert noisy.notes == ()
    field = noisy.probings[0].displacement
    assert (~observed_rows(field)).sum() == 75
    # Points are vertices of the mesh; the CSV has nine digits of 40 mm.
    assert field.surface.distance.max() < 1e-9
    beam = read_session(shared_data / "real" / "dragonskin_beam")
    assert beam.probings[0].name == "load52_a"
    assert any("outside small deformation" in note for note in beam.notes)


def test_a_turn_that_may_be_bending_is_a_note(session_folder):
    file = session_folder / "n01.csv"
    rows = np.genfromtxt(file, delimiter=",", skip_header=1)
    turn = Rotation.from_rotvec(np.radians([0.0, 20.0, 0.0])).as_matrix()
    rows[:, 3:6] = rows[:, :3] @ turn.T - rows[:, :3]
    head = file.read_text().splitlines()[0]
    np.savetxt(file, rows, delimiter=",", header=head, comments="")
    notes = " ".join(read_session(session_folder).notes)
    assert "Probing n01: the measured points turned by 20 degrees as a whole" in notes


def test_what_is_too_large_is_refused_before_the_surface_is_checked(session_folder):
    mesh = box(size=(0.04, 0.04, 0.04), cells=4)
    # An open surface: the checks, which take long, would complain first.
    write_mesh(session_folder / "mesh.ply", TriangleMesh(mesh.vertices, mesh.triangles[:-1]))

    def allow(vertices, probings):
        raise InputError(f"{vertices} vertices and {probings} probings are too many")

    with pytest.raises(RecordError, match=r"mesh\.ply: 98 vertices and 2 probings are too many"):
        read_session(session_folder, allow=allow)
    with pytest.raises(MeshError, match="open"):
        read_session(session_folder)


def test_the_arm_s_first_touch_is_an_error_of_the_tip(edited):
    """3, 4 and 12 make 13."""
    text = "tip_displacement = [0, 0, -0.001]\ntip_displacement_std = [3e-5, 12e-5, 0.0]"
    text += '\ntip_displacement_offset_std = "0.04 mm"\ncontact = { point = [0.04'
    session = read_session(edited("contact = { point = [0.04", text))
    std = [
        probing.tip_displacement_std
        for probing in session.probings
        if probing.tip_displacement is not None
    ]
    np.testing.assert_allclose(std[-1], [5e-5, np.hypot(12e-5, 4e-5), 4e-5])


@pytest.fixture
def bare(session_folder: Path) -> Path:
    """The session with neither displacement file named."""
    file = session_folder / "session.toml"
    text = file.read_text()
    file.write_text(
        text.replace('displacement = "n01.csv"\n', "").replace('"n02.csv"', '"old.csv"')
    )
    return session_folder


def test_a_session_without_its_observations(bare):
    session = read_session(bare, observations=False)
    assert [(p.name, p.displacement, p.images) for p in session.probings] == [
        ("n01", None, None),
        ("n02", None, None),
    ]
    assert session.probings[0].force.tolist() == [0.0, 0.0, -1.2]
    assert named_displacements(session.path) == {"n02": "old.csv"}


def test_pictures_without_a_rig_do_not_matter_where_nothing_is_observed(bare):
    file = bare / "session.toml"
    images = 'images = { rest = "r_{camera}.png", loaded = ["a_{camera}.png"] }\n'
    file.write_text(file.read_text().replace("force_std = 0.012\n", images))
    assert read_session(bare, observations=False).probings[0].images is None
    file.write_text(file.read_text().replace('displacement = "old.csv"', images))
    with pytest.raises(RecordError, match="probing 'n01' has images, but no rig is given"):
        read_session(bare)


def _plan(folder, files, probes=None, frames=None):
    session = read_session(folder, observations=False)
    plan = import_plan(session, [Path(file) for file in files], probes=probes, frames=frames)
    return [(str(item.file), item.probe, item.frame) for item in plan]


def test_plan(bare):
    by_name = [("a/n02.csv", "n02", None), ("n01.txt", "n01", None)]
    assert _plan(bare, ["a/n02.csv", "n01.txt"]) == by_name
    assert _plan(bare, ["x.csv", "y.csv"], ["n02", "n01"]) == [
        ("x.csv", "n02", None),
        ("y.csv", "n01", None),
    ]
    assert _plan(bare, ["x.e", "y.e"], ["n02", "n01"], [7]) == [
        ("x.e", "n02", 7),
        ("y.e", "n01", 7),
    ]
    assert _plan(bare, ["x.e"], ["n02", "n01"], [1, 2]) == [("x.e", "n02", 1), ("x.e", "n01", 2)]
    assert _plan(bare, ["x.e"], ["n02"], [1]) == [("x.e", "n02", 1)]


def test_plan_of_the_only_probing(bare):
    file = bare / "session.toml"
    text = file.read_text()
    file.write_text(text[: text.rindex("[[probe]]")])
    assert _plan(bare, ["B0001.csv"]) == [("B0001.csv", "n01", None)]


@pytest.mark.parametrize(
    ("files", "probes", "frames", "message"),
    [
        (["B1.csv"], None, None, r"named 'B1' \(there are: n01, n02\).*e.g. --probe n01"),
        (["x.csv"], ["n03"], None, r"no probing 'n03'; did you mean 'n02'|'n01'"),
        (["x.csv", "y.csv"], ["n01"], None, "names 1 probings for 2 files"),
        (["x.csv"], ["n01", "n02"], None, "names 2 probings for 1 files.*one --frame for each"),
        (["x.csv", "y.csv"], ["n01", "n01"], None, "two results are given for the probing 'n01'"),
        (["x.csv"], ["n01"], [1, 2], "gives 2 numbers for 1 probings"),
    ],
)
def test_plan_refusals(bare, files, probes, frames, message):
    with pytest.raises(RecordError, match=message):
        _plan(bare, files, probes, frames)


HAND_MADE = """\
# My session
name = "x"   # a name

[[probe]]  # first
name = "n01"
force = [0, 0,
         -1]     # N

# second one:
[[probe]]
displacement = 'old.csv'   # by hand
name = "n02"
[probe.contact]
point = [1, 2, 3]

[[probe]]
name = "n03"
"""


def test_only_one_line_changes():
    changed = with_displacements(HAND_MADE, {"n01": "n01.csv"})
    expected = HAND_MADE.replace("-1]     # N\n", '-1]     # N\ndisplacement = "n01.csv"\n')
    assert changed == expected


def test_a_value_is_exchanged_and_its_comment_stays():
    changed = with_displacements(HAND_MADE, {"n02": "new.csv"})
    assert changed == HAND_MADE.replace("'old.csv'   # by", '"new.csv"   # by')


def test_several_and_the_last_line_without_an_end():
    text = HAND_MADE.rstrip("\n")
    changed = with_displacements(text, {"n03": "c.csv", "n01": "a.csv"})
    assert changed.endswith('name = "n03"\ndisplacement = "c.csv"\n')
    probes = tomllib.loads(changed)["probe"]
    assert [probe.get("displacement") for probe in probes] == ["a.csv", "old.csv", "c.csv"]


def test_line_ends_of_windows_stay():
    changed = with_displacements(HAND_MADE.replace("\n", "\r\n"), {"n01": "a.csv", "n02": "b.csv"})
    assert changed.replace("\r\n", "").count("\n") == 0
    assert changed.count("\r\n") == HAND_MADE.count("\n") + 1


def test_one_table_alone():
    text = '[probe]\nname = "n01"\n'
    assert with_displacements(text, {"n01": "a"}) == text + 'displacement = "a"\n'


def test_names_with_quotes():
    assert displacement_line('a"b.csv') == 'displacement = "a\\"b.csv"'


@pytest.mark.parametrize(
    "text",
    [
        'probe = [{ name = "n01", force = [0, 0, 1] }]\n',
        'probe = [{ name = "n00" }, { displacement = "old.csv", name = "n01" }] # two\n',
        '[[probe]]\nname = "n01"\nnotes = """\n[[probe]]\n"""\n[[probe]]\nname = "n02"\n',
        '[[probe]]\nname = "n01"\ndisplacement = """old.csv"""\n',
        '[["probe"]]\nname = "n01"\nimages.rest = "a"\n\n[rig]\n',
        '[[probe]]\ncontact.radius = 1\nname = "n01"\n# end\n[probe.more]\nx = 1\n[[step]]\n',
    ],
)
def test_only_the_named_key_changes_however_the_tables_are_written(text):
    before = tomllib.loads(text)
    name = before["probe"][-1]["name"]
    changed = tomllib.loads(with_displacements(text, {name: 'a"b.csv'}))
    before["probe"][-1]["displacement"] = 'a"b.csv'
    assert changed == before


@settings(max_examples=40, deadline=None)
@given(
    extra=st.lists(
        st.sampled_from(["", "# note", "force_std = 1", "tip = [1,\n  2] # N", "x.y = 'z'"]),
        unique=True,
    ),
    name=st.text(st.characters(exclude_categories=["C"]), min_size=1),
    ending=st.sampled_from(["\n", "\r\n"]),
)
def test_one_line_is_added_to_any_table_and_no_other_changes(extra, name, ending):
    text = "\n".join(["[[probe]]", 'name = "n01"', *extra, "[rig] # the end", "a = 1", ""])
    text = text.replace("\n", ending)
    before = text.split(ending)
    after = with_displacements(text, {"n01": name}).split(ending)
    added = [i for i, line in enumerate(after) if line.startswith("displacement")]
    assert [line for i, line in enumerate(after) if i not in added] == before
    assert tomllib.loads(after[added[0]]) == {"displacement": name}


def test_the_session_reads_as_before(bare):
    path = bare / "session.toml"
    path.write_text(with_displacements(path.read_text(), {"n01": "n01.csv", "n02": "n02.csv"}))
    session = read_session(bare)
    assert [probing.displacement is not None for probing in session.probings] == [True, True]

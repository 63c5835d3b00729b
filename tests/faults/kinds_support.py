"""Kinds of broken supports, grips and loads."""

from pathlib import Path

from faults.kind import Kind, replaced, written

_GIVEN = 'support_displacement = "foot.csv"'
_PULLED = "contact = { support = 2 }"
_CHECK = ("check", ".")


def _kind(name: str, damage, *says: str, command: tuple[str, ...] = _CHECK) -> Kind:
    return Kind(name, damage, command, ("session.toml", *says), example="tension")


def _edited(old: str, new: str):
    return replaced("session.toml", old, new)


def _with_load(load: str):
    return _edited(_GIVEN, f"{_GIVEN}\n[[probe.load]]\n{load}")


def _with_regions(*regions: str):
    def damage(folder: Path) -> None:
        with (folder / "session.toml").open("a") as file:
            file.writelines(f"\n[[region]]\n{region}\n" for region in regions)

    return damage


def _region(name: str, regions: tuple[str, ...], *says: str, command: tuple[str, ...] = _CHECK):
    return Kind(name, _with_regions(*regions), command, ("session.toml", *says))


def _open_inside(folder: Path) -> None:
    """Damage: a region within three faces of a tetrahedron."""
    corners = "v 0.01 0.01 0.01\nv 0.02 0.01 0.01\nv 0.01 0.02 0.01\nv 0.01 0.01 0.02\n"
    (folder / "in.obj").write_text(corners + "f 1 3 2\nf 1 2 4\nf 1 4 3\n")
    _with_regions('name = "in"\nsurface = "in.obj"')(folder)


_INSERT = 'name = "insert"\nbox = { min = [0.01, 0.01, 0.02], max = [0.02, 0.02, 0.03] }'
# Elements are counted by the thickness of the part, so they would not be too many for this one.
_LEAF = 'name = "leaf"\nbox = { min = [0, 0, 0.02], max = [0.04, 0.04, 0.020001] }'
_LEAVES = [
    f'name = "{k}"\nbox = {{ min = [0, 0, {k}e-4], max = [0.04, 0.04, {k + 1}e-4] }}'
    for k in range(99)
]
_FILM = 'name = "film"\nplane = { point = [0, 0, 0.03], normal = [0, 0, 1] }\nthickness = "10 um"'
REGIONS = [
    _region("a region elsewhere",
            ('name = "far"\nbox = { min = [1, 0, 0], max = [1.01, 0.01, 0.01] }',),
            "'far' is outside the object", "length_unit"),
    _region("two regions in one place", (_INSERT, _INSERT.replace('"insert"', '"other"')),
            "100 % of region 'other' lie in region 'insert'"),
    _region("a region thinner than elements can be", (_FILM,), "'film'", "mm thick", "elements"),
    _region("a slice, by what is around it",
            ('name = "slice"\nbox = { min = [0, 0, 0.02], max = [0.04, 0.04, 0.0205] }',),
            "'slice'", "elements there and around", "or thicker"),
    _region("a region as thin as a leaf", (_LEAF,), "'leaf', which is 0.001 mm thick", "thicker ones"),
    _region("as many regions as a book has leaves", tuple(_LEAVES), "0.1 mm thick", "fewer regions"),
    _region("a region that is not said", ('name = "insert"',), "[[region]]", "surface", "skin"),
    _region("two regions of one name", (_INSERT, _INSERT), "'insert' is that of another region"),
    _region("a region with a name as long as a page", (_INSERT.replace("insert", 3000 * "n"),),
            "[[region]]", "has 3000 characters", "200"),
    _region("regions that are the whole object", ('name = "all"\nsurface = "mesh.ply"',),
            "the regions fill the whole object", "leave one of them out"),
    _region("a skin of less than nothing", ('name = "skin"\nskin = "-1 mm"',), "skin: is -0.001 m"),
    _region("a skin within a box", ('name = "skin"\nskin = "5 mm"', _INSERT.replace("0.01", "0.0")),
            "of region 'insert' lie in region 'skin'"),
    Kind("a region within an open surface", _open_inside, _CHECK,
         ("session.toml: [[region]] number 1: in.obj: the surface is open",)),
    _region("regions of a single push", (_INSERT,), "takes pushes at several places", command=("fit", ".")),
    _region("regions at finite strain", (_INSERT,), "--strain small",
            command=("fit", ".", "--strain", "finite")),
    _region("a field at finite strain", (), "--strain small",
            command=("fit", ".", "--strain", "finite", "--material", "field")),
]  # fmt: skip

KINDS = [
    *REGIONS,
    _kind("a motion misspelt", _edited('"free"', '"fre"'), "motion", "did you mean 'free'"),
    _kind("a motion that is a number", _edited('"free"', "3"), "[[support]] number 2", "motion"),
    _kind("a stiffness of zero", _edited('motion = "free"', 'motion = "free"\nstiffness = 0'),
          "[[support]] number 2", "stiffness is 0", "leave it out"),
    _kind("a stiffness below zero", _edited('motion = "free"', 'motion = "free"\nstiffness = -1e7'),
          "stiffness is -1e+07"),
    _kind("a stiffness without end", _edited('motion = "free"', 'motion = "free"\nstiffness = inf'),
          "stiffness", "inf"),
    _kind("a stiffness of a spring, not of a bed of them",
          _edited('motion = "free"', 'motion = "free"\nstiffness = "1e4 N/m"'), "stiffness", "N/m^3"),
    _kind("a stiffness in words", _edited('motion = "free"', 'motion = "free"\nstiffness = "rigid"'),
          "stiffness", "N/m^3"),
    _kind("a compliance in newtons",
          _edited("[object]", '[errors]\nsupport_compliance = "1 N/m"\n[object]'),
          "[errors]", "support_compliance", "mm/MPa"),
    _kind("a compliance below zero",
          _edited("[object]", "[errors]\nsupport_compliance = -1e-9\n[object]"),
          "[errors]", "support compliance", "-1e-09"),
    _kind("supports that are a text", _edited("[[support]]", "support2 = 1\n[[support]]"), "support2"),
    _kind(
        "a motion is to be given and is not",
        _edited(_GIVEN, ""),
        "'n01'", "support 1", "support_displacement",
    ),
    _kind(
        "a motion is given that no support asks for",
        _edited('motion = "given"', 'motion = "fixed"'),
        "'n01'", 'motion = "given"',
    ),
    _kind(
        "a motion given twice",
        _edited(_GIVEN, _GIVEN + "\nsupport_motion = { translation = [0, 0, 0] }"),
        "'n01'", "support_motion",
    ),
    _kind(
        "a motion without translation",
        _edited(_GIVEN, "support_motion = { rotation = [0, 0, 0] }"),
        "support_motion", "translation",
    ),
    _kind(
        "a turn in degrees",
        _edited(_GIVEN, "support_motion = { translation = [0, 0, 0], rotation = [0, 0, 2.0] }"),
        "support_motion", "rad",
    ),
    _kind(
        "a turn of two numbers",
        _edited(_GIVEN, "support_motion = { translation = [0, 0, 0], rotation = [0, 1] }"),
        "rotation", "three",
    ),
    _kind("the motion's file is missing", _edited('"foot.csv"', '"foots.csv"'), "foots.csv", "foot.csv"),
    _kind("a force on a support that is not there", _edited(_PULLED, "contact = { support = 3 }"),
          "support", "1 to 2"),
    _kind("a force on half a support", _edited(_PULLED, "contact = { support = 1.5 }"), "support"),
    _kind(
        "a force on a support whose motion is given",
        _edited(_PULLED, "contact = { support = 1 }"),
        "support 1", "'given'", "free",
    ),
    _kind(
        "a force on a support with a radius",
        _edited(_PULLED, "contact = { support = 2, radius = 0.1 }"),
        "radius",
    ),
    _kind(
        "a force on the only support",
        _edited(
            'motion = "given"\n[[support]]\n'
            "plane = { point = [0.04, 0, 0], normal = [1, 0, 0], tolerance = 1e-6 }\n",
            "",
        ),
        "support",
    ),
    _kind(
        "supports that touch",
        _edited("[0.04, 0, 0], normal = [1, 0, 0]", "[0, 0, 0], normal = [0, 1, 0]"),
        "supports 1 and 2 share",
    ),
    *(
        _kind(f"directions {value}", _edited('motion = "given"', f"directions = {value}"), "[[support]] number 1", *says)
        for value, says in {
            "3": ("list of vectors",),
            "[0, 0, 1]": ("two pairs of brackets",),
            "[[0, 0]]": ("three finite numbers",),
            "[[0, 0, 0]]": ("zero",),
            "[]": ("no direction",),
            "[[0, 0, 1], [0, 0, -2]]": ("twice",),
            "[[0, 0, 1], [0, 1, 0], [1, 0, 0], [1, 1, 1]]": ("follows from the others",),
            "[[0, 0, nan]]": ("three finite numbers",),
            '"z"': ("list of vectors",),
        }.items()
    ),
    _kind("a force across a roller", _edited('"free"', '"free"\ndirections = [[0, 1, 0]]'), "roller", "across its directions"),
    _kind("a triangle in two supports",
          _edited("[0.04, 0, 0], normal = [1, 0, 0]", "[0, 0, 0], normal = [1, 0, 0]"), "supports 1 and 2 share 8 triangles"),
    _kind("gravity with a pulled support",
          _edited("[[probe]]", "[gravity]\nacceleration = [0, 0, -9.81]\n[[probe]]"), "density"),
    _kind("tip displacement of a support",
          _edited(_GIVEN, _GIVEN + "\ntip_displacement = [0, 0, 0.001]"), "tip_displacement"),
    _kind("a load of nothing", _with_load('contact = { triangles = "side.txt" }'), "load 1", "force"),
    _kind(
        "a load of force and pressure",
        _with_load('contact = { triangles = "side.txt" }\npressure = 3.0\nforce = [1, 0, 0]'),
        "load 1", "one of the two",
    ),
    _kind(
        "a pressure on a round patch",
        _with_load(
            "contact = { point = [0.02, 0, 0.005], radius = 0.003, profile = 'smooth' }\n"
            "pressure = 3.0"
        ),
        "load 1", "triangles",
    ),
    _kind(
        "a load of zero",
        _with_load('contact = { triangles = "side.txt" }\nforce = [0, 0, 0]'),
        "load 1", "zero",
    ),
    _kind(
        "a load with an unknown key",
        _with_load('contact = { triangles = "side.txt" }\npressures = 3.0'),
        "pressures", "pressure",
    ),
    _kind(
        "a load over triangles that are not there",
        _with_load('contact = { triangles = "sid.txt" }\npressure = 3.0'),
        "sid.txt", "side.txt",
    ),
    _kind(
        "a traction that is not known",
        _with_load('contact = { triangles = "side.txt", traction = "linear" }\npressure = 3.0'),
        "traction", "uniform",
    ),
    _kind(
        "a load of text",
        _with_load('contact = { triangles = "side.txt" }\npressure = "much"'),
        "pressure",
    ),
    _kind("loads that are a number", _edited(_GIVEN, _GIVEN + "\nload = 3"), "load"),
    Kind(
        "two points tell no motion",
        written("foot.csv", "x,y,z,ux,uy,uz\n0,0.001,0.001,0,0,0\n0,0.009,0.001,0,0,0\n"),
        _CHECK, ("foot.csv", "support 1", "at least three"), example="tension",
    ),
    Kind(
        "points in a line tell no motion",
        written(
            "foot.csv",
            "x,y,z,ux,uy,uz\n0,0.001,0.001,0,0,0\n0,0.005,0.001,0,0,0\n0,0.009,0.001,0,0,0\n",
        ),
        _CHECK, ("foot.csv", "line"), example="tension",
    ),
    Kind(
        "the motion is of points elsewhere",
        written("foot.csv", "x,y,z,ux,uy,uz\n0.02,0,0.001,0,0,0\n0.03,0,0.001,0,0,0\n"),
        _CHECK, ("foot.csv", "support 1", "0 measured points"), example="tension",
    ),
    Kind(
        "a loaded triangle that the mesh lacks",
        lambda folder: (
            _with_load('contact = { triangles = "side.txt" }\npressure = 3.0')(folder),
            written("side.txt", "99999\n")(folder),
        ),
        _CHECK, ("side.txt", "line 1", "99999"), example="tension",
    ),
    Kind(
        "no loaded triangle",
        lambda folder: (
            _with_load('contact = { triangles = "side.txt" }\npressure = 3.0')(folder),
            written("side.txt", "# none\n")(folder),
        ),
        _CHECK, ("triangles", "at least one"), example="tension",
    ),
    Kind(
        "a load over a support",
        lambda folder: (
            _with_load('contact = { triangles = "side.txt" }\npressure = 3.0')(folder),
            written("side.txt", "0\n")(folder),
        ),
        _CHECK, ("session.toml", "support"), example="tension",
    ),
]  # fmt: skip

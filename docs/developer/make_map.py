"""Make the picture of the house, map.svg, from the rooms and their imports.

    python docs/developer/make_map.py          # or: make map

A room is a folder of `src/palpate` with an `__init__.py`; a folder inside a room is a sub-room and
is called `vision.joint`. The single files beside the rooms are the ground floor, which everybody
may use. The order of the rooms is that of the import contract in `pyproject.toml`.
"""

import ast
import re
import textwrap
import tomllib
from dataclasses import dataclass
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SOURCE = ROOT / "src" / "palpate"
FIELDS = ("Purpose", "Takes", "Gives", "Depends on", "Read first")
GROUND_FLOOR = "ground floor"
INK, SHORT_CUT = "#26323c", "#9fb4c7"
FLOOR_COLOURS = ("#e9f0f6", "#fdf3e3", "#e6e6e6")  # floors in turn, and the ground floor
# Characters that have room in a box, beside its name.
NAMES_A_LINE = 60


@dataclass(frozen=True, slots=True)
class Room:
    """A folder of the package.

    Attributes
    ----------
    name : str              below `palpate`, such as `vision.joint`; empty for the package itself
    folder : Path
    sentence : str          first sentence of the docstring of its `__init__`
    fields : dict           text of each of the five fields that the docstring has
    """

    name: str
    folder: Path
    sentence: str
    fields: dict[str, str]


@dataclass(frozen=True, slots=True)
class Import:
    """One `from palpate... import ...` of one file.

    Attributes
    ----------
    importer : str          the importing module below `palpate`, such as `vision.joint.flow`
    imported : str          what stands after `from`, likewise
    names : tuple of str    the names that are imported
    path : Path             file
    line : int
    """

    importer: str
    imported: str
    names: tuple[str, ...]
    path: Path
    line: int


def read_rooms(source: Path = SOURCE) -> dict[str, Room]:
    """All rooms and sub-rooms by name, a room before its sub-rooms; the package itself first."""
    rooms = {}
    for path in sorted(source.rglob("__init__.py"), key=lambda path: path.parts[:-1]):
        name = ".".join(path.parent.relative_to(source).parts)
        docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        sentence = " ".join(docstring.split("\n\n")[0].split())
        rooms[name] = Room(name, path.parent, sentence, _fields(docstring))
    return rooms


def _fields(docstring: str) -> dict[str, str]:
    """The text of `Purpose    : ...` and its like; a field ends at the next, or at a blank line."""
    pattern = rf"^({'|'.join(FIELDS)})\s*:(.*?)(?=^(?:{'|'.join(FIELDS)})\s*:|^\s*$|\Z)"
    pairs = re.findall(pattern, docstring, flags=re.MULTILINE | re.DOTALL)
    return {name: " ".join(text.split()) for name, text in pairs}


def read_imports(source: Path = SOURCE) -> list[Import]:
    """All imports of palpate by palpate, those inside functions included."""
    imports = []
    for path in sorted(source.rglob("*.py")):
        importer = ".".join(path.relative_to(source).with_suffix("").parts)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "palpate":
                imported = (node.module or "").removeprefix("palpate").removeprefix(".")
                names = tuple(alias.name for alias in node.names)
                imports.append(Import(importer, imported, names, path, node.lineno))
            elif isinstance(node, ast.Import):
                imports += [
                    Import(importer, alias.name.removeprefix("palpate."), (), path, node.lineno)
                    for alias in node.names
                    if alias.name.startswith("palpate.")
                ]
    return imports


def room_of(module: str, rooms: dict[str, Room]) -> str:
    """The room or sub-room in which a module lies; empty for the ground floor."""
    while module not in rooms:
        module = module.rpartition(".")[0]
    return module


def real_dependencies(rooms: dict[str, Room], imports: list[Import]) -> dict[str, set[str]]:
    """What each room's files import: other rooms, and for a sub-room its sister sub-rooms.

    The ground floor is left out, and so are the files that lie directly in a sub-room's own room.
    A room answers for its sub-rooms too.
    """
    needs: dict[str, set[str]] = {name: set() for name in rooms if name}
    for entry in imports:
        here, there = room_of(entry.importer, rooms), room_of(entry.imported, rooms)
        if not here or not there:
            continue
        if here.split(".")[0] != there.split(".")[0]:
            for name in {here, here.split(".")[0]}:
                needs[name].add(there.split(".")[0])
        elif here != there and "." in here and "." in there:
            needs[here].add(there)
    return needs


def named_dependencies(room: Room) -> set[str]:
    """The names in "Depends on" up to its first semicolon or full stop, less the ground floor."""
    text = re.split(r";|\.(?:\s|$)", room.fields.get("Depends on", ""))[0]
    names = {name.strip(" `") for name in re.split(r",| and ", text)}
    return names - {"", "nothing", "nothing but the ground floor", *layers()[-1]}


def read_first(room: Room) -> list[str]:
    """The files that "Read first" names, relative to the room's folder."""
    return re.findall(r"[\w/]+\.py\b", room.fields.get("Read first", ""))


def layers() -> list[list[str]]:
    """Rooms from top to bottom as the import contract has them; the last row is the ground floor.

    Rooms on one line do not know each other. Rooms in brackets are still to be built.
    """
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    (house,) = (contract for contract in contracts if contract.get("containers") == ["palpate"])
    rows = [re.findall(r"(?<![\w(])\w+(?!\w*\))", line) for line in house["layers"]]
    ground = [name for row in rows for name in row if (SOURCE / f"{name}.py").is_file()]
    return [row for row in rows if not set(row) <= set(ground)] + [ground]


def arrows_text(rooms: dict[str, Room], imports: list[Import]) -> str:
    """What the picture shows, as text: the rooms, and who imports whom. Kept in the picture."""
    needs = real_dependencies(rooms, imports)
    return "; ".join(f"{name}: {' '.join(sorted(needs[name]))}".strip() for name in sorted(needs))


def draw_map(path: Path, rooms: dict[str, Room], imports: list[Import]) -> None:
    """The picture of the map: rooms from top to bottom, an arc for each import between them.

    Arcs on the left lead to the next room on the way down, arcs on the right take a short cut.
    """
    *floors, ground = layers()
    order = [name for row in floors for name in row]
    needs = {name: real_dependencies(rooms, imports)[name] for name in order}
    height = {name: -float(level) for level, name in enumerate(order)}
    style = {"svg.hashsalt": "palpate", "font.family": "DejaVu Sans"}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=(11.7, 0.66 * (len(order) + 2)), layout="constrained")
        axes = figure.add_subplot()
        for shade, row in enumerate(floors):
            for name in row:
                colour = FLOOR_COLOURS[shade % 2]
                inside = [room.split(".")[1] for room in rooms if room.rpartition(".")[0] == name]
                _draw_room(axes, name, inside, height[name], colour)
        _draw_room(axes, GROUND_FLOOR, ground, -len(order) - 0.25, FLOOR_COLOURS[2])
        for name in order:
            # What a room reaches through the others that it imports: an arrow there is a short cut.
            beyond = {far for near in needs[name] for far in _reached(near, needs)}
            for target in sorted(needs[name]):
                _draw_arc(axes, height[name], height[target], short_cut=target in beyond)
        axes.set(xlim=(-7.4, 9.1), ylim=(-len(order) - 0.8, 0.6))
        axes.set_axis_off()
        description = {"Date": None, "Description": arrows_text(rooms, imports)}
        figure.savefig(path, metadata=description)


def _reached(name: str, needs: dict[str, set[str]]) -> set[str]:
    return needs[name] | {far for near in needs[name] for far in _reached(near, needs)}


def _draw_room(axes: Axes, name: str, inside: list[str], y: float, colour: str) -> None:
    box = FancyBboxPatch(
        (-4.0, y - 0.3), 8.0, 0.6, boxstyle="round,pad=0,rounding_size=0.12", fc=colour, ec=INK
    )
    axes.add_patch(box)
    axes.text(-3.8, y, name, va="center", ha="left", weight="bold", size=12, color=INK)
    text = textwrap.fill("   ".join(inside), NAMES_A_LINE)
    axes.text(3.8, y, text, va="center", ha="right", size=8.5, color=INK)


def _draw_arc(axes: Axes, start: float, end: float, *, short_cut: bool) -> None:
    side, colour = (1, SHORT_CUT) if short_cut else (-1, INK)
    arc = FancyArrowPatch(
        (side * 4.02, start - 0.1),
        (side * 4.02, end + 0.1),
        connectionstyle=f"arc3,rad={-side * 0.55}",
        arrowstyle="-|>,head_length=5,head_width=2.5",
        color=colour,
        linewidth=1.0 if short_cut else 1.6,
        shrinkA=0,
        shrinkB=0,
    )
    axes.add_patch(arc)


def main() -> None:
    """Write map.svg beside this file."""
    draw_map(HERE / "map.svg", read_rooms(), read_imports())


if __name__ == "__main__":
    main()

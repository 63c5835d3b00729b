"""The picture of the house, and what the doors say, are those of the code as it stands."""

import re

import pytest
from make_map import (
    FIELDS,
    HERE,
    SOURCE,
    arrows_text,
    layers,
    named_dependencies,
    read_first,
    read_imports,
    read_rooms,
    real_dependencies,
)

ROOMS = read_rooms()
NAMES = [name or "palpate" for name in ROOMS]


@pytest.fixture(scope="module")
def imports():
    return read_imports()


def test_picture_of_the_map_is_current(imports):
    # Its lines depend on matplotlib's version; what it shows stands in its description.
    picture = (HERE / "map.svg").read_text(encoding="utf-8")
    assert f">{arrows_text(ROOMS, imports)}<" in picture, "run `make map`"


def test_every_folder_with_code_is_a_room():
    folders = {path.parent for path in SOURCE.rglob("*.py")}
    assert folders == {room.folder for room in ROOMS.values()}


def test_every_room_stands_on_a_floor():
    floors = [name for row in layers() for name in row]
    rooms = {name for name in ROOMS if name and "." not in name}
    files = {path.stem for path in SOURCE.glob("*.py")} - {"__init__"}
    assert sorted(floors) == sorted(rooms | files)


@pytest.mark.parametrize("room", ROOMS.values(), ids=NAMES)
def test_docstring_has_the_five_fields(room):
    assert list(room.fields) == list(FIELDS)
    assert all(room.fields.values())
    assert re.fullmatch(r"[A-Z].{8,}\.", room.sentence), "a first sentence that says something"


@pytest.mark.parametrize("room", [room for name, room in ROOMS.items() if name], ids=NAMES[1:])
def test_depends_on_is_true(room, imports):
    assert named_dependencies(room) == real_dependencies(ROOMS, imports)[room.name]


@pytest.mark.parametrize("room", ROOMS.values(), ids=NAMES)
def test_read_first_names_files_that_exist(room):
    files = read_first(room)
    assert files
    assert [file for file in files if not (room.folder / file).is_file()] == []


def test_a_wrong_dependency_is_noticed(imports):
    # The checks above can fail: a sub-room that imports upwards, a name that is no room.
    vision = ROOMS["vision"]
    assert "estimation" not in real_dependencies(ROOMS, imports)["vision"]
    lying = type(vision)("vision", vision.folder, "", {"Depends on": "`records`, bem; not `lab`."})
    assert named_dependencies(lying) == {"records", "bem"}

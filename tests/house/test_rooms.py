"""Rooms stay small, and are entered by their doors."""

import ast
from pathlib import Path

import pytest
from make_map import ROOT, SOURCE, read_imports, read_rooms, room_of

FILES = sorted(SOURCE.rglob("*.py"))
ROOMS = read_rooms()
# More is not seen at one glance (docs/developer/index.md).
MOST_FILES = 12
MOST_LINES = 400
MOST_FUNCTION_LINES = 50


def source_name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def entered_wrongly(importer: str, imported: str) -> bool:
    """True where an import does not go by the nearest door, its rooms given as module names.

    Same folder, or the files directly in one's own room: from the file. A sister sub-room: from the
    sub-room. Another room: from the room. The ground floor: from its file.
    """
    here, there = room_of(importer, ROOMS), room_of(imported, ROOMS)
    if not there and imported not in ROOMS:  # ground floor
        return False
    if here.split(".")[0] != there.split(".")[0]:
        return imported != there.split(".")[0]
    same_folder_or_own_room = there in (here, here.split(".")[0])
    return imported == there if same_folder_or_own_room else imported != there


@pytest.mark.parametrize(
    ("importer", "imported", "wrong"),
    [
        ("vision.cameras.lens", "vision.cameras.projection", False),
        ("vision.cameras.lens", "vision.cameras", True),
        ("vision.cameras.lens", "vision.range_flow", False),
        ("vision.cameras.lens", "vision", True),
        ("vision.joint.flow", "vision.cameras", False),
        ("vision.joint.flow", "vision.cameras.projection", True),
        ("pipeline.fit_session", "vision", False),
        ("pipeline.fit_session", "vision.range_flow", True),
        ("pipeline.fit_session", "vision.cameras", True),
        ("bem.elastic_map", "bem.system", False),
        ("bem.elastic_map", "errors", False),
        ("app.cli", "", False),  # the version
    ],
)
def test_doors(importer, imported, wrong):
    assert entered_wrongly(importer, imported) == wrong


def test_no_import_goes_round_a_door():
    wrong = [
        f"{source_name(each.path)}:{each.line}: from palpate.{each.imported} import ..."
        for each in read_imports()
        if each.path.name != "__init__.py" and entered_wrongly(each.importer, each.imported)
    ]
    assert wrong == []


def test_faces_hold_names_of_their_own_room_only():
    # A face lists its own files' and its sub-rooms' names, nothing of other rooms.
    foreign = [
        f"{source_name(each.path)}:{each.line}"
        for each in read_imports()
        if each.path.name == "__init__.py"
        and not each.imported.startswith(each.importer.removesuffix(".__init__") + ".")
    ]
    assert foreign == []


def test_a_name_without_underscore_is_public_and_one_with_it_stays_in_its_file():
    listed = [source_name(path) for path in FILES if "__all__" in path.read_text(encoding="utf-8")]
    assert listed == []
    private = [
        f"{source_name(each.path)}:{each.line}: {name}"
        for each in read_imports()
        for name in each.names
        if name.startswith("_") and not name.startswith("__")
    ]
    assert private == []


@pytest.mark.parametrize("room", ROOMS.values(), ids=[name or "palpate" for name in ROOMS])
def test_a_folder_holds_few_files(room):
    files = [path.name for path in room.folder.glob("*.py") if path.name != "__init__.py"]
    assert len(files) <= MOST_FILES, sorted(files)


def test_files_are_short():
    lengths = {source_name(path): len(path.read_text().splitlines()) for path in FILES}
    assert {name: length for name, length in lengths.items() if length > MOST_LINES} == {}


def is_kernel(node: ast.FunctionDef) -> bool:
    """Compiled by numba."""
    return "njit" in "".join(map(ast.unparse, node.decorator_list))


def test_functions_fit_on_a_screen():
    # Kernels may be longer: a function more is compiled once more into each that calls it.
    lengths = {}
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and not is_kernel(node):
                documented = ast.get_docstring(node) is not None
                first = node.body[0].end_lineno + 1 if documented else node.lineno
                lengths[f"{source_name(path)}: {node.name}"] = node.end_lineno - first + 1
    assert {name: length for name, length in lengths.items() if length > MOST_FUNCTION_LINES} == {}


def public_definitions(path: Path):
    """Every public function, class and method of a file, with its name."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield f"{path.stem}.{node.name}", node
            for method in node.body if isinstance(node, ast.ClassDef) else ():
                if isinstance(method, ast.FunctionDef) and not method.name.startswith("_"):
                    yield f"{path.stem}.{node.name}.{method.name}", method


def test_everything_public_says_what_it_is():
    files = {source_name(path): ast.parse(path.read_text(encoding="utf-8")) for path in FILES}
    silent = [name for name, tree in files.items() if not ast.get_docstring(tree)]
    found = [pair for path in FILES for pair in public_definitions(path)]
    silent += [name for name, node in found if not ast.get_docstring(node)]
    assert silent == []
    assert len(found) > 300  # the search has seen the code


def test_hidden_state_is_listed():
    # What outlives a call stands with its reason in the page for developers.
    page = (ROOT / "docs" / "developer" / "index.md").read_text(encoding="utf-8")
    hidden = []
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Global):
                hidden += [f"{source_name(path)}: {name}" for name in node.names]
            elif isinstance(node, ast.FunctionDef) and any(
                "cache" in ast.unparse(mark).split("(")[0] for mark in node.decorator_list
            ):
                hidden.append(node.name)
    assert [name for name in hidden if f"`{name}`" not in page] == []


def test_functions_of_many_arguments_list_them():
    # Kernels for numba are left to the sentence that ties their letters to an equation.
    missing = [
        f"{source_name(path)}: {name}"
        for path in FILES
        for name, node in public_definitions(path)
        if isinstance(node, ast.FunctionDef)
        and len(node.args.args + node.args.kwonlyargs) > 3
        and not is_kernel(node)
        and "Parameters\n" not in (ast.get_docstring(node) or "")
    ]
    assert missing == []

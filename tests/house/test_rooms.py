"""Rooms stay small, and are entered by their doors."""

import ast
from functools import cache
from pathlib import Path

import pytest
from make_map import ROOT, SOURCE, Import, read_imports, read_rooms, room_of

FILES = sorted(SOURCE.rglob("*.py"))
ROOMS = read_rooms()
# A folder is a page; a file is a subject, not a size (docs/developer/index.md).
MOST_FILES = 20
MOST_LINES = 600
MOST_FUNCTION_LINES = 50


def source_name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def trees() -> dict[str, ast.Module]:
    """Every file of palpate, parsed."""
    return {source_name(path): ast.parse(path.read_text(encoding="utf-8")) for path in FILES}


@cache
def imports() -> list[Import]:
    return read_imports()


def all_functions():
    """Every function and method with the name of its file."""
    for name, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                yield name, node


def public_definitions():
    """Every public function, class and method with its name."""
    for name, tree in trees().items():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                yield f"{name}: {node.name}", node
                for method in node.body if isinstance(node, ast.ClassDef) else ():
                    if isinstance(method, ast.FunctionDef) and not method.name.startswith("_"):
                        yield f"{name}: {node.name}.{method.name}", method


def decorators(node: ast.FunctionDef) -> list[str]:
    return [ast.unparse(decorator) for decorator in node.decorator_list]


def is_kernel(node: ast.FunctionDef) -> bool:
    """Compiled by numba."""
    return any("njit" in decorator for decorator in decorators(node))


def entered_wrongly(importer: str, imported: str) -> bool:
    """True where an import does not go by the right door, both given as module names.

    One's own room: from the file. Another room: from the room. The ground floor: from its file.
    """
    here, there = (room_of(name, ROOMS).split(".")[0] for name in (importer, imported))
    # The ground floor, and the package itself, which has the version.
    if not there and (imported not in ROOMS or not imported):
        return False
    return imported in ROOMS if here == there else imported != there


@pytest.mark.parametrize(
    ("importer", "imported", "wrong"),
    [
        ("vision.joint.flow", "vision.joint.match", False),
        ("vision.joint.flow", "vision.joint", True),
        ("vision.joint.flow", "vision", True),
        ("vision.joint.flow", "vision.matching", True),
        ("vision.joint.flow", "vision.matching.scene", False),
        ("pipeline.fit_session", "vision", False),
        ("pipeline.fit_session", "vision.range_flow", True),
        ("pipeline.fit_session", "vision.matching", True),
        ("bem.elastic_map", "bem.system", True),
        ("bem.elastic_map", "errors", False),
        ("app.cli", "", False),  # the version
    ],
)
def test_doors(importer, imported, wrong):
    assert entered_wrongly(importer, imported) == wrong


def test_no_import_goes_round_a_door():
    wrong = [
        f"{source_name(imported.path)}:{imported.line}: from palpate.{imported.imported} import ..."
        for imported in imports()
        if imported.path.name != "__init__.py"
        and entered_wrongly(imported.importer, imported.imported)
    ]
    assert wrong == []


def test_folders_in_a_room_have_no_doors():
    doors = [
        f"{source_name(imported.path)}:{imported.line}"
        for imported in imports()
        if imported.path.name == "__init__.py" and "." in room_of(imported.importer, ROOMS)
    ]
    assert doors == []


def test_faces_hold_names_of_their_own_room_only():
    foreign = [
        f"{source_name(imported.path)}:{imported.line}"
        for imported in imports()
        if imported.path.name == "__init__.py"
        # The root's is the face of the whole house.
        and imported.path.parent != SOURCE
        and not imported.imported.startswith(imported.importer.removesuffix(".__init__") + ".")
    ]
    assert foreign == []


def test_a_name_with_an_underscore_stays_in_its_file():
    private = [
        f"{source_name(imported.path)}:{imported.line}: {name}"
        for imported in imports()
        for name in imported.names
        if name.startswith("_") and not name.startswith("__")
    ]
    assert private == []


def test_there_is_no_list_of_public_names():
    listed = [source_name(path) for path in FILES if "__all__" in path.read_text(encoding="utf-8")]
    assert listed == []


@pytest.mark.parametrize("room", ROOMS.values(), ids=[name or "palpate" for name in ROOMS])
def test_a_folder_holds_few_files(room):
    files = [path.name for path in room.folder.glob("*.py") if path.name != "__init__.py"]
    assert len(files) <= MOST_FILES, sorted(files)


def test_files_are_short():
    lengths = {source_name(path): len(path.read_text().splitlines()) for path in FILES}
    assert {name: length for name, length in lengths.items() if length > MOST_LINES} == {}


def test_functions_fit_on_a_screen():
    # Kernels may be longer: a function more is compiled once more into each that calls it.
    lengths = {}
    for name, node in all_functions():
        if not is_kernel(node):
            documented = ast.get_docstring(node) is not None
            first = node.body[0].end_lineno + 1 if documented else node.lineno
            lengths[f"{name}: {node.name}"] = node.end_lineno - first + 1
    assert {name: length for name, length in lengths.items() if length > MOST_FUNCTION_LINES} == {}


def test_everything_public_says_what_it_is():
    silent = [name for name, tree in trees().items() if not ast.get_docstring(tree)]
    silent += [name for name, node in public_definitions() if not ast.get_docstring(node)]
    assert silent == []
    assert len(list(public_definitions())) > 300  # the search has seen the code


def test_hidden_state_is_listed():
    # What outlives a call stands with its reason in the page for developers.
    page = (ROOT / "docs" / "developer" / "index.md").read_text(encoding="utf-8")
    hidden = [
        node.name
        for _, node in all_functions()
        if any("cache" in decorator.split("(")[0] for decorator in decorators(node))
    ]
    assert [name for name in hidden if f"`{name}`" not in page] == []
    changed = [
        f"{name}: {node.names}"
        for name, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Global)
    ]
    assert changed == []


def test_functions_of_many_arguments_list_them():
    # Kernels are left to the sentence that ties their letters to an equation; methods of a protocol
    # are described there.
    missing = [
        f"{name}: {node.name}"
        for name, tree in trees().items()
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
        and not node.name.startswith("_")
        and len(node.args.args + node.args.kwonlyargs) > 3
        and not is_kernel(node)
        and "Parameters\n" not in (ast.get_docstring(node) or "")
    ]
    assert missing == []

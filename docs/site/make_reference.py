"""Writes docs/reference/*.md and docs/gallery.md from the code that reads files, and notebooks from
their text: `make reference`.

Tables are found where a reader refuses unknown keys (`TomlTable.check_keys`): what is allowed there
is what the page lists. What a key holds is found where it is read (`table.vector("force")`), what
it means in the docstring of the record that it becomes. A table or a key about which nothing is
found ends this program, and so the tests: say it there or in `reference_words.py`.
"""

import ast
import inspect
import json
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from reference_words import COLUMNS, FORMS, READS, SERIES, WORDS

from palpate.records.programs.registry import PROGRAMS
from palpate.records.text.toml_table import TomlTable

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
FILES = "palpate.records.files."
RECORDS = "palpate.records."
REGISTRY = "palpate.records.programs.registry"


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a file: where its keys are checked, and what they become.

    Attributes
    ----------
    title : str                     as it stands in the file
    module, function : str          that calls `check_keys`
    number : int                    which of its calls
    records : tuple of str          classes whose docstrings explain the keys: module and name
    keys : tuple of str             in place of what the call allows, where only running would tell
    """

    title: str
    module: str
    function: str
    number: int = 0
    records: tuple[str, ...] = ()
    keys: tuple[str, ...] = ()


SESSION = (
    Table("the file itself", FILES + "session", "read_session", 0, (RECORDS + "session.Session",)),
    Table("[object]", FILES + "session", "read_session", 1, (RECORDS + "session.Session",)),
    Table(
        "[support], or several [[support]]",
        RECORDS + "support",
        "read_supports",
        0,
        (RECORDS + "support.Support",),
    ),
    Table("plane of a support: one table, or a list", RECORDS + "support", "_plane_distance"),
    Table("box of a support: one table, or a list", RECORDS + "support", "read_box"),
    Table(
        "[[region]], a part with a modulus of its own",
        RECORDS + "region",
        "read_regions",
        0,
        (RECORDS + "region.Region",),
    ),
    Table("plane of a region", RECORDS + "region", "_shape"),
    Table("[gravity]", FILES + "session", "_gravity"),
    Table("[rig]", FILES + "session", "_cameras"),
    Table(
        "[errors]",
        RECORDS + "error_priors",
        "read_error_priors",
        0,
        (RECORDS + "error_priors.ErrorPriors",),
    ),
    Table("pose of [errors]", RECORDS + "error_priors", "_pose"),
    Table(
        "[[probe]]",
        FILES + "session",
        "_named_tables",
        0,
        (RECORDS + "probing.Probing",),
        ("_PROBE_KEYS",),
    ),
    Table(
        "contact of a probe: a round patch",
        FILES + "loads",
        "_contact",
        1,
        (RECORDS + "contact.Contact",),
    ),
    Table(
        "contact of a probe: a tool",
        FILES + "loads",
        "_tool",
        0,
        (RECORDS + "contact.Tool", RECORDS + "contact.Contact"),
    ),
    Table(
        "contact of a probe: a tool given as a mesh",
        FILES + "loads",
        "_mesh_tool",
        0,
        (RECORDS + "contact.Tool", RECORDS + "contact.Contact"),
    ),
    Table("contact of a probe: a face", FILES + "loads", "_contact", 0),
    Table("contact of a probe: a grip", FILES + "loads", "read_push"),
    Table("[[probe.load]]", FILES + "loads", "read_loads", 0, (RECORDS + "probing.Load",)),
    Table(
        "support_motion of a probe",
        FILES + "loads",
        "read_support_motion",
        0,
        (RECORDS + "support.RigidMotion",),
    ),
    Table("images of a probe", FILES + "session", "_images", 0, (RECORDS + "probing.Images",)),
    Table(
        "[[step]], of a rigid-motion sequence",
        FILES + "session",
        "_named_tables",
        0,
        (RECORDS + "session.Step",),
        ("_STEP_KEYS",),
    ),
)
RIG = (
    Table("the file itself", REGISTRY, "_read_toml_rig", 0, (RECORDS + "rig.Rig",)),
    Table("[[camera]]", REGISTRY, "_camera", 0, (RECORDS + "rig.Camera",)),
)
POSE = (Table("the file itself", RECORDS + "measured_points", "read_import_pose"),)
# Calls that only repeat a check for one selector, or stand for several tables above; and keys that
# are names which the session itself gives.
REPEATED = {(RECORDS + "support", "selected_triangles"), (RECORDS + "error_priors", "_force_gains")}


def checks(module: ModuleType) -> Iterator[tuple[str, ast.Call]]:
    """Calls of `check_keys` in a module, with the function that they stand in."""
    for function in ast.walk(ast.parse(inspect.getsource(module))):
        if isinstance(function, ast.FunctionDef):
            calls = [node for node in ast.walk(function) if isinstance(node, ast.Call)]
            for node in sorted(calls, key=lambda call: call.lineno):
                if _called(node) == "check_keys":
                    yield function.name, node


def _called(node: ast.Call) -> str:
    return node.func.attr if isinstance(node.func, ast.Attribute) else ""


def allowed_keys(table: Table) -> list[str]:
    """Keys that a table may have, as its reader has them."""
    module = import_module(table.module)
    calls = [call for name, call in checks(module) if name == table.function]
    if table.keys:
        return [key for name in table.keys for key in getattr(module, name, [name])]
    expression = ast.Expression(calls[table.number].args[0])
    return list(eval(compile(ast.fix_missing_locations(expression), "", "eval"), vars(module)))


def readers() -> set[str]:
    """Methods of `TomlTable` that read a key."""
    members = inspect.getmembers(TomlTable, inspect.isfunction)
    return {
        name
        for name, function in members
        if list(inspect.signature(function).parameters)[:2] == ["self", "key"]
    } - {"fail", "get", "optional"}


def forms(modules: Sequence[str]) -> dict[Any, str]:
    """What a key holds, found where it is read: by function and key, and by key alone."""
    if missing := readers() - set(READS):
        raise SystemExit(f"no words for these readers of TOML: {missing}")
    by_key: dict[Any, str] = {}
    for name in modules:
        module = import_module(name)
        for function in ast.walk(ast.parse(inspect.getsource(module))):
            if not isinstance(function, ast.FunctionDef):
                continue
            for key, text in _read_keys(module, function):
                by_key.setdefault((name, function.name, key), text)
                by_key.setdefault(key, text)
    return by_key


def _read_keys(module: ModuleType, function: ast.FunctionDef) -> Iterator[tuple[str, str]]:
    """Keys that a function reads, and as what."""
    for node in ast.walk(function):
        if isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            key, reader = node.args[0].value, _called(node)
            if reader == "optional":
                reader, node = _optional(node)
            if isinstance(key, str) and reader in READS:
                form = READS[reader] + _choices(module, reader, node)
                if form != READS["choice"]:
                    yield key, form


def _optional(node: ast.Call) -> tuple[str, ast.Call]:
    """The reader that `table.optional(key, reader)` hands the key to."""
    inner = node.args[1]
    if isinstance(inner, ast.Lambda) and isinstance(inner.body, ast.Call):
        return _called(inner.body), inner.body
    name = inner.attr if isinstance(inner, ast.Attribute) else ""
    return name, ast.Call(node.func, [node.args[0]], [])


def _choices(module: ModuleType, reader: str, node: ast.Call) -> str:
    """The words or units that a reader takes, where they are constants."""
    if reader not in ("choice", "quantity") or len(node.args) < 2:
        return ""
    try:
        values = eval(ast.unparse(node.args[1]), vars(module))
    except NameError:
        return ""
    words = ", ".join(f"`{value}`" for value in values)
    return f" {words}" if reader == "choice" else f" ({words})"


def meanings(record: str) -> dict[str, str]:
    """What the fields of a record mean, from the lines of its docstring."""
    module, _, name = record.rpartition(".")
    lines = inspect.getdoc(getattr(import_module(module), name)).splitlines()
    by_field: dict[str, str] = {}
    field = ""
    for line in lines[lines.index("Parameters") + 2 :]:
        heading = re.match(r"(\w[\w, ]*?) : (\S.*?)(?:  +(.*))?$", line)
        if heading:
            field = heading[1]
            for attribute in field.split(", "):
                by_field[attribute] = heading[3] or ""
        elif line.startswith("    ") and field:
            for attribute in field.split(", "):
                by_field[attribute] = f"{by_field[attribute]} {line.strip()}".strip()
        elif line:
            break
    return {key: text for key, text in by_field.items() if text}


def defaults(records: Sequence[str]) -> dict[str, Any]:
    """Numbers that a record has where nothing is said, with their units."""
    by_name = {}
    for record in records:
        module, _, name = record.rpartition(".")
        kind = getattr(import_module(module), name)
        for parameter in inspect.signature(kind).parameters.values():
            unit = re.search(rf"^{parameter.name} : float \[(.*?)\]", inspect.getdoc(kind), re.M)
            if isinstance(parameter.default, float) and unit:
                by_name[parameter.name] = f"{parameter.default:.3g} {unit[1].strip('-')}".strip()
    return by_name


def rows(table: Table, form_of: dict[Any, str]) -> Iterator[str]:
    """The lines of a table of the page."""
    explained: dict[str, str] = {}
    for record in table.records:
        explained = meanings(record) | explained
    standard = defaults(table.records)
    for key in allowed_keys(table):
        here = form_of.get((table.module, table.function, key))
        form = FORMS.get((table.title, key)) or here or FORMS.get(key) or form_of.get(key)
        text = WORDS.get((table.title, key)) or WORDS.get(key) or explained.get(key)
        if not form or not text:
            raise SystemExit(f"{table.title}: nothing is known about '{key}': {form}, {text}")
        if key in standard:
            text += f"; default {standard[key]}"
        yield f"| `{key}` | {form} | {text} |"


def file_section(tables: Sequence[Table]) -> Iterator[str]:
    """All tables of a file."""
    form_of = forms(
        sorted({table.module for table in tables} | {FILES + "session", FILES + "loads"})
    )
    for table in tables:
        yield f"### {table.title}\n"
        yield "| key | form | meaning |\n| --- | --- | --- |"
        yield from rows(table, form_of)
        yield ""


def unlisted() -> list[str]:
    """Places where keys are checked that no table names."""
    tables = (*SESSION, *RIG, *POSE)
    listed = {(table.module, table.function) for table in tables} | REPEATED
    modules = {table.module for table in tables}
    return [
        f"{module}.{name}"
        for module in sorted(modules)
        for name, _ in checks(import_module(module))
        if (module, name) not in listed
    ]


def prose(function: Any) -> str:
    """A docstring without its parameters: what a person reads."""
    text = inspect.getdoc(function) or ""
    remaining, skip = [], False
    lines = text.splitlines()
    for number, line in enumerate(lines):
        after = lines[number + 1] if number + 1 < len(lines) else ""
        if after and set(after) == {"-"}:
            skip = line not in ("Source",)
            if not skip:
                remaining.append("\nSource:")
            continue
        if not skip and not (line and set(line) == {"-"}):
            remaining.append(line)
    return textwrap.dedent("\n".join(remaining)).strip()


def program_sections() -> Iterator[str]:
    """What is read of every other program."""
    for program in PROGRAMS:
        yield f"## {', '.join(program.kinds) or program.calibrations}\n"
        facts = [
            ("kind", ", ".join(f"`{kind}`" for kind in program.kinds)),
            ("results", f"`{program.results}`" if program.results else ""),
            ("calibrations", program.calibrations),
            ("unit where the file says none", program.default_unit),
            ("lowest accepted score", program.min_score),
        ]
        for name, value in facts:
            if value not in (None, ""):
                yield f"- {name}: {value}"
        for heading, function in (
            ("Results", program.read_points),
            ("Calibration", program.read_rig),
        ):
            if function is not None:
                yield f"\n### {heading} of {(program.kinds or (program.calibrations,))[0]}\n"
                yield prose(function)
        yield ""


HEAD = (
    "<!-- Made by `make reference` from the code that reads the files; `make test` checks it. -->\n"
)


def session_page() -> str:
    """docs/reference/files.md."""
    columns = _columns("displacement", COLUMNS), _columns("series", SERIES)
    parts = [
        HEAD,
        "# session.toml, rig.toml and what they name, key by key\n",
        "Every key that is read; any other is refused by name. Lengths are in the file's",
        '`length_unit`, or texts with a unit of their own ("0.5 mm") where the form says so. How',
        "to write a session: [first session](../howto/first_session.md).\n",
        "## session.toml\n",
        *file_section(SESSION),
        "## rig.toml\n",
        *file_section(RIG),
        "## pose.toml, for imported displacements\n",
        *file_section(POSE),
        "## Displacement CSV\n",
        columns[0],
        "## Series CSV\n",
        columns[1],
    ]
    return "\n".join(parts)


def _columns(file: str, meaning: dict[str, str]) -> str:
    """The table of the columns of a file that a session names."""
    known = import_module(FILES + file)._COLUMNS
    if set(known) != {name for names in meaning for name in names.split(", ")}:
        raise SystemExit(f"the columns of a {file} file are {known}: say what they are")
    rows = "\n".join(f"| `{names}` | {text} |" for names, text in meaning.items())
    return f"| column | meaning |\n| --- | --- |\n{rows}\n"


def programs_page() -> str:
    """docs/reference/programs.md."""
    parts = [
        HEAD,
        "# Files of other programs\n",
        "What is read of each program's files, and where that is known from. How to import:",
        "[displacements from another program](../howto/import.md).\n",
        *program_sections(),
    ]
    return "\n".join(parts)


# Subjects of the gallery, and the pages whose pictures belong to them.
SUBJECTS = {
    "See it work": ("index", "tutorial"),
    "Prepare": ("calibrate", "moved_camera", "scan", "mesh", "init", "lab", "next", "bench"),
    "Measure": (
        "measure",
        "record",
        "import",
        "flow",
        "pokes",
        "compression",
        "sliding_supports",
        "giving_supports",
    ),
    "Believe": ("report", "results", "comparison", "paper"),
    "Uneven, creeping, stiffening": ("heterogeneous", "creep", "stiffening"),
    "Use": ("view", "poke", "simulate", "export", "campaign"),
    "Understand": ("theory",),
}


def gallery_page() -> str:
    """docs/gallery.md: every picture for users as a card, by subject, with the page that explains
    it."""
    parts = [HEAD, "# Gallery\n", "Every picture of these pages, and where it is explained.\n"]
    shown: set[Path] = set()
    cards: dict[str, list[str]] = {subject: [] for subject in SUBJECTS}
    for page in sorted(DOCS.rglob("*.md")):
        if page.name == "gallery.md" or page.parent.name == "developer":
            continue
        title = next(
            (x[2:] for x in page.read_text().splitlines() if x.startswith("# ")), page.stem
        )
        for words, target in re.findall(r"!\[([^]]*)\]\(([^)]+)\)", page.read_text()):
            file = (page.parent / target).resolve()
            if file.suffix in (".png", ".svg", ".gif") and file not in shown:
                shown.add(file)
                link, source = file.relative_to(DOCS), page.relative_to(DOCS)
                named = {page.stem, page.parent.name}
                (subject,) = [heading for heading, pages in SUBJECTS.items() if named & set(pages)]
                cards[subject].append(
                    f'<div class="card">\n\n![{words}]({link})\n\n{words}: [{title}]({source}).\n'
                    "\n</div>\n"
                )
    for subject, subject_cards in cards.items():
        body = "\n".join(subject_cards)
        parts.append(f'## {subject}\n\n<div class="cards">\n\n{body}\n</div>\n')
    return "\n".join(parts)


def notebook(source: Path) -> str:
    """A notebook as Jupyter opens it, of its text with `# %%` before every cell."""
    cells = []
    for number, cell in enumerate(source.read_text(encoding="utf-8").split("# %%")[1:]):
        head, _, text = cell.partition("\n")
        kind, more = "code", {"execution_count": None, "outputs": []}
        if "markdown" in head:
            kind, more = "markdown", {}
            text = re.sub(r"^# ?", "", text, flags=re.MULTILINE)
        lines = text.strip().splitlines(keepends=True)
        cells.append(
            {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": lines} | more
        )
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    content = {
        "cells": cells,
        "metadata": {"kernelspec": kernel},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(content, indent=1)


PAGES = {
    DOCS / "reference" / "files.md": session_page,
    DOCS / "reference" / "programs.md": programs_page,
    DOCS / "gallery.md": gallery_page,
    **{
        path.with_suffix(".ipynb"): partial(notebook, path)
        for path in sorted((DOCS / "notebooks").glob("*.py"))
    },
}


def main() -> None:
    """Write all pages."""
    if missing := unlisted():
        raise SystemExit(f"keys are checked where no table is named: {', '.join(missing)}")
    for path, make in PAGES.items():
        path.write_text(make().rstrip() + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

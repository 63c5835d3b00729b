"""Settings of the documentation site; `make docs` builds it, with nothing from other hosts."""

import re
import sys
from pathlib import Path

from pygments.lexers.special import TextLexer

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(ROOT / "src")]

project = "Palpate"
author = "The Palpate developers"
copyright = "the Palpate developers, BSD-3-Clause"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "index"
exclude_patterns = ["site"]
myst_heading_anchors = 4
# Code blocks in languages that the highlighter does not know stay as they are.
highlight_language = "none"
html_theme = "furo"
html_title = "Palpate"
html_static_path = [str(HERE / "static")]
html_css_files = ["house.css"]
html_show_sphinx = False
# A name is shown in the room whose door lists it.
autodoc_default_options = {"members": True, "imported-members": True, "undoc-members": False}
autodoc_typehints = "none"
autodoc_member_order = "bysource"
add_module_names = False
napoleon_custom_sections = ["Source", "Yields"]
napoleon_use_param = False
napoleon_use_ivar = True
napoleon_use_rtype = False
# Shapes such as (rows, columns) hold words that are names elsewhere: no links are wanted there.
suppress_warnings = ["ref.python"]


def _outside(app, page, source):
    """Links to files that are no pages become their names: the site holds pages alone."""

    def replaced(link: re.Match[str]) -> str:
        words, target = link[1], link[2]
        path = (Path(app.srcdir) / page).parent / target.partition("#")[0]
        inside = path.resolve().is_relative_to(Path(app.srcdir)) and path.suffix in (".md", ".png")
        return link[0] if inside or "://" in target or target.startswith("#") else words

    source[0] = re.sub(r"(?<!!)\[([^]]*)\]\(([^)\s]+)\)", replaced, source[0])


def _readable(app, what, name, target, options, lines):
    """Docstrings as Sphinx reads them: what follows a type on its line goes to the next, as do the
    lines that go on from there, names in backticks are code, shapes are no emphasis, the fields of
    a room are a list."""
    readable, in_section = [], False
    for line in lines:
        in_section = in_section or (bool(line) and set(line) == {"-"})
        entry = re.match(r"(\w[\w, ]*(?: : \S.*?)?)  +(\S.*)$", line) if in_section else None
        deep = in_section and line.startswith(" " * 5)
        goes_on = f"    {line.lstrip()}" if deep else line
        parts = [entry[1], f"    {entry[2]}"] if entry else [goes_on]
        readable += [_escaped(part) for part in parts]
    if what == "module":
        readable = [re.sub(r"^(\w[\w ]*?) +: ", r":\1: ", line) for line in readable]
    lines[:] = readable


def _skipped(app, what, name, member, skip, options):
    """Slots, which the list of attributes has already."""
    # What Sphinx has in place of a slot.
    return True if type(member).__name__ == "_Sentinel" else None


def _escaped(line):
    """A line with its code as code, and stars and bars elsewhere as they are."""
    parts = re.split(r"`+([^`]+)`+", line)
    plain = [re.sub(r"([*|])", r"\\\1", part) for part in parts[::2]]
    code = [f"``{part}``" for part in parts[1::2]]
    return "".join(part for pair in zip(plain, [*code, ""], strict=True) for part in pair)


def setup(app):
    """Have Sphinx call the functions above."""
    app.add_lexer("csv", TextLexer)
    app.connect("source-read", _outside)
    app.connect("autodoc-process-docstring", _readable, priority=400)
    app.connect("autodoc-skip-member", _skipped)

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
    """Docstrings as reStructuredText has them: shapes are no emphasis, bars no substitutions, the
    fields of a room a list."""
    lines[:] = [re.sub(r"(?<!`)([*|])", r"\\\1", line) for line in lines]
    if what == "module":
        lines[:] = [re.sub(r"^(\w[\w ]*?) +: ", r":\1: ", line) for line in lines]


def setup(app):
    """Have Sphinx call the functions above."""
    app.add_lexer("csv", TextLexer)
    app.connect("source-read", _outside)
    app.connect("autodoc-process-docstring", _readable, priority=400)

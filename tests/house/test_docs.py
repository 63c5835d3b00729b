"""The documents name files, pages and commands that exist."""

import re
import shlex
import tomllib

import pytest
from cyclopts import CycloptsError
from make_map import ROOT, SOURCE

from palpate.app.arguments import expanded_words, make_app
from palpate.lab import read_lab_config

PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")),
    *sorted(ROOT.glob("docs/**/*.md")),
]
# Of a guide, beside its tables and what is typed or printed.
_MOST_WORDS = 600
NAMES = [path.relative_to(ROOT).as_posix() for path in PAGES]


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_lead_somewhere(page):
    targets = re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
    files = [target for target in targets if "://" not in target]
    assert [file for file in files if not (page.parent / file).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_source_files_that_are_named_exist(page):
    named = re.findall(r"`([\w/]+/[\w/]*\.?\w*)`", page.read_text(encoding="utf-8"))
    named = [name for name in named if name.endswith((".py", "/"))]
    missing = [
        name for name in named if not any((folder / name).exists() for folder in (SOURCE, ROOT))
    ]
    assert missing == []


def commands():
    """Every `palpate ...` line of the documents' shell examples."""
    links = []
    for page in PAGES:
        blocks = re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        lines = [line.partition(" #")[0] for block in blocks for line in block.splitlines()]
        links += [line.partition("palpate ")[2] for line in lines if "palpate " in line]
    return links


@pytest.mark.parametrize("line", sorted(set(commands())))
def test_commands_are_understood(line):
    words = expanded_words(shlex.split(line))
    make_app().parse_args(words, exit_on_error=False, print_error=False)


def test_a_wrong_command_is_noticed():
    with pytest.raises(CycloptsError):
        make_app().parse_args(["fit", "s", "--colour"], exit_on_error=False, print_error=False)


def test_the_configuration_of_the_facility_is_read(tmp_path):
    page = (ROOT / "docs" / "howto" / "lab.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)
    path = tmp_path / "bench.toml"
    path.write_text(block, encoding="utf-8")
    config = read_lab_config(path)
    assert (config.name, len(config.probes)) == ("my bench", 1)


@pytest.mark.parametrize(
    "page",
    [
        "first_session",
        "flow",
        "giving_supports",
        "import",
        "scan",
        "session_keys",
        "sliding_supports",
        "tension",
    ],
)
def test_tables_in_the_guides_are_toml(page):
    text = (ROOT / "docs" / "howto" / f"{page}.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL)
    assert blocks
    assert all(tomllib.loads(block) for block in blocks)


@pytest.mark.parametrize("page", sorted(ROOT.glob("docs/howto/*.md")), ids=lambda page: page.stem)
def test_guides_are_short(page):
    text = re.sub("```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    words = [line.split() for line in text.splitlines() if not line.startswith("|")]
    assert sum(map(len, words)) <= _MOST_WORDS, "what is no step belongs into docs/details"

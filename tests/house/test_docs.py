"""The documents name files that exist, and link to pages that exist."""

import re

import pytest

from docs.developer.make_map import ROOT, SOURCE

PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *sorted(ROOT.glob("docs/**/*.md")),
]
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

"""Code blocks of the documents, and the lines of a shell."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def blocks(page, kind):
    """Code blocks of a page."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(rf"```{kind}\n(.*?)```", text, flags=re.DOTALL)


def lines(text):
    """Lines of a shell block, without comments."""
    bare = (line.partition(" #")[0].strip() for line in text.splitlines())
    return [line for line in bare if line]

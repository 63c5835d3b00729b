"""The notebooks run and tell what they do."""

import json
import runpy
from pathlib import Path

import matplotlib as mpl
import pytest

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(notebook, monkeypatch):
    monkeypatch.chdir(FOLDER)
    monkeypatch.setenv("PALPATE_EDGE", "20")
    # Each ends in what it found out, asserted.
    with mpl.rc_context({"backend": "agg"}):
        runpy.run_path(str(notebook), run_name="__main__")


@pytest.mark.parametrize("folder", [FOLDER, FOLDER.parents[1]], ids=["beside", "root"])
def test_the_examples_are_seen_from_anywhere_in_the_checkout(folder, monkeypatch):
    monkeypatch.chdir(folder)
    cells = json.loads((FOLDER / "beam.ipynb").read_text(encoding="utf-8"))["cells"]
    assert [cell["cell_type"] for cell in cells[:2]] == ["markdown", "code"]
    lines = [line for line in cells[1]["source"] if "palpate" not in line and line != "result"]
    names = {}
    exec("".join(lines), names)
    assert (names["EXAMPLES"] / "beam" / "session.toml").is_file()


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_tells_what_it_does(notebook):
    text = notebook.read_text(encoding="utf-8")
    assert text.startswith("# %% [markdown]\n# # ")
    assert text.count("\n# %%\n") >= 3
    assert "\nassert " in text
    assert f"`{notebook.name}`" in (FOLDER / "index.md").read_text(encoding="utf-8")

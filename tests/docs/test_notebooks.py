"""The notebooks run and tell what they do."""

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


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_tells_what_it_does(notebook):
    text = notebook.read_text(encoding="utf-8")
    assert text.startswith("# %% [markdown]\n# # ")
    assert text.count("\n# %%\n") >= 3
    assert "\nassert " in text
    assert f"`{notebook.name}`" in (FOLDER / "index.md").read_text(encoding="utf-8")

"""What the documents tell a reader to type or paste is run as it stands.

Commands of all pages are parsed, and tables read, by the tests of the house; here run the pages
that need no data of the reader's own, in test_guides.py those that do.
"""

import json
import re
import shlex
import shutil
import sys
import time
from pathlib import Path

import pytest
from docs.page_blocks import ROOT, blocks, lines

from palpate.app.cli import main
from palpate.bench import DeviceError, ForceSource
from palpate.records import TomlTable


def commands(text):
    """The `palpate` lines of a shell block, without the program's name and comments."""
    for line in lines(text):
        assert line.startswith("palpate ")
        yield shlex.split(line)[1:]


def test_the_first_session_gives_the_constants_that_it_says(here, capsys):
    page = "docs/howto/first_session.md"
    (script,) = blocks(page, "python")
    exec(script, {})
    session, *_ = blocks(page, "toml")
    (rows,) = blocks(page, "csv")
    (here / "foam_block" / "session.toml").write_text(session, encoding="utf-8")
    (here / "foam_block" / "top.csv").write_text(rows, encoding="utf-8")
    (shell,) = blocks(page, "sh")
    for words in commands(shell):
        assert main(words) == 0, words
    shown = " ".join(capsys.readouterr().out.split())
    (promised,) = blocks(page, "text")
    for line in promised.splitlines():
        # The last digits of a table may differ from machine to machine.
        for word in line.split():
            if not any(letter.isdigit() for letter in word):
                assert word in shown
    estimate = json.loads(
        (here / "foam_block-result" / "estimate.json").read_text(encoding="utf-8")
    )
    # `check` foresaw it.
    for name, size in (("Young's modulus", 0.01 * 50e3), ("Poisson's ratio", 1.0)):
        (foreseen,) = re.findall(rf"{name} to about ([0-9.]*[0-9])", shown)
        std = estimate[name.lower().replace("'s", "").replace(" ", "_")]["std"]
        assert 0.5 < float(foreseen) * size / std < 2.0
    # The block's own 50 kPa and 0.3: within the printed 95 % interval, as the page says.
    for name, truth in (("young_modulus", 50e3), ("poisson_ratio", 0.3)):
        low, high = estimate[name]["ci95"]
        assert low < truth < high
        # Little more than a tenth wide: the session is no bad example.
        assert high - low < 0.11 * truth
    assert (here / "foam_block-result" / "report.html").exists()


@pytest.mark.slow
def test_one_camera_from_above_tells_the_constants_too(here):
    page = "docs/howto/first_session.md"
    (script,) = blocks(page, "python")
    exec(script, {})
    session, *_ = blocks(page, "toml")
    head, *rows = blocks(page, "csv")[0].splitlines()
    flat = [",".join([*row.split(",")[:5], "nan"]) for row in rows]
    (here / "foam_block" / "session.toml").write_text(session, encoding="utf-8")
    (here / "foam_block" / "top.csv").write_text("\n".join([head, *flat]) + "\n")
    assert main(["check", "foam_block"]) == 0
    assert main(["fit", "foam_block"]) == 0
    estimate = json.loads(
        (here / "foam_block-result" / "estimate.json").read_text(encoding="utf-8")
    )
    for name, truth in (("young_modulus", 50e3), ("poisson_ratio", 0.3)):
        low, high = estimate[name]["ci95"]
        assert low < truth < high
        assert high - low < 0.2 * truth
    assert estimate["probes"][0]["observed"] == 16


def test_one_measured_point_is_named_as_the_cause(here, capsys):
    page = "docs/howto/first_session.md"
    (script,) = blocks(page, "python")
    exec(script.replace("7.5", "15"), {})
    session, *_ = blocks(page, "toml")
    (rows,) = blocks(page, "csv")
    head, first, *_ = rows.splitlines()
    (here / "foam_block" / "session.toml").write_text(session, encoding="utf-8")
    (here / "foam_block" / "top.csv").write_text(f"{head}\n{first}\n", encoding="utf-8")
    assert main(["fit", "foam_block"]) == 3
    assert "One point was measured in all" in " ".join(capsys.readouterr().out.split())


def test_what_the_readme_does_in_python_runs(here, capsys):
    # A coarse block in the place of the half ball, whose six probings take ten times as long.
    page = "docs/howto/first_session.md"
    (make,) = blocks(page, "python")
    corners = "[[0, 0, 0], [60, 60, 40]]"
    assert corners in make
    exec(make.replace(corners, "[[-30, -30, -10], [30, 30, 30]]").replace("7.5", "15"), {})
    session, *_ = blocks(page, "toml")
    moved = {"[0, 0, 0]": "[0, 0, -10]", "[24.0, 30.0, 40.0]": "[0, 0, 30]", '"top"': '"p4"'}
    for before, after in moved.items():
        assert before in session
        session = session.replace(before, after)
    folder = here / "examples" / "half_ball"
    shutil.copytree(here / "foam_block", folder)
    (folder / "session.toml").write_text(session, encoding="utf-8")
    (rows,) = blocks(page, "csv")
    head, *lines = rows.splitlines()
    points = [
        ",".join([f"{float(x) - 30}" for x in line.split(",")[:2]] + line.split(",")[2:])
        for line in lines
        if line.split(",")[2] == "40.0"
    ]
    text = "\n".join([head, *(line.replace("40.0", "30.0") for line in points), ""])
    (folder / "top.csv").write_text(text, encoding="utf-8")
    (script,) = blocks("README.md", "python")
    exec(script, {})
    shown = capsys.readouterr().out
    assert "Young's modulus" in shown
    assert "PokedState: the contact moves by (" in shown
    assert {"half_ball.html", "p4.png"} <= {path.name for path in here.iterdir()}


def test_the_first_screens_of_the_readme_leave_few_choices():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 80
    assert len(re.findall(r"\]\(", text)) <= 10
    assert sum(len(lines(block)) for block in blocks("README.md", "sh")) <= 6


def test_the_driver_of_the_guide_keeps_the_laws():
    """A program that prints 1.5 N every hundredth of a second stands in for the gauge."""
    source, line = blocks("docs/howto/driver.md", "python")
    names = {"FORCE_DRIVERS": {}, "TomlTable": TomlTable}
    exec(source, names)
    exec(line, names)
    code = "import time\nfor _ in range(60): print(1.5, flush=True); time.sleep(0.01)"
    values = {"command": [sys.executable, "-c", code]}
    gauge = names["FORCE_DRIVERS"]["pipe"](TomlTable(Path("bench.toml"), "[force]", values))
    assert isinstance(gauge, ForceSource)
    # Twice: again after an interruption.
    for _ in range(2):
        gauge.start()
        times, forces, end = [], [], time.monotonic() + 20.0
        while len(forces) < 60 and time.monotonic() < end:
            when, newtons = gauge.read()
            times += when.tolist()
            forces += newtons.tolist()
        gauge.process.wait()
        with pytest.raises(DeviceError, match="has ended; see that the gauge is on"):
            gauge.read()
        assert forces == [1.5] * 60
        assert times == sorted(times)
        gauge.close()
        gauge.close()

"""Every line of the shell blocks of docs/howto is run, against small files of what it speaks of.

`first_session.md` is run by test_blocks.py, with what it promises.
"""

import shlex
import subprocess

import pytest
from docs.guide_files import GUIDES
from docs.page_blocks import ROOT, blocks, lines

from palpate.app.cli import main

PAGES = {
    path.stem: path.relative_to(ROOT).as_posix()
    for path in sorted((ROOT / "docs" / "howto").glob("*.md"))
    if path.stem != "first_session" and "```sh\n" in path.read_text(encoding="utf-8")
}
# What no test can run, and why. Nothing else is left out.
_INSTALLS = "installs from the network what the tests have"
_STAYS = "serves a page for a browser until it is interrupted; tests/viewer opens one"
_KEYS = "makes a key with a program that not every machine has"
_CLUSTER = "needs several machines; tests/campaign runs a scheduler and workers on this one"
_DEVICES = "needs cameras and a scale; tests/bench plays them"
NOT_RUN = {
    "pip install 'palpate[surface]'": _INSTALLS,
    "pip install 'palpate[view]'": _INSTALLS,
    "palpate measure . --out sponge --until 'E 5 %'": _DEVICES,
    "palpate view examples/half_ball": _STAYS,
    "palpate view half_ball": _STAYS,
    "openssl req -x509 -newkey rsa:2048 -nodes -days 365 -subj /CN=dask"
    " -keyout dask.key -out dask.crt": _KEYS,
    "dask scheduler": _CLUSTER,
    "dask worker tls://192.168.1.7:8786 --nworkers auto --nthreads 1": _CLUSTER,
    "palpate campaign apples.txt --scheduler tls://192.168.1.7:8786": _CLUSTER,
}
# A minute or so each; their commands have tests of their own.
_LONG = {
    "calibrate",
    "campaign",
    "export",
    "flow",
    "lab",
    "measure",
    "moved_camera",
    "next",
    "poke",
    "record",
    "results",
    "scan",
}
RUNNABLE = [pytest.param(name, marks=pytest.mark.slow) if name in _LONG else name for name in PAGES]


@pytest.mark.parametrize("name", RUNNABLE)
def test_the_commands_of_a_guide_run(name, here, capsys):
    assert name in GUIDES, f"{PAGES[name]} has commands: make the files that they need"
    steps = GUIDES[name](here)
    for block in blocks(PAGES[name], "sh"):
        run = next(steps) or set()
        assert run <= set(lines(block))
        for line in lines(block):
            if line not in NOT_RUN and line not in run:
                assert exit_code(line) == 0, f"{line}\n{capsys.readouterr().err}"
    assert next(steps, "no block left") == "no block left"


def exit_code(line):
    """Run a line as a shell in this folder would, `palpate` in this process."""
    words = shlex.split(line)
    if words[0] == "palpate":
        return main(words[1:])
    return subprocess.run(words, check=False).returncode


def test_only_what_guides_say_is_left_out():
    said = {
        line for page in PAGES.values() for block in blocks(page, "sh") for line in lines(block)
    }
    assert set(NOT_RUN) <= said


def test_a_wrong_command_is_noticed(here, capsys):
    assert exit_code("palpate fit nowhere") == 2
    assert exit_code("false") == 1

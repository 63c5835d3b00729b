"""A whole push through real transports: the command at a terminal, cameras that another process
serves on loopback, and a gauge on a pty."""

import os
import re
import select
import subprocess
import sys

import numpy as np
import pytest
from bench.drawn_world import small_config
from bench.played_bench import played_bench

from palpate.records import read_session

# A fit on a busy machine [s].
PATIENCE = 200.0
# What a person at the terminal answers to what is asked.
ANSWERS = (
    (r"in which unit\?", "mm"),
    (r"Which side does it stand on", ""),
    (r"How does it stand there\?", "glued or taped"),
    (r"What presses\?", "ball"),
    (r"Radius of the ball", f"{1e3 * small_config().arm.radius:g}"),
)


class Person:
    """Reads a command's output, and answers."""

    def __init__(self, command):
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
                              "PYTHONUNBUFFERED": "1", "COLUMNS": "500", "NO_COLOR": "1"},
        )  # fmt: skip
        self.text, self.read, self.answered = "", 0, 0

    def until(self, *patterns):
        """The number of the pattern that is said next, and its match; None at the end."""
        while True:
            found = [(m.start(), k, m) for k, pattern in enumerate(patterns)
                     if (m := re.search(pattern, self.text[self.read:]))]  # fmt: skip
            if found:
                _, k, match = min(found, key=lambda item: item[0])
                self.read += match.end()
                return k, match
            ready = select.select([self.process.stdout], [], [], PATIENCE)[0]
            assert ready, f"nothing more was said: {self.text}"
            piece = os.read(self.process.stdout.fileno(), 65536)
            if not piece:
                return None, None
            self.text += piece.decode()

    def answer(self, text):
        self.answered += 1
        self.process.stdin.write(f"{text}\n".encode())
        self.process.stdin.flush()


@pytest.mark.slow
def test_a_push_by_the_command_over_http_and_a_serial_line(tmp_path):
    pytest.importorskip("serial", reason="needs pyserial, the extra `gauge`")
    out = tmp_path / "session"
    with played_bench(tmp_path) as player:
        person = Person(
            [sys.executable, "-m", "palpate", "measure", str(tmp_path), "--out", str(out),
             "--terminal", "--pushes", "1"]
        )  # fmt: skip
        try:
            force = pressing(person, player)
            assert person.process.wait(timeout=60) == 0, person.text
        finally:
            person.process.kill()
            person.process.stdin.close()
            person.process.stdout.close()
            person.process.wait()
    # Five answers about the object, and one Enter for the push; with the command seven steps.
    assert person.answered == 6, person.text
    session = read_session(out)
    (probing,) = session.probings
    # Two cameras, at rest and under load.
    assert len(list((out / "images").iterdir())) == 4
    # Noise of 0.2 % in each reading, and half as many readings of the zero.
    assert np.linalg.norm(probing.force) == pytest.approx(force, rel=0.01)
    young = float(re.search(r"E = ([\d.]+) kPa", person.text)[1])
    # The gauge's gain has 1 %; elements of 12 mm make the body stiffer by some per cent.
    assert young == pytest.approx(1e-3 * small_config().material.young_modulus, rel=0.1)


def pressing(person, player):
    """Answer and press until the command ends; gives the force [N]."""

    def say(text):
        player.stdin.write(f"{text}\n")
        player.stdin.flush()

    near = r"Next push: near \[([^\]]+)\] mm; then Enter"
    patterns = [pattern for pattern, _ in ANSWERS]
    force = 0.0
    while True:
        k, match = person.until(*patterns, near, "Press straight in near", "Got it: lift off")
        if k is None:
            return force
        if k < len(ANSWERS):
            person.answer(ANSWERS[k][1])
        elif k == len(ANSWERS):
            say("aim " + match[1].replace(",", " "))
            force = float(player.stdout.readline().removeprefix("aimed "))
            person.answer("")
        else:
            say("press" if k == len(ANSWERS) + 1 else "lift")

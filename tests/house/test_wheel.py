"""A wheel holds all that the program reads of itself, and nothing else."""

import re
import subprocess
import sys
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# More, and something is in it that belongs beside it.
MOST_BYTES = 1_500_000


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=ROOT, check=True, capture_output=True, timeout=120,
    )  # fmt: skip
    (wheel_file,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel_file) as opened:
        yield wheel_file, opened


def test_every_file_of_the_source_is_in_it(wheel):
    _, opened = wheel
    source = ROOT / "src"
    expected = {
        path.relative_to(source).as_posix()
        for path in (source / "palpate").rglob("*")
        if path.is_file() and path.suffix not in (".pyc", ".nbi", ".nbc")
    }
    inside = {name for name in opened.namelist() if ".dist-info/" not in name}
    assert inside == expected
    # Templates and configurations, which no import would miss.
    assert {Path(name).suffix for name in inside} >= {".py", ".html", ".js", ".css", ".toml"}
    assert "palpate/py.typed" in inside


def test_it_is_small(wheel):
    path, _ = wheel
    assert path.stat().st_size < MOST_BYTES


def test_what_it_says_of_itself(wheel):
    _, opened = wheel
    (name,) = [name for name in opened.namelist() if name.endswith("/METADATA")]
    said = Parser().parsestr(opened.read(name).decode())
    needed = [line for line in said.get_all("Requires-Dist") if "extra ==" not in line]
    heavy = ("viser", "mitsuba", "mujoco", "libigl", "playwright", "sphinx", "pytest")
    assert [line for line in needed if line.startswith(heavy)] == []
    extras = set(said.get_all("Provides-Extra"))
    assert extras == {
        "all",
        "bags",
        "batch",
        "cad",
        "e57",
        "gauge",
        "genicam",
        "hdf5",
        "lab",
        "parquet",
        "realsense",
        "surface",
        "ur",
        "view",
    }
    of_extra = {
        extra: {
            re.match(r"[\w-]+", line)[0]
            for line in said.get_all("Requires-Dist")
            if line.endswith(f"extra == '{extra}'")
        }
        for extra in extras
    }
    # Libraries of single makers are not there for every platform.
    makers = set().union(*(of_extra.pop(extra) for extra in ("genicam", "realsense", "ur")))
    assert makers == {"harvesters", "pyrealsense2", "ur-rtde"}
    assert of_extra["all"] == set().union(*of_extra.values())
    assert said["License-Expression"] == "BSD-3-Clause"
    points = opened.read(name.replace("METADATA", "entry_points.txt")).decode()
    assert "palpate = palpate.__main__:main" in points

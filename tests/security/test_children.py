"""Processes that Palpate starts load no code from the current folder, which may be anybody's."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from drawn_ball import MILLIMETRE, written_ball

from palpate.campaign import started_engine
from palpate.geometry import read_mesh
from palpate.lab import scene

# Modules that children import before or after they have set their path.
MODULES = ("cascadio", "ctypes", "drjit", "multiprocessing", "pickle", "selectors", "threading",
           "distributed", "numpy", "encodings", "sitecustomize")  # fmt: skip


@pytest.fixture
def stranger(tmp_path, monkeypatch):
    """A current folder with modules of a stranger, which leave a trace where they are loaded."""
    folder, trace = tmp_path / "downloads", tmp_path / "trace"
    folder.mkdir()
    for name in MODULES:
        (folder / f"{name}.py").write_text(f"open({str(trace)!r}, 'a').write('{name}')\n")
    monkeypatch.chdir(folder)
    return trace


def test_modules_of_the_current_folder_are_loaded_by_a_plain_child(stranger):
    """Or this file's other tests would prove nothing."""
    environment = {name: text for name, text in os.environ.items() if name != "PYTHONSAFEPATH"}
    subprocess.run([sys.executable, "-c", "import ctypes"], env=environment, check=False)
    assert stranger.read_text() == "ctypes"


def test_a_step_file_is_converted_by_the_installed_package(stranger, tmp_path):
    pytest.importorskip(
        "cascadio", reason="needs cascadio, the extra `cad`, which is not installed"
    )
    assert len(read_mesh(written_ball(tmp_path, MILLIMETRE)).vertices) > 1000
    assert not stranger.exists()


def test_a_library_is_tried_with_the_installed_packages(stranger, tmp_path):
    fit, finding = scene._try(tmp_path / "libLLVM.so")
    assert (fit, finding) == (False, "cannot be loaded")
    for library in scene.llvm_candidates()[:1]:
        scene._try(library)
    assert not stranger.exists()


@pytest.mark.slow
def test_workers_load_what_this_process_has(stranger):
    before = dict(os.environ)
    with started_engine(None, 1) as workers:
        assert list(workers.map(_origin, ["ctypes"])) == [_origin("ctypes")]
    assert not stranger.exists()
    assert dict(os.environ) == before


def _origin(name):
    return str(Path(__import__(name).__file__))

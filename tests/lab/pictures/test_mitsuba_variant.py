"""Choice of Mitsuba's variant: no library, broken or too old, ever ends the process."""

import importlib
import sys
from types import ModuleType

import pytest

from palpate.errors import InputError
from palpate.lab import scene
from palpate.lab.scene import (
    LLVM_SETTING,
    Variant,
    choose_variant,
    llvm_candidates,
    load_mitsuba,
)

# Stands for a compiler that works, that ends the process, or that hangs.
_FIT = 'import sys; print("LLVM 99.0.0")'
_CRASH = "import os; os.abort()"
_UNKNOWN = "raise RuntimeError"


@pytest.fixture
def libraries(tmp_path):
    """A folder with files named like LLVM's libraries, none of which is one."""
    for name in ("libLLVM-9.so", "libLLVM-17.so.1", "libLLVM.so.19.1", "libLLVMCore.a", "libc.so"):
        (tmp_path / name).write_text("no library")
    return tmp_path


def test_candidates_come_newest_first_and_only_once(libraries):
    (libraries / "libLLVM-19.so").symlink_to(libraries / "libLLVM.so.19.1")
    found = llvm_candidates([str(libraries), str(libraries.parent / "*"), "relative", "Z:/none"])
    assert [file.name for file in found] == ["libLLVM.so.19.1", "libLLVM-17.so.1", "libLLVM-9.so"]


def test_a_file_that_is_no_library_leaves_the_scalar_variant(libraries):
    variant = choose_variant(folders=[str(libraries)], environment={})
    assert variant.name == "scalar_rgb"
    assert variant.llvm is None
    assert "libLLVM-17.so.1 cannot be loaded" in variant.why
    assert "\n" not in variant.why


def test_nothing_found_says_how_to_speed_up():
    variant = choose_variant(folders=(), environment={})
    assert variant.name == "scalar_rgb"
    assert "no LLVM library found" in variant.why
    assert LLVM_SETTING in variant.why


def test_a_library_without_the_version_of_llvm_16_is_too_old():
    # Any library that has not LLVMGetVersion: the interpreter's own extension modules.
    library = next(
        str(module.__file__)
        for module in list(sys.modules.values())
        if str(getattr(module, "__file__", "")).endswith(".so")
    )
    variant = choose_variant(folders=(), environment={LLVM_SETTING: library})
    assert variant.name == "scalar_rgb"
    assert f"{library} is older than LLVM 16" in variant.why


@pytest.mark.parametrize("trial", [_CRASH, _UNKNOWN])
def test_a_compiler_that_fails_costs_only_its_own_process(libraries, monkeypatch, trial):
    monkeypatch.setattr(scene, "_TRIAL", trial)
    variant = choose_variant(folders=[str(libraries)], environment={})
    assert variant.name == "scalar_rgb"
    assert "libLLVM-9.so fails in Mitsuba's compiler" in variant.why


def test_a_compiler_that_hangs_is_given_up(libraries, monkeypatch):
    monkeypatch.setattr(scene, "_TRIAL", "import time; time.sleep(60)")
    monkeypatch.setattr(scene, "_TIMEOUT_S", 0.2)
    variant = choose_variant(folders=[str(libraries)], environment={})
    assert "could not be tried" in variant.why


def test_a_fit_library_is_taken_and_the_users_own_is_asked_first(libraries, monkeypatch):
    monkeypatch.setattr(scene, "_TRIAL", _FIT)
    newest = libraries / "libLLVM.so.19.1"
    variant = choose_variant(folders=[str(libraries)], environment={})
    assert variant == Variant("llvm_ad_rgb", f"Mitsuba renders with LLVM 99.0.0 ({newest})", newest)
    own = libraries / "libLLVM-9.so"
    variant = choose_variant(folders=[str(libraries)], environment={LLVM_SETTING: str(own)})
    assert variant.llvm == own


def test_loading_tells_the_compiler_its_library_and_keeps_the_variant(monkeypatch):
    chosen = []

    fake = ModuleType("mitsuba")
    fake.variant = lambda: chosen[-1] if chosen else None
    fake.set_variant = chosen.append
    monkeypatch.setattr(scene, "late_import", lambda *_, **__: fake)
    monkeypatch.setenv(LLVM_SETTING, "before")
    variant = Variant("llvm_ad_rgb", "", scene.Path("/some/libLLVM.so"))
    load_mitsuba(variant)
    load_mitsuba(variant)
    assert chosen == ["llvm_ad_rgb"]
    assert scene.os.environ[LLVM_SETTING] == str(variant.llvm)


def test_missing_mitsuba_names_the_extra(monkeypatch):
    def absent(name):
        raise ModuleNotFoundError(name=name)

    late = importlib.import_module("palpate.optional_imports")
    monkeypatch.setattr(late, "import_module", absent)
    with pytest.raises(InputError, match=r"pip install 'palpate\[lab\]'"):
        load_mitsuba(Variant("scalar_rgb", "", None))

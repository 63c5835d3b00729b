"""Choice of Mitsuba's variant: no library, broken or too old, ever ends the process."""

import importlib
import sys
from types import ModuleType

import pytest

from palpate.errors import InputError
from palpate.lab.pictures import mitsuba_variant
from palpate.lab.pictures.mitsuba_variant import (
    LLVM_SETTING,
    Variant,
    choose_variant,
    load_mitsuba,
)

# Stands for Dr.Jit with an LLVM of some version, whose kernels give what is asked for.
_DRJIT = """
import sys, types
drjit = types.ModuleType("drjit")
drjit.JitBackend = types.SimpleNamespace(LLVM=1)
drjit.has_backend = lambda backend: True
drjit.detail = types.SimpleNamespace(llvm_version=lambda: {version})
drjit.llvm = types.ModuleType("drjit.llvm")
class Float(list):
    def __add__(self, other):
        return {sums}
drjit.llvm.Float = Float
sys.modules.update({{"drjit": drjit, "drjit.llvm": drjit.llvm}})
"""


def _with_llvm(monkeypatch, version=(18, 1, 3), sums=(2.0, 3.0)):
    """The trial itself, on a compiler of our own."""
    fake = _DRJIT.format(version=version, sums=list(sums))
    monkeypatch.setattr(mitsuba_variant, "_TRIAL", fake + mitsuba_variant._TRIAL)


@pytest.mark.parametrize("version", [(16, 0, 0), (18, 1, 3)])
def test_a_fit_library_is_taken(monkeypatch, version):
    _with_llvm(monkeypatch, version)
    name = ".".join(map(str, version))
    assert choose_variant() == Variant("llvm_ad_rgb", f"Mitsuba renders with LLVM {name}")


def test_a_library_before_llvm_16_is_too_old(monkeypatch):
    _with_llvm(monkeypatch, (15, 0, 7))
    variant = choose_variant()
    assert variant.name == "scalar_rgb"
    assert "than with LLVM: LLVM 15.0.7 is older than LLVM 16. To speed up" in variant.why


def test_a_library_that_computes_wrongly_is_refused(monkeypatch):
    _with_llvm(monkeypatch, sums=(2.0, 4.0))
    variant = choose_variant()
    assert variant.name == "scalar_rgb"
    assert "LLVM 18.1.3 computes wrongly" in variant.why


def test_nothing_found_says_how_to_speed_up(monkeypatch, tmp_path):
    # Dr.Jit itself, with a library that is none.
    monkeypatch.setenv(LLVM_SETTING, str(tmp_path / "libLLVM.so"))
    variant = choose_variant()
    assert variant.name == "scalar_rgb"
    assert "no LLVM library found" in variant.why
    assert LLVM_SETTING in variant.why
    assert "\n" not in variant.why


# A compiler that ends the process, or fails in a way that nobody foresaw.
@pytest.mark.parametrize("trial", ["import os; os.abort()", "raise RuntimeError"])
def test_a_compiler_that_fails_costs_only_its_own_process(monkeypatch, trial):
    monkeypatch.setattr(mitsuba_variant, "_TRIAL", trial)
    variant = choose_variant()
    assert variant.name == "scalar_rgb"
    assert "LLVM fails in Mitsuba's compiler" in variant.why


def test_a_compiler_that_hangs_is_given_up(monkeypatch):
    monkeypatch.setattr(mitsuba_variant, "_TRIAL", "import time; time.sleep(60)")
    monkeypatch.setattr(mitsuba_variant, "_TIMEOUT_S", 0.2)
    assert "could not be tried" in choose_variant().why


def test_an_interpreter_that_cannot_be_started_leaves_the_scalar_variant(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    assert choose_variant().name == "scalar_rgb"


def test_loading_keeps_the_variant(monkeypatch):
    chosen = []

    fake = ModuleType("mitsuba")
    fake.variant = lambda: chosen[-1] if chosen else None
    fake.set_variant = chosen.append
    monkeypatch.setattr(mitsuba_variant, "late_import", lambda *_, **__: fake)
    for _ in range(2):
        load_mitsuba(Variant("llvm_ad_rgb", ""))
    assert chosen == ["llvm_ad_rgb"]


def test_missing_mitsuba_names_the_extra(monkeypatch):
    def absent(name):
        raise ModuleNotFoundError(name=name)

    late = importlib.import_module("palpate.optional_imports")
    monkeypatch.setattr(late, "import_module", absent)
    with pytest.raises(InputError, match=r"pip install 'palpate\[lab\]'"):
        load_mitsuba(Variant("scalar_rgb", ""))

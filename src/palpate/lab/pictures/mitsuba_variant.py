"""Which of Mitsuba's variants can run here: LLVM where a fit library is found, else the scalar.

Mitsuba's compiler, Dr.Jit, loads an LLVM library of the system at run time, and an unfit one ends
the whole process: versions below 16 fail on processors with AVX-512 as soon as a kernel is large.
So the library that it finds is tried in a process of its own, and never loaded here if it fails.
"""

import subprocess
import sys
from dataclasses import dataclass
from types import ModuleType

from palpate.optional_imports import late_import

# Environment variable by which Dr.Jit is told its LLVM library.
LLVM_SETTING = "DRJIT_LIBLLVM_PATH"
# Prints the version of LLVM, or what is wrong with it and ends with an error. The kernel is the
# proof that the compiler can use it.
_TRIAL = """
import sys, drjit
def refuse(reason):
    print(reason)
    sys.exit(1)
if not drjit.has_backend(drjit.JitBackend.LLVM):
    refuse("no LLVM library found")
version = drjit.detail.llvm_version()
name = "LLVM " + ".".join(map(str, version))
if version[0] < 16:
    refuse(name + " is older than LLVM 16")
import drjit.llvm
if list(drjit.llvm.Float([1.0, 2.0]) + 1.0) != [2.0, 3.0]:
    refuse(name + " computes wrongly")
print(name)
"""
# A trial takes 0.5 s; after forty times that the machine hangs.
_TIMEOUT_S = 20.0


@dataclass(frozen=True, slots=True)
class Variant:
    """A variant of Mitsuba that runs on this machine.

    Attributes
    ----------
    name : str                      as Mitsuba calls it
    why : str                       one line for the user
    """

    name: str
    why: str


def choose_variant() -> Variant:
    """Choose Mitsuba's fastest variant that is sure to work here; never fails.

    Returns
    -------
    Variant                         llvm_ad_rgb with a fit LLVM, else scalar_rgb
    """
    fit, finding = _try_llvm()
    if fit:
        return Variant("llvm_ad_rgb", f"Mitsuba renders with {finding}")
    return Variant(
        "scalar_rgb",
        f"Mitsuba renders with its scalar variant, slower than with LLVM: {finding}."
        f" To speed up: install LLVM 16 or newer, or set {LLVM_SETTING} to its library",
    )


def load_mitsuba(variant: Variant) -> ModuleType:
    """Import Mitsuba and make a variant current, for the whole process: Mitsuba has but one.

    Parameters
    ----------
    variant : Variant               of `choose_variant`

    Returns
    -------
    module

    Raises
    ------
    InputError                      Mitsuba is not installed
    """
    mitsuba = late_import("mitsuba", extra="lab", purpose="rendering pictures")
    if mitsuba.variant() != variant.name:
        mitsuba.set_variant(variant.name)
    return mitsuba


def _try_llvm() -> tuple[bool, str]:
    """Whether Mitsuba's compiler works with the LLVM that it finds; its version, or its fault."""
    try:
        trial = subprocess.run(
            [sys.executable, "-c", _TRIAL],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False, "LLVM could not be tried"
    found = trial.stdout.strip() or "LLVM fails in Mitsuba's compiler"
    return trial.returncode == 0, found

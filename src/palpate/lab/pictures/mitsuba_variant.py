"""Choice of the Mitsuba variant: LLVM if a compatible library is found, else scalar.

Mitsuba's compiler loads an LLVM library of the system at run time, and an incompatible one crashes
the whole process: versions below 16 fail on processors with AVX-512 once a kernel is large. So
candidates are tested in a subprocess, and those that fail are never loaded here.
"""

import os
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from glob import glob
from pathlib import Path
from types import ModuleType

from palpate.optional_imports import late_import

# Environment variable that names the LLVM library for Mitsuba's compiler.
LLVM_SETTING = "DRJIT_LIBLLVM_PATH"
# Where systems keep LLVM: Debian, Fedora and Arch, own builds, Homebrew, Windows.
LLVM_FOLDERS = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/lib64",
    "/usr/lib64/llvm*/lib*",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm*/lib",
    "/usr/local/opt/llvm*/lib",
    "C:/Program Files/LLVM/bin",
)
_LIBRARY = re.compile(r"(libLLVM([-.][\d.]+)?\.(so|dylib)[\d.]*|LLVM-C\.dll)")
# Prints what is wrong with the library of argument 1, or "LLVM <version>" if nothing is.
# With -P, or a drjit.py in the current folder would be run; -I would lose the user's own packages.
# LLVMGetVersion exists from LLVM 16 on. The kernel is the proof that Mitsuba's compiler can use it.
_TRIAL = """
import ctypes, sys
try:
    get = ctypes.CDLL(sys.argv[1]).LLVMGetVersion
except OSError:
    sys.exit("cannot be loaded")
except AttributeError:
    sys.exit("is older than LLVM 16")
version = (ctypes.c_uint * 3)()
get(*(ctypes.byref(version, 4 * k) for k in range(3)))
import drjit, drjit.llvm
# LLVM 16 adds, but aborts the process at a maximum.
if list(drjit.maximum(drjit.llvm.Float([1.0, 2.0]) + 1.0, 2.5)) != [2.5, 3.0]:
    sys.exit("computes wrongly")
print("LLVM", ".".join(map(str, version)))
"""
# A trial takes 0.2 s; one that takes a hundred times as long counts as hung.
_TIMEOUT_S = 20.0


@dataclass(frozen=True, slots=True)
class Variant:
    """A variant of Mitsuba that runs on this machine.

    Attributes
    ----------
    name : str                      as Mitsuba calls it
    why : str                       one line for the user
    llvm : Path or None             library that it compiles with; None for the scalar variant
    """

    name: str
    why: str
    llvm: Path | None


def choose_variant(
    *,
    folders: Iterable[str] = LLVM_FOLDERS,
    environment: Mapping[str, str] | None = None,
) -> Variant:
    """Choose the fastest variant of Mitsuba that is known to work here; never fails.

    Parameters
    ----------
    folders : patterns of folders   searched for LLVM libraries, newest version first
    environment : mapping or None   the library in its DRJIT_LIBLLVM_PATH is tried first; None: the
                                    environment of the process

    Returns
    -------
    Variant                         llvm_ad_rgb with a compatible LLVM, else scalar_rgb
    """
    setting = (os.environ if environment is None else environment).get(LLVM_SETTING, "")
    candidates = ([Path(setting)] if setting else []) + llvm_candidates(folders)
    unfit = []
    for library in candidates:
        fit, finding = _try(library)
        if fit:
            return Variant("llvm_ad_rgb", f"Mitsuba renders with {finding} ({library})", library)
        unfit.append(f"{library} {finding}")
    reason = "; ".join(unfit) if unfit else "no LLVM library found"
    return Variant(
        "scalar_rgb",
        f"Mitsuba renders with its scalar variant, slower than with LLVM: {reason}."
        f" To speed up: install LLVM 16 or newer, or set {LLVM_SETTING} to its library",
        None,
    )


def llvm_candidates(folders: Iterable[str] = LLVM_FOLDERS) -> list[Path]:
    """LLVM libraries in some folders, the newest version first, each file once.

    Parameters
    ----------
    folders : patterns of folders   absolute, with wild cards

    Returns
    -------
    list of Path                    by the version in the file's own name
    """
    found = {
        Path(file).resolve()
        for folder in folders
        for file in glob(f"{folder}/*LLVM*")
        if _LIBRARY.fullmatch(Path(file).name)
    }
    return sorted(found, key=lambda file: (_version(file), str(file)), reverse=True)


def load_mitsuba(variant: Variant) -> ModuleType:
    """Import Mitsuba and activate a variant, which applies to the whole process.

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
    if variant.llvm is not None:
        os.environ[LLVM_SETTING] = str(variant.llvm)
    mitsuba = late_import("mitsuba", extra="lab", purpose="rendering pictures")
    if mitsuba.variant() != variant.name:
        mitsuba.set_variant(variant.name)
    return mitsuba


def _version(library: Path) -> tuple[int, ...]:
    """Version in the file name of a library; empty if there is none."""
    return tuple(int(number) for number in re.findall(r"\d+", library.name))


def _try(library: Path) -> tuple[bool, str]:
    """Whether Mitsuba's compiler works with a library, and its version or what is wrong."""
    try:
        trial = subprocess.run(
            [sys.executable, "-P", "-c", _TRIAL, str(library)],
            capture_output=True,
            text=True,
            errors="replace",
            env={**os.environ, LLVM_SETTING: str(library)},
            timeout=_TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False, "could not be tried"
    if trial.returncode == 0:
        return True, trial.stdout.strip()
    if trial.returncode == 1 and "Traceback" not in trial.stderr:
        return False, trial.stderr.strip()
    return False, "fails in Mitsuba's compiler"

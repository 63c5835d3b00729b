"""Versions of Palpate and of what its numbers depend on."""

import platform
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version

import palpate

# Without these no estimate is the same again.
_PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless", "matplotlib")


def versions() -> dict[str, str]:
    """Versions by the names of what has them, the system's last."""
    found = {"palpate": palpate.__version__, "Python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found | {"system": platform.platform()}

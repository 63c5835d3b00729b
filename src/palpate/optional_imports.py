"""Deferred import of modules that are optional, or too slow to load before they are needed."""

import shlex
import sys
from importlib import import_module
from types import ModuleType

from palpate.errors import InputError


def late_import(module: str, *, extra: str | None, purpose: str) -> ModuleType:
    """Import a module at its first use.

    Parameters
    ----------
    module : str                    dotted name
    extra : str or None             extra of Palpate that installs it; None: a core dependency
    purpose : str                   what it is needed for, for the error message

    Returns
    -------
    module

    Raises
    ------
    InputError                      not installed; the text says what to install
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module.partition(".")[0]:
            raise
        wanted = f"palpate[{extra}]" if extra else "palpate"
        raise InputError(
            f"{purpose} needs the package '{module}', which is not installed;"
            f" run: {shlex.quote(sys.executable)} -m pip install '{wanted}'"
        ) from error

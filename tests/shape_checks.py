"""Shapes and types are checked in the first call of every function within every test.

A check looks at every argument and at what comes back, which takes some 100 us; a fit calls small
functions ten thousand times. What the hundredth call of a loop is given has the shapes that the
first was given; checking four calls of each makes the tests take a tenth longer. Checkers are made
when they are first needed: for most functions that a process imports they never are, and functions
within functions would have theirs made with every call.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import Any

import jaxtyping

_checked_whole = jaxtyping.jaxtyped
# Functions that were called, by the identity of their code, which functions within functions share.
_called: set[int] = set()


def check_first_calls() -> None:
    """Have the import hook check first calls only: to be called before it imports anything."""
    jaxtyping.jaxtyped = _sparingly_checked


def forget_calls() -> None:
    """The next call of every function is its first one again."""
    _called.clear()


def _sparingly_checked(*, typechecker: Any) -> Callable[[Any], Any]:
    """The decorator that the import hook puts on every function and class."""

    def decorated(what: Any) -> Any:
        if inspect.isfunction(what):
            return _checked_at_first(what, typechecker)
        if dataclasses.is_dataclass(what) and "__init__" in vars(what):
            what.__init__ = _checked_at_first(what.__init__, typechecker)
        return what

    return decorated


def _checked_at_first(function: Callable[..., Any], typechecker: Any) -> Callable[..., Any]:
    code, checked = id(function.__code__), None

    @functools.wraps(function)
    def called(*args: Any, **kwargs: Any) -> Any:
        nonlocal checked
        if code in _called:
            return function(*args, **kwargs)
        _called.add(code)
        checked = checked or _checked_whole(function, typechecker=typechecker)
        return checked(*args, **kwargs)

    return called

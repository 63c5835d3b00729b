"""Shapes and types are checked in the first calls of every function within every test.

A check looks at every argument and at what comes back, which takes some 100 us; a fit calls small
functions ten thousand times. What the hundredth call of a loop is given has the shapes that the
first was given. Checkers are made when they are first needed: for most functions that a process
imports they never are, and functions within functions would have theirs made with every call.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import Any

import jaxtyping

# Calls of a function that are checked in each test.
_CHECKED_CALLS = 4

_checked_whole = jaxtyping.jaxtyped
# Of each function, by the identity of its code, which functions within functions share.
_calls: dict[int, int] = {}


def check_first_calls() -> None:
    """Have the import hook check the first calls only: to be called before it imports anything."""
    jaxtyping.jaxtyped = _sparingly_checked


def start_counting_calls() -> None:
    """The next calls of every function are its first ones again."""
    _calls.clear()


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
        count = _calls.get(code, 0)
        if count >= _CHECKED_CALLS:
            return function(*args, **kwargs)
        _calls[code] = count + 1
        checked = checked or _checked_whole(function, typechecker=typechecker)
        return checked(*args, **kwargs)

    return called

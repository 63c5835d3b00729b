"""Types of options that take a number with its unit, as a text, or without one, in SI units."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Annotated, Any

from cyclopts import Parameter, Token

from palpate.records import FORCE_UNITS, LENGTH_UNITS, MODULUS_UNITS, quantity


def _convert(
    units: Mapping[str, float], _type: Any, tokens: Sequence[Token]
) -> float | tuple[float, ...]:
    """One number in SI units, or as many as there are words."""
    found = tuple(quantity(token.value, units, token.keyword or "the number") for token in tokens)
    return found if len(found) > 1 else found[0]


def _converter(units: Mapping[str, float]) -> Callable[..., Any]:
    return partial(_convert, units)


Length = Annotated[float, Parameter(converter=_converter(LENGTH_UNITS))]
Modulus = Annotated[float, Parameter(converter=_converter(MODULUS_UNITS))]
Place = Annotated[
    tuple[float, float, float],
    Parameter(converter=_converter(LENGTH_UNITS), allow_leading_hyphen=True),
]
Force = Annotated[
    tuple[float, float, float],
    Parameter(converter=_converter(FORCE_UNITS), allow_leading_hyphen=True),
]

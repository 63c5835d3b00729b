"""Types of options that take a number with its unit, as a text, or without one, in SI units."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Annotated, Any

from cyclopts import Parameter, Token

from palpate.records import FORCES, LENGTHS, MODULI, quantity


def _converted(
    units: Mapping[str, float], _type: Any, tokens: Sequence[Token]
) -> float | tuple[float, ...]:
    """One number in SI units, or as many as there are words."""
    found = tuple(quantity(one.value, units, one.keyword or "the number") for one in tokens)
    return found if len(found) > 1 else found[0]


def _reads(units: Mapping[str, float]) -> Callable[..., Any]:
    return partial(_converted, units)


Length = Annotated[float, Parameter(converter=_reads(LENGTHS))]
Modulus = Annotated[float, Parameter(converter=_reads(MODULI))]
Place = Annotated[
    tuple[float, float, float], Parameter(converter=_reads(LENGTHS), allow_leading_hyphen=True)
]
Force = Annotated[
    tuple[float, float, float], Parameter(converter=_reads(FORCES), allow_leading_hyphen=True)
]

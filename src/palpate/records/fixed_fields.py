"""Fields of frozen dataclasses as read-only arrays."""

from collections.abc import Sequence
from typing import Any

from palpate.arrays import fixed_array


def fix_fields(
    record: Any, *, integer: bool = False, nan_allowed: bool = False, **shapes: Sequence[int | None]
) -> None:
    """Replace fields of a frozen dataclass by checked read-only copies; None stays None.

    Parameters
    ----------
    record : dataclass              that is being made
    integer, nan_allowed : bool     as in `fixed_array`, for all the fields of this call
    **shapes                        name of a field -> its shape, as in `fixed_array`

    Raises
    ------
    InputError                      as `fixed_array`; the text names the field
    """
    for name, shape in shapes.items():
        if (value := getattr(record, name)) is not None:
            array = fixed_array(
                value, name=name, shape=shape, integer=integer, nan_allowed=nan_allowed
            )
            object.__setattr__(record, name, array)

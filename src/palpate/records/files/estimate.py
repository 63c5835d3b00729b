"""Reads and writes estimates as JSON in the format `palpate-estimate/1`."""

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import MISSING, asdict, fields, is_dataclass, replace
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from palpate.errors import InputError
from palpate.records.estimate import (
    CONSTANT_NAMES,
    Constant,
    Estimate,
    ProbeEstimate,
    Status,
)
from palpate.records.text.text_file import write_text
from palpate.records.text.toml_table import TomlTable, is_list_of, json_text, read_json

T = TypeVar("T")

_ESTIMATE_FORMAT = "palpate-estimate/1"
# Of keys that earlier versions did not write.
_EARLIER = {"missing": 0, "method": "", "settings": {}, "notes": []}
# Range of half a 95 % interval in standard deviations: Student's quantiles for a known variance and
# for half a degree of freedom, with a margin.
_QUANTILES = (1.9, 200.0)
# As E = 2 G (1 + nu), no relative standard deviation exceeds the sum of the other two; the margin
# is for intervals that are not symmetric, whose standard deviation is half their width over a
# quantile.
_MAX_OF_SUM = 3.0
# Relative rounding error in double precision, with a margin: an interval may be as narrow.
_RELATIVE_ROUNDING = 1e-12


def write_estimate(path: Path | str, estimate: Estimate) -> None:
    """Write an estimate as JSON; unknown values (NaN, infinity) become null.

    Parameters
    ----------
    path : path
    estimate : Estimate

    Raises
    ------
    RecordError                     the file cannot be written
    """
    status = estimate.status
    head = {"format": _ESTIMATE_FORMAT, "status": status, "advice": status.advice}
    write_text(path, json_text(head | asdict(estimate)))


def read_estimate(path: Path | str) -> Estimate:
    """Read an estimate; null becomes NaN, or infinity at one end of an interval.

    Parameters
    ----------
    path : path

    Returns
    -------
    Estimate

    Raises
    ------
    RecordError                     missing, not JSON, another format, a missing key or one of the
                                    wrong type, an estimate that contradicts itself; the text names
                                    the key
    """
    root = read_json(Path(path))
    root.check_format(_ESTIMATE_FORMAT)
    estimate = _read_record(root, Estimate)
    settings = TomlTable(root.file, "[settings]", dict(estimate.settings))
    settings.optional("versions", settings.table)
    with root.error_context():
        # The best fit of a model that does not fit has no interval.
        if estimate.status is not Status.MODEL_CONTRADICTED:
            _check_deviations("", estimate, estimate.identifiable)
        for probe in estimate.probes:
            _check_deviations(f"probing {probe.name!r}: ", probe, probe.identifiable)
    return estimate


def _check_deviations(
    where: str, estimate: Estimate | ProbeEstimate, identifiable: Mapping[str, bool]
) -> None:
    """Refuse standard deviations that contradict their intervals, or each other."""
    determined = {name: getattr(estimate, name) for name, known in identifiable.items() if known}
    for name, constant in determined.items():
        low, high = constant.ci95
        half = 0.5 * (high - low)
        if not math.isfinite(half + constant.std):
            raise InputError(f"{where}{name} is identifiable by `identifiable`, but has no std")
        lowest, highest = (quantile * constant.std for quantile in _QUANTILES)
        # If Poisson's ratio is unknown, the interval of the other constant covers its whole range.
        wide = (
            half > highest + _RELATIVE_ROUNDING * abs(constant.value)
            and "poisson_ratio" in determined
        )
        if wide or half < lowest - _RELATIVE_ROUNDING * abs(constant.value):
            raise InputError(
                f"{where}{name} has std {constant.std:g}, but ci95 {low:g} to {high:g}; of a 95 %"
                f" interval the half is {_QUANTILES[0]:g} std or more, {_QUANTILES[1]:g} at most"
            )
    if len(determined) < len(CONSTANT_NAMES):
        return
    relative = {
        n: constant.std / (constant.value + (n == "poisson_ratio"))
        for n, constant in determined.items()
    }
    for name, relative_std in relative.items():
        others = sum(relative.values()) - relative_std
        if relative_std > _MAX_OF_SUM * others:
            raise InputError(
                f"{where}{name} has std {determined[name].std:g}, {100 * relative_std:.3g} %, but"
                f" the others leave it {100 * others:.3g} %, as E is 2 G (1 + nu)"
            )


def _read_record(table: TomlTable, kind: type[T]) -> T:
    """A dataclass filled from a table, key by field; fields with a default may be left out."""
    table = replace(table, values=_EARLIER | table.values)
    hints = get_type_hints(kind)
    values: dict[str, Any] = {}
    for item in fields(kind):  # type: ignore[arg-type]
        needed = item.default is MISSING and item.default_factory is MISSING
        if needed or table.values.get(item.name) is not None:
            values[item.name] = _read_value(table, item.name, hints[item.name])
    if kind is Constant:
        values["ci95"] = _open_interval(**values)
    with table.error_context():
        return kind(**values)


def _read_value(table: TomlTable, key: str, hint: Any) -> Any:
    """Value of a key, converted to the type of its field."""
    kind, parts = get_origin(hint), get_args(hint)
    if kind is UnionType:
        return None if table.get(key) is None else _read_value(table, key, parts[0])
    if kind in (dict, Mapping):
        inner = table.table(key)
        values = {name: _read_value(inner, name, parts[1]) for name in inner.values}
        for name, value in values.items():
            if parts[1] is float and value < 0.0:
                inner.fail(name, f"is {value:g}; must not be negative")
        return values
    if kind is tuple and is_dataclass(parts[0]):
        return tuple(_read_record(item, parts[0]) for item in table.tables(key))  # type: ignore[arg-type]
    if kind is tuple and parts[0] is float:
        must = f"be {'two' if len(parts) == 2 else 'three'} numbers in brackets"
        fits = is_list_of(object)
        table.checked(lambda value: fits(value) and len(value) == len(parts), key, must)
        return tuple(table.each(_number, key))
    if is_dataclass(hint):
        return _read_record(table.table(key, f"{table.name} [{key}]".strip()), hint)  # type: ignore[arg-type]
    return _READERS[hint](table, key)


def _open_interval(value: float, std: float, ci95: tuple[float, float]) -> tuple[float, float]:
    """The interval with infinity at ends that are unknown, unless only the value is known."""
    low, high = ci95
    if math.isnan(value) or not all(map(math.isnan, (std, low, high))):
        return (-math.inf if math.isnan(low) else low, math.inf if math.isnan(high) else high)
    return ci95


def _number(table: TomlTable, key: str) -> float:
    """A finite number of any magnitude, as estimates may have; NaN in place of null."""
    if table.get(key) is None:
        return math.nan
    return float(table.checked(_is_finite, key, "be a finite number"))


def _is_finite(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= sys.float_info.max


# How the value of a field is read, by the field's type.
_READERS: dict[Any, Callable[[TomlTable, str], Any]] = {
    float: _number,
    int: TomlTable.count,
    bool: TomlTable.boolean,
    str: lambda table, key: table.checked(
        lambda value: isinstance(value, str), key, "be a text in quotes"
    ),
    Status: lambda table, key: Status(table.choice(key, tuple(Status))),
    tuple[str, ...]: TomlTable.texts,
    Any: TomlTable.get,
}

"""Reads and writes estimates as JSON in the format `palpate-estimate/1`."""

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from palpate.errors import InputError
from palpate.records.estimate import (
    CONSTANT_NAMES,
    BudgetEntry,
    Constant,
    ErrorEstimate,
    Estimate,
    ProbeEstimate,
    RegionEstimate,
    Status,
    SupportEstimate,
)
from palpate.records.modulus_field import FieldEstimate, StiffPart
from palpate.records.reciprocity import ForceExcess, Reciprocity, WorkPair
from palpate.records.text.text_file import write_text
from palpate.records.text.toml_table import TomlTable, json_text, read_json

T = TypeVar("T")

_ESTIMATE_FORMAT = "palpate-estimate/1"
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
    flags = root.table("identifiable")
    with root.error_context():
        estimate = Estimate(
            status=Status(root.choice("status", tuple(Status))),
            identifiable={name: flags.boolean(name) for name in CONSTANT_NAMES},
            probes=tuple(map(_read_probe, root.tables("probes"))),
            seconds=_mapping(root.table("seconds"), _duration),
            method=root.optional("method", root.text) or "",
            settings=_mapping(root.optional("settings", root.table), TomlTable.get),
            notes=tuple(root.optional("notes", root.texts) or ()),
            details=tuple(root.optional("details", root.texts) or ()),
            errors=_read_errors(root),
            budget=_read_budget(root),
            reciprocity=_read_reciprocity(root),
            field=None if root.values.get("field") is None else _read_field(root.table("field")),
            regions=tuple(map(_read_region, root.optional("regions", root.tables) or ())),
            **{name: _read_constant(root.table(name)) for name in CONSTANT_NAMES},
        )
        # The best fit of a model that does not fit has no interval.
        if estimate.status is not Status.MODEL_CONTRADICTED:
            _check_deviations("", estimate, estimate.identifiable)
        for probe in estimate.probes:
            _check_deviations(f"probing {probe.name!r}: ", probe, probe.identifiable)
    return estimate


def _check_deviations(
    where: str, found: Estimate | ProbeEstimate, identifiable: Mapping[str, bool]
) -> None:
    """Refuse standard deviations that contradict their intervals, or each other."""
    determined = {name: getattr(found, name) for name, known in identifiable.items() if known}
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


def _number(table: TomlTable, key: str) -> float:
    """A finite number of any magnitude, as estimates may have."""
    value = table.checked(_is_finite, key, "be a finite number")
    return float(value)


def _is_finite(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= sys.float_info.max


def _duration(table: TomlTable, key: str) -> float:
    """A number that is not negative."""
    _number(table, key)
    return float(table.checked(lambda value: value >= 0.0, key, "not be negative"))


def _mapping(table: TomlTable | None, read: Callable[[TomlTable, str], T]) -> dict[str, T]:
    """Every value of a table by its key; empty without a table."""
    return {} if table is None else {key: read(table, key) for key in table.values}


def _known(table: TomlTable, key: str, unknown: float = math.nan) -> float:
    """A number, or `unknown` in place of null."""
    return unknown if table.get(key) is None else _number(table, key)


def _parts(table: TomlTable, key: str, names: Sequence[str], count: str) -> TomlTable:
    """The numbers of a list as a table in which each has a name."""
    values = table.checked(
        lambda value: isinstance(value, list) and len(value) == len(names),
        key,
        f"be {count} numbers in brackets",
    )
    return TomlTable(table.file, f"{table.name} {key}", dict(zip(names, values, strict=True)))


def _read_constant(table: TomlTable) -> Constant:
    ends = _parts(table, "ci95", ("low", "high"), "two")
    value, std = _known(table, "value"), _known(table, "std")
    low, high = _known(ends, "low"), _known(ends, "high")
    if math.isnan(value) or not (math.isnan(std) and math.isnan(low) and math.isnan(high)):
        # An interval without an end, not a value without an interval.
        low, high = (
            (-math.inf if math.isnan(low) else low),
            (math.inf if math.isnan(high) else high),
        )
    with table.error_context():
        return Constant(value, std, (low, high))


def _read_support(table: TomlTable) -> SupportEstimate:
    vectors = {}
    for name in ("translation", "translation_std", "rotation", "rotation_std"):
        parts = _parts(table, name, "xyz", "three")
        vectors[name] = tuple(_known(parts, axis) for axis in "xyz")
    return SupportEstimate(support=table.count("support"), **vectors)


def _read_errors(table: TomlTable) -> tuple[ErrorEstimate, ...]:
    return tuple(
        ErrorEstimate(
            name=entry.text("name"),
            unit=str(entry.get("unit")),
            **{key: _number(entry, key) for key in ("value", "std", "prior_std")},
        )
        for entry in table.optional("errors", table.tables) or ()
    )


def _read_field(table: TomlTable) -> FieldEstimate:
    parts = []
    for part in table.optional("parts", table.tables) or ():
        place = _parts(part, "centre", "xyz", "three")
        centre = (_number(place, "x"), _number(place, "y"), _number(place, "z"))
        numbers = (_number(part, key) for key in ("size", "ratio", "low", "high", "depth"))
        with part.error_context():
            parts.append(StiffPart(centre, *numbers))
    std, length, evidence, known = (
        _number(table, key) for key in ("std", "length", "log_evidence", "known")
    )
    with table.error_context():
        return FieldEstimate(std, length, evidence, known, tuple(parts))


def _read_region(table: TomlTable) -> RegionEstimate:
    ratio, shear, young = (
        _read_constant(table.table(key, f"{table.name} [{key}]"))
        for key in ("ratio", "shear_modulus", "young_modulus")
    )
    return RegionEstimate(
        table.text("name"), ratio, shear, young, str(table.get("known")),
        table.boolean("identifiable"), table.boolean("is_seen"),
    )  # fmt: skip


def _read_budget(table: TomlTable) -> tuple[BudgetEntry, ...]:
    return tuple(
        BudgetEntry(entry.text("source"), *(_known(entry, name) for name in CONSTANT_NAMES))
        for entry in table.optional("budget", table.tables) or ()
    )


def _read_reciprocity(root: TomlTable) -> Reciprocity | None:
    if root.values.get("reciprocity") is None:
        return None
    table = root.table("reciprocity")
    return Reciprocity(
        pairs=tuple(
            WorkPair(
                entry.text("first"),
                entry.text("second"),
                *(_number(entry, key) for key in ("work", "other", "std")),
            )
            for entry in table.optional("pairs", table.tables) or ()
        ),
        pushes=tuple(map(_read_excess, table.optional("pushes", table.tables) or ())),
        chi_square=_number(table, "chi_square"),
        degrees=table.count("degrees"),
        chance=_number(table, "chance"),
        growth=None if table.get("growth") is None else _read_excess(table.table("growth")),
        odd=tuple(table.optional("odd", table.texts) or ()),
        grows=table.boolean("grows"),
        holds=table.boolean("holds"),
        own_work=_known(table, "own_work"),
        own_work_std=_known(table, "own_work_std"),
        passive=tuple(table.optional("passive", table.texts) or ()),
        untested=tuple(table.optional("untested", table.texts) or ()),
    )


def _read_excess(table: TomlTable) -> ForceExcess:
    return ForceExcess(
        str(table.get("name")), *(_number(table, key) for key in ("excess", "std", "sigmas"))
    )


def _read_probe(table: TomlTable) -> ProbeEstimate:
    error = table.values.get("prediction_error")
    constants = {
        name: _read_constant(table.table(name, f"{table.name} [{name}]")) for name in CONSTANT_NAMES
    }
    with table.error_context():
        return ProbeEstimate(
            name=table.text("name"),
            observed=table.count("observed"),
            missing=table.optional("missing", table.count) or 0,
            rejected=table.count("rejected"),
            rms_residual=_known(table, "rms_residual"),
            prediction_error=None if error is None else _number(table, "prediction_error"),
            supports=tuple(map(_read_support, table.optional("supports", table.tables) or ())),
            errors=_read_errors(table),
            identifiable=_mapping(table.optional("identifiable", table.table), TomlTable.boolean),
            **constants,
        )

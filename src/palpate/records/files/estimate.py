"""Estimates to and from JSON in the format `palpate-estimate/1`."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from palpate.errors import RecordError
from palpate.records.estimate import (
    CONSTANT_NAMES,
    Constant,
    Estimate,
    ProbeEstimate,
    Status,
    SupportEstimate,
)
from palpate.records.text import json_text, read_text, write_text

ESTIMATE_FORMAT = "palpate-estimate/1"


def write_estimate(path: Path | str, estimate: Estimate) -> None:
    """Write an estimate as JSON; what is not known (NaN, infinity) becomes null.

    Parameters
    ----------
    path : path
    estimate : Estimate

    Raises
    ------
    RecordError                     the file cannot be written
    """
    status = estimate.status
    head = {"format": ESTIMATE_FORMAT, "status": status, "advice": status.advice}
    write_text(path, json_text(head | asdict(estimate)))


def read_estimate(path: Path | str) -> Estimate:
    """Read an estimate back; null becomes NaN, and infinity at the ends of an interval.

    Parameters
    ----------
    path : path

    Raises
    ------
    RecordError                     not there, not JSON, another format, a key missing
    """
    try:
        content = json.loads(read_text(Path(path)))
    except json.JSONDecodeError as error:
        raise RecordError(f"{path}: is not valid JSON: {error}") from error
    found = content.get("format") if isinstance(content, dict) else None
    if found != ESTIMATE_FORMAT:
        raise RecordError(f"{path}: format is {found!r}; this version reads '{ESTIMATE_FORMAT}'")
    try:
        return Estimate(
            status=Status(content["status"]),
            identifiable={name: content["identifiable"][name] for name in CONSTANT_NAMES},
            probes=tuple(_read_probe(probe) for probe in content["probes"]),
            seconds=content["seconds"],
            method=content.get("method", ""),
            settings=content.get("settings", {}),
            notes=tuple(content.get("notes", ())),
            **{name: _read_constant(content[name]) for name in CONSTANT_NAMES},
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise RecordError(
            f"{path}: is not a whole estimate (at {error}); write it again with 'palpate fit'"
        ) from error


def _number(value: float | None, unknown: float = math.nan) -> float:
    return unknown if value is None else float(value)


def _read_constant(content: Mapping[str, Any]) -> Constant:
    low, high = content["ci95"]
    return Constant(
        value=_number(content["value"]),
        std=_number(content["std"]),
        ci95=(_number(low, -math.inf), _number(high, math.inf)),
    )


def _read_support(content: Mapping[str, Any]) -> SupportEstimate:
    parts = ("translation", "translation_std", "rotation", "rotation_std")
    return SupportEstimate(
        support=int(content["support"]),
        **{name: tuple(_number(value) for value in content[name]) for name in parts},
    )


def _read_probe(content: Mapping[str, Any]) -> ProbeEstimate:
    error = content.get("prediction_error")
    return ProbeEstimate(
        name=content["name"],
        observed=int(content["observed"]),
        missing=int(content.get("missing", 0)),
        rejected=int(content["rejected"]),
        rms_residual=_number(content["rms_residual"]),
        prediction_error=None if error is None else float(error),
        supports=tuple(_read_support(one) for one in content.get("supports", ())),
        **{name: _read_constant(content[name]) for name in CONSTANT_NAMES},
    )

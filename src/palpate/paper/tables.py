"""Tables 1 and 2 of the paper: its own numbers beside both methods on the virtual bench."""

from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np

from palpate.paper.published import FlowRow, Spread, VertexRow
from palpate.paper.result_table import Cell, ResultTable

# What the paper's own numbers are called beside the names of the methods.
PAPER = "paper"
_MM = 1e3
Row = TypeVar("Row", FlowRow, VertexRow)
_FLOW_COLUMNS = (
    "step", "source", "angle (deg)", "sigma (deg)", "length (mm)", "sigma (mm)", "encoder (mm)",
    "command (mm)", "points",
)  # fmt: skip
_VERTEX_COLUMNS = (
    "step", "source", "angle error (deg)", "sigma (deg)", "length (mm)", "sigma (mm)",
    "command (mm)", "vertices",
)  # fmt: skip


def flow_table(title: str, rows: Mapping[str, Sequence[FlowRow]]) -> ResultTable:
    """Table 1 for one direction: each step by each source.

    Parameters
    ----------
    title : str
    rows : mapping of source to its rows    the paper's and the methods'
    """
    cells = [
        (
            row.step,
            source,
            *_degrees(row.angle),
            *_millimetres(row.length),
            _MM * row.encoder,
            _MM * row.command,
            row.points,
        )
        for source, row in _by_step(rows)
    ]
    return ResultTable(title, _FLOW_COLUMNS, (0, 0, 2, 2, 4, 4, 4, 4, 0), tuple(cells))


def flow_summary(title: str, tests: Mapping[str, Mapping[str, Sequence[FlowRow]]]) -> ResultTable:
    """The worst of table 1: bias and spread of lengths, spread of the angle at the first step.

    Parameters
    ----------
    title : str
    tests : mapping of motion to mapping of source to rows

    Returns
    -------
    ResultTable                     the bias is against the encoder for the paper, whose stage did
                                    not quite go where it was sent, else against the command, which
                                    the virtual stage obeys
    """
    cells: list[tuple[Cell, ...]] = []
    for motion, sources in tests.items():
        for source, rows in sources.items():
            bias = [
                row.length.mean - (row.encoder if source == PAPER else row.command) for row in rows
            ]
            cells.append(
                (
                    motion,
                    source,
                    _MM * _worst(bias),
                    _MM * _worst([row.length.std for row in rows]),
                    float(np.degrees(rows[0].angle.std)),
                    len(rows),
                )
            )
    columns = (
        "motion", "source", "length bias, worst step (mm)", "length sigma, worst step (mm)",
        "angle sigma, first step (deg)", "steps",
    )  # fmt: skip
    return ResultTable(title, columns, (0, 0, 4, 4, 2, 0), tuple(cells))


def vertex_table(title: str, rows: Mapping[str, Sequence[VertexRow]]) -> ResultTable:
    """Table 2 for one motion: each step by each source.

    Parameters
    ----------
    title, rows                     as in `flow_table`
    """
    cells = [
        (
            row.step,
            source,
            *_degrees(row.angle_error),
            *((None, None) if row.length is None else _millimetres(row.length)),
            None if row.command is None else _MM * row.command,
            row.vertices,
        )
        for source, row in _by_step(rows)
    ]
    return ResultTable(title, _VERTEX_COLUMNS, (0, 0, 2, 2, 4, 4, 4, 0), tuple(cells))


def vertex_summary(
    title: str, tests: Mapping[str, Mapping[str, Sequence[VertexRow]]]
) -> ResultTable:
    """The ends of table 2: errors of the direction at the first and at the last step.

    Parameters
    ----------
    title, tests                    as in `flow_summary`
    """
    cells: list[tuple[Cell, ...]] = [
        (
            motion,
            source,
            *_degrees(rows[0].angle_error),
            *_degrees(rows[-1].angle_error),
            len(rows),
        )
        for motion, sources in tests.items()
        for source, rows in sources.items()
    ]
    columns = (
        "motion", "source", "angle error, first step (deg)", "sigma (deg)",
        "angle error, last step (deg)", "sigma (deg)", "steps",
    )  # fmt: skip
    return ResultTable(title, columns, (0, 0, 2, 2, 2, 2, 0), tuple(cells))


def _by_step(rows: Mapping[str, Sequence[Row]]) -> list[tuple[str, Row]]:
    """Sources and their rows, step after step."""
    count = max(map(len, rows.values()), default=0)
    return [
        (source, each[k]) for k in range(count) for source, each in rows.items() if k < len(each)
    ]


def _degrees(spread: Spread) -> tuple[float, float]:
    return float(np.degrees(spread.mean)), float(np.degrees(spread.std))


def _millimetres(spread: Spread) -> tuple[float, float]:
    return _MM * spread.mean, _MM * spread.std


def _worst(values: Sequence[float]) -> float:
    """The one that is farthest from zero, with its sign; NaN where one is not known."""
    return float(values[int(np.argmax(np.abs(values)))])

"""One measured figure."""

from dataclasses import asdict, dataclass
from typing import Any

BEM = "Boundary element model"
ESTIMATION = "Estimation"
FLOW = "Range flow"
FACILITY = "Virtual facility"
SIMULATION = "Simulation"
CAMPAIGN = "Campaigns"
DOOR = "From a rig to a session"
LIVE = "Measuring live"
# Of rows that stand for a subject that stopped before its figures.
NOT_MEASURED = "Not measured"


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure, measured.

    Parameters
    ----------
    section : str               BEM, ESTIMATION, FLOW, FACILITY, SIMULATION, CAMPAIGN, DOOR, LIVE or
                                NOT_MEASURED
    name : str                  what was measured, on what
    reached : float or None     None where it could not be measured; the note says why
    unit : str                  "", "%", "s", "mm" ... or "x"; percentages are given as percentages
    note : str                  how it was measured, one or two sentences
    """

    section: str
    name: str
    reached: float | None
    unit: str = ""
    note: str = ""


def plain(figures: list[Figure]) -> list[dict[str, Any]]:
    """Figures as JSON can hold them; `Figure(**values)` makes one of them again."""
    return [asdict(figure) for figure in figures]

"""One measured figure with what was asked of it."""

from dataclasses import asdict, dataclass
from typing import Any

BEM = "Boundary element model"
ESTIMATION = "Estimation"
FLOW = "Range flow"
FACILITY = "Virtual facility"
SIMULATION = "Simulation"
CAMPAIGN = "Campaigns"
DOOR = "From a rig to a session"
Limit = float | tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure, measured.

    Parameters
    ----------
    section : str               BEM, ESTIMATION, FLOW, FACILITY, SIMULATION, CAMPAIGN or DOOR
    name : str                  what was measured, on what
    reached : float or None     None where it could not be measured; the note says why
    unit : str                  "", "%", "s", "mm" ... or "x"; percentages are given as percentages
    must : float, pair or None  bound, or interval, to keep; None for a row that only compares
    reach : float, pair or None the same, to strive for
    higher : bool               True where more is better
    note : str                  how it was measured, one or two sentences
    """

    section: str
    name: str
    reached: float | None
    unit: str = ""
    must: Limit = None
    reach: Limit = None
    higher: bool = False
    note: str = ""

    @property
    def verdict(self) -> str:
        """What is kept: "reach", else "must", else "missed"; "" where nothing is asked."""
        if self.must is None and self.reach is None:
            return ""
        if self.reached is None:
            return "not measured"
        if self.reach is not None and self._keeps(self.reach):
            return "reach"
        if self.must is None:
            return "not reached"
        return "must" if self._keeps(self.must) else "missed"

    def _keeps(self, limit: float | tuple[float, float]) -> bool:
        if isinstance(limit, tuple):
            return limit[0] <= self.reached <= limit[1]
        return self.reached >= limit if self.higher else self.reached <= limit


def plain(figures: list[Figure]) -> list[dict[str, Any]]:
    """Figures as JSON can hold them."""
    return [asdict(figure) for figure in figures]


def figure_from_plain(values: dict[str, Any]) -> Figure:
    """The inverse of `plain` for one figure: JSON has lists where a limit is a pair."""
    pairs = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
    return Figure(**pairs)

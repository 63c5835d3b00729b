"""Log of the tool's pose: position of its tip at first contact, and its travel."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from palpate.errors import RecordError
from palpate.recording.force.bags import POSITIONS, read_log_table
from palpate.recording.force.plateaus import Reading
from palpate.recording.force.touches import Touch
from palpate.records import LENGTH_UNITS, TIME_UNITS
from palpate.shapes import Points, Vector3

_COLUMNS = {"time": ("time", "t"), "x": ("x",), "y": ("y",), "z": ("z",)}
_CURE = "a log of poses is a table with the columns time, x, y, z"
# Largest delay between the true contact and its detection in the force [s].
_MAX_DELAY = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class PoseLog:
    """Positions of the tool's tip over time.

    Attributes
    ----------
    time : (n,) float [s]           gauge's clock, not decreasing
    position : (n, 3) float [m]     position of the tip's end, object frame
    source : str                    file, for messages
    """

    time: Float[np.ndarray, " n"]
    position: Points
    source: str

    def at(self, time: float) -> Vector3:
        """Position at a time, by linear interpolation.

        Parameters
        ----------
        time : float [s]            gauge's clock

        Returns
        -------
        (3,) float [m]

        Raises
        ------
        RecordError                 a time outside the log
        """
        if not self.time[0] <= time <= self.time[-1]:
            raise RecordError(
                f"{self.source}: covers {self.time[0]:.2f} to {self.time[-1]:.2f} s, and a press is"
                f" at {time:.2f} s of the gauge's clock; the two logs must have the same clock"
            )
        return np.array([np.interp(time, self.time, part) for part in self.position.T])


def read_poses(path: Path, *, metres_per_unit: float, topic: str | None = None) -> PoseLog:
    """Read a log of the tool's tip.

    Parameters
    ----------
    path : Path                     a table, or a bag, whose lengths are in metres
    metres_per_unit : float         unit of lengths whose heading, as in "x [mm]", names none
    topic : str or None             of a bag; None: the only one with poses

    Returns
    -------
    PoseLog

    Raises
    ------
    RecordError                     no such table or columns; an unknown unit; times that decrease
    InputError                      the optional package for bags is missing
    """
    table = read_log_table(path, topic=topic, wanted=POSITIONS, cure=_CURE)
    columns = table.require(_COLUMNS, normalise=str.lower, reason=lambda _: _CURE)
    seconds = table.factor(columns[:1], TIME_UNITS, 1.0)
    metres = table.factor(columns[1:], LENGTH_UNITS, metres_per_unit)
    values = table.values(columns)
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < 2 or np.any(np.diff(values[:, 0]) < 0.0):
        raise RecordError(f"{path}: has {len(values)} lines whose times do not increase; {_CURE}")
    return PoseLog(seconds * values[:, 0], metres * values[:, 1:], str(path))


def tip_motion(poses: PoseLog, touch: Touch, reading: Reading) -> tuple[Vector3, Vector3, float]:
    """Contact point, displacement of the tip up to the reading, and its standard deviation.

    Contact is detected with a delay of up to a tenth of a second; the contact point is taken as
    uniformly distributed over the path of the tip during that time.

    Parameters
    ----------
    poses : PoseLog
    touch : Touch
    reading : Reading

    Returns
    -------
    point : (3,) float [m]          of first contact
    displacement : (3,) float [m]   from there to the reading
    std : float [m]                 of each component of the displacement

    Raises
    ------
    RecordError                     the log does not cover the press
    """
    late, early = poses.at(touch.begin), poses.at(touch.begin - _MAX_DELAY)
    point = 0.5 * (late + early)
    std = float(np.linalg.norm(late - early)) / np.sqrt(12.0)
    return point, poses.at(reading.time) - point, max(std, 1e-6)

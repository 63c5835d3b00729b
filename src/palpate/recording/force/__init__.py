"""Evaluation of a force gauge's log: times of contact, plateaus, and the force on each.

Purpose    : forces on the object, corrected for tool weight and zero drift, with standard
             deviations.
Takes      : a table of times and forces, or a robot's bag, and how to read it (`Gauge`).
Gives      : `ForceLog`, `Touch`, `Zero`, `Reading`.
Depends on : `records`.
Read first : `log.py`, `bags.py`, `touches.py`, `plateaus.py`.
"""

from palpate.recording.force.bags import POSITIONS as POSITIONS, read_log_table as read_log_table
from palpate.recording.force.log import (
    ForceLog as ForceLog,
    Gauge as Gauge,
    read_force_log as read_force_log,
    true_runs as true_runs,
)
from palpate.recording.force.plateaus import (
    Reading as Reading,
    find_plateau as find_plateau,
    read_force as read_force,
    still_force as still_force,
    unreadable_reason as unreadable_reason,
)
from palpate.recording.force.touches import (
    ResampledForce as ResampledForce,
    Touch as Touch,
    Zero as Zero,
    find_touches as find_touches,
    find_zero as find_zero,
    mean_std as mean_std,
    resample_force as resample_force,
)

"""Records that cross rooms, and their files.

Purpose    : frozen dataclasses for what was measured and what was estimated; read and write them.
Takes      : session folders, displacement CSVs, estimate.json.
Gives      : `Session`, `Probing`, `DisplacementField`, `Estimate`.
Depends on : `geometry`, `errors`, `shapes`.
Read first : `probing.py`, `session.py`, then `session_files.py`.
"""

from palpate.records.displacement_files import read_displacement, write_displacement
from palpate.records.estimate import CONSTANT_NAMES, Constant, Estimate, ProbeEstimate, Status
from palpate.records.estimate_files import ESTIMATE_FORMAT, read_estimate, write_estimate
from palpate.records.probing import (
    Contact,
    ContactProfile,
    DisplacementField,
    Images,
    Probing,
    observed_rows,
)
from palpate.records.session import Session
from palpate.records.session_files import SESSION_FORMAT, read_session

__all__ = [
    "CONSTANT_NAMES",
    "ESTIMATE_FORMAT",
    "SESSION_FORMAT",
    "Constant",
    "Contact",
    "ContactProfile",
    "DisplacementField",
    "Estimate",
    "Images",
    "ProbeEstimate",
    "Probing",
    "Session",
    "Status",
    "observed_rows",
    "read_displacement",
    "read_estimate",
    "read_session",
    "write_displacement",
    "write_estimate",
]

"""Records that cross rooms, and their files.

Purpose    : frozen dataclasses for what was measured and what was estimated; read and write them.
Takes      : session folders, displacement files, camera calibrations, estimate.json.
Gives      : `Session`, `Probing`, `DisplacementField`, `Rig`, `Estimate`.
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
from palpate.records.rig import DISTORTION_TERMS, Camera, Rig, camera_centre, picture_size
from palpate.records.rig_files import read_rig, rig_to_toml, write_rig
from palpate.records.session import Session, require_probings
from palpate.records.session_files import SESSION_FORMAT, read_session
from palpate.records.step import Step
from palpate.records.support import read_support
from palpate.records.toml_table import TomlTable, read_toml

__all__ = [
    "CONSTANT_NAMES",
    "DISTORTION_TERMS",
    "ESTIMATE_FORMAT",
    "SESSION_FORMAT",
    "Camera",
    "Constant",
    "Contact",
    "ContactProfile",
    "DisplacementField",
    "Estimate",
    "Images",
    "ProbeEstimate",
    "Probing",
    "Rig",
    "Session",
    "Status",
    "Step",
    "TomlTable",
    "camera_centre",
    "observed_rows",
    "picture_size",
    "read_displacement",
    "read_estimate",
    "read_rig",
    "read_session",
    "read_support",
    "read_toml",
    "require_probings",
    "rig_to_toml",
    "write_displacement",
    "write_estimate",
    "write_rig",
]

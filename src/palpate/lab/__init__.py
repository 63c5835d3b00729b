"""The virtual measurement facility: specimens, arm, cameras, sensors; sessions with their truth.

Purpose    : make the data of a measurement whose truth is known, as a bench would give them.
Takes      : a configuration, `palpate-lab/1`.
Gives      : a session folder, `truth.toml`, truth maps.
Depends on : `vision`, `records`, `geometry`; never on `bem`: what estimates a specimen must not
             have made it.
Read first : `config.py`, `facility.py`, then `finite_elements.py`, `mitsuba_scene.py`.
"""

from palpate.lab.config import (
    Arm,
    Calibration,
    ForceSensor,
    Head,
    LabConfig,
    Look,
    Material,
    Pictures,
    PositionSensor,
    Probe,
    Specimen,
    Stage,
)
from palpate.lab.config_files import LAB_FORMAT, read_lab_config
from palpate.lab.facility import make_session, make_sessions
from palpate.lab.mitsuba_variant import Variant, choose_variant
from palpate.lab.planned_pictures import planned_pictures
from palpate.lab.specimens import SHAPES

__all__ = [
    "LAB_FORMAT",
    "SHAPES",
    "Arm",
    "Calibration",
    "ForceSensor",
    "Head",
    "LabConfig",
    "Look",
    "Material",
    "Pictures",
    "PositionSensor",
    "Probe",
    "Specimen",
    "Stage",
    "Variant",
    "choose_variant",
    "make_session",
    "make_sessions",
    "planned_pictures",
    "read_lab_config",
]

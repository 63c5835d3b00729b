"""The virtual measurement facility: specimens, arm, cameras, sensors; sessions with their truth.

Purpose    : make the data of a measurement whose truth is known, as a bench would give them.
Takes      : a configuration, `palpate-lab/1`.
Gives      : a session folder, `truth.toml`, truth maps.
Depends on : `vision`, `records`, `geometry`; never on `bem`: what estimates a specimen must not
             have made it.
Read first : `config.py`, `facility.py`, then `finite_elements.py`, `mitsuba_scene.py`.
"""

from palpate.lab.bench import (
    force_std as force_std,
    make_session as make_session,
    make_sessions as make_sessions,
    planned_pictures as planned_pictures,
    read_force as read_force,
)
from palpate.lab.bodies import (
    SHAPES as SHAPES,
    Tip as Tip,
    cylinder as cylinder,
    half_ball as half_ball,
    held_nodes as held_nodes,
    make_body as make_body,
    make_solid as make_solid,
    press as press,
)
from palpate.lab.config import (
    Arm as Arm,
    Calibration as Calibration,
    ForceSensor as ForceSensor,
    Head as Head,
    LabConfig as LabConfig,
    Look as Look,
    Material as Material,
    Pictures as Pictures,
    PositionSensor as PositionSensor,
    Probe as Probe,
    Specimen as Specimen,
    Stage as Stage,
)
from palpate.lab.config_files import (
    LAB_FORMAT as LAB_FORMAT,
    built_in as built_in,
    read_lab_config as read_lab_config,
)
from palpate.lab.pictures import (
    Variant as Variant,
    choose_variant as choose_variant,
    misjudged as misjudged,
)

"""The virtual measurement facility: specimens, arm, cameras, sensors; sessions with ground truth.

Purpose    : simulate the data of a measurement whose ground truth is known.
Takes      : a configuration in TOML, format `palpate-lab/1`, and a seed.
Gives      : a session folder that also holds `truth.toml` and truth maps.
Depends on : `solids`, `vision`, `records`, `geometry`; never on `bem`: the model that estimates the
             constants must not have generated the data.
Read first : `config.py`, `facility.py`, `arm.py`, then `specimens.py`, `studio.py`, `scene.py`.
"""

from palpate.lab.arm import aim as aim, rod_at as rod_at
from palpate.lab.config import (
    Arm as Arm,
    Calibration as Calibration,
    Head as Head,
    LabConfig as LabConfig,
    Look as Look,
    Material as Material,
    Pictures as Pictures,
    Probe as Probe,
    Sensor as Sensor,
)
from palpate.lab.config_files import (
    built_in as built_in,
    read_lab_config as read_lab_config,
)
from palpate.lab.facility import make_session as make_session, make_sessions as make_sessions
from palpate.lab.head import (
    board_picture as board_picture,
    make_head as make_head,
    miscalibrated as miscalibrated,
)
from palpate.lab.planned_pictures import planned_pictures as planned_pictures
from palpate.lab.press_film import (
    Film as Film,
    SolvedPress as SolvedPress,
    solve_press as solve_press,
)
from palpate.lab.render_mesh import make_render_mesh as make_render_mesh, texture as texture
from palpate.lab.scene import (
    Variant as Variant,
    choose_variant as choose_variant,
)
from palpate.lab.specimens import (
    SHAPES as SHAPES,
    cylinder as cylinder,
    half_ball as half_ball,
)
from palpate.lab.studio import make_studio as make_studio, photograph as photograph
from palpate.lab.tutorial import (
    Print as Print,
    board_pose as board_pose,
    make_tutorial as make_tutorial,
)

"""programs."""

from palpate.records.programs.calibration import read_calibration as read_calibration
from palpate.records.programs.calibration_parts import (
    METRES_PER_UNIT as METRES_PER_UNIT,
    make_camera as make_camera,
    make_pose as make_pose,
    make_rig as make_rig,
    metres_per_unit as metres_per_unit,
    numbers as numbers,
)
from palpate.records.programs.dice import read_dice as read_dice
from palpate.records.programs.matchid import read_matchid as read_matchid
from palpate.records.programs.measured_points import (
    LENGTH_UNITS as LENGTH_UNITS,
    MeasuredPoints as MeasuredPoints,
    measured_rows as measured_rows,
)
from palpate.records.programs.multidic import read_multidic as read_multidic
from palpate.records.programs.opencorr import read_opencorr as read_opencorr
from palpate.records.programs.pyvale import read_pyvale as read_pyvale
from palpate.records.programs.vic3d import read_vic3d as read_vic3d
from palpate.records.programs.vtu import read_vtu as read_vtu

"""From videos of presses and the log of a force gauge to a session.

Purpose    : find the presses in a recording, the clocks' offsets and the moments to measure at, and
             write them as a session.
Takes      : recording.toml: a video or pictures for each camera, a force log, a mesh, a rig; or a
             table of a robot's pokes.
Gives      : `Recorded`, `Pokes`, a session folder; `survey_folder` and the outline of a session.
Depends on : `vision`, `bem`, `probe`, `records`, `geometry`.
Read first : `record.py`, then `touches.py`, `clock.py` and `footage.py`.
"""

from palpate.recording.contact_point import (
    ContactModel as ContactModel,
    find_contact as find_contact,
    make_contact_model as make_contact_model,
)
from palpate.recording.force_log import (
    ForceLog as ForceLog,
    make_force_log as make_force_log,
)
from palpate.recording.outline import (
    BENCH_FORMAT as BENCH_FORMAT,
    TEMPLATES as TEMPLATES,
    FolderSurvey as FolderSurvey,
    Outline as Outline,
    Template as Template,
    chosen_side as chosen_side,
    default_radius as default_radius,
    flat_sides as flat_sides,
    likely_template as likely_template,
    likely_unit as likely_unit,
    next_command as next_command,
    opposite_side as opposite_side,
    outline_text as outline_text,
    read_surface as read_surface,
    survey_folder as survey_folder,
)
from palpate.recording.pokes import (
    Pokes as Pokes,
    height_field as height_field,
    read_pokes as read_pokes,
    write_pokes as write_pokes,
)
from palpate.recording.record import (
    PlacedPress as PlacedPress,
    Recorded as Recorded,
    find_presses as find_presses,
    hysteresis as hysteresis,
    write_recorded as write_recorded,
)
from palpate.recording.recording_file import (
    Recording as Recording,
    read_recording as read_recording,
)
from palpate.recording.touches import (
    Reading as Reading,
    Touch as Touch,
    Zero as Zero,
    find_plateau as find_plateau,
    find_touches as find_touches,
    find_zero as find_zero,
    read_force as read_force,
    resample_force as resample_force,
    still_force as still_force,
    unreadable_reason as unreadable_reason,
)

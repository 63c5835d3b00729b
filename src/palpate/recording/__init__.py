"""From videos of presses and the log of a force gauge to a session.

Purpose    : find the presses in a recording, the clocks' offsets and the moments to measure at, and
             write them as a session.
Takes      : recording.toml: a video or pictures for each camera, a force log, a mesh, a rig.
Gives      : `Recorded`, a session folder; `survey_folder` and the outline of a session.
Depends on : `vision`, `bem`, `probe`, `records`, `geometry`.
Read first : `record.py`, then `force/touches.py`, `clock.py` and `session_folder.py`.
"""

from palpate.recording.folder_survey import (
    SIDES as SIDES,
    FolderSurvey as FolderSurvey,
    chosen_side as chosen_side,
    default_radius as default_radius,
    flat_sides as flat_sides,
    likely_unit as likely_unit,
    read_surface as read_surface,
    survey_folder as survey_folder,
)
from palpate.recording.outline import (
    TEMPLATES as TEMPLATES,
    Outline as Outline,
    Template as Template,
    likely_template as likely_template,
    outline_text as outline_text,
)
from palpate.recording.record import (
    Press as Press,
    Recorded as Recorded,
    find_presses as find_presses,
)
from palpate.recording.recording_file import (
    Recording as Recording,
    read_recording as read_recording,
)
from palpate.recording.session_folder import (
    PlacedPress as PlacedPress,
    hysteresis as hysteresis,
    write_recorded as write_recorded,
)

"""The measurement itself: an arm that probes, sensors that are read, files that are written.

Purpose    : carry out the probings, or the steps of a motion stage, of a configuration.
Takes      : configurations with a folder each; or a session that is not yet measured.
Gives      : session folders with ground truth; previews of the camera pictures; recordings of
             calibration boards, turntables and presses.
Depends on : `lab.pictures`, `solids`, `vision`, `records`, `geometry`.
Read first : `facility.py`, then `arm.py`, `session_text.py`.
"""

from palpate.lab.bench.facility import make_session as make_session, make_sessions as make_sessions
from palpate.lab.bench.planned_pictures import planned_pictures as planned_pictures
from palpate.lab.bench.press_film import (
    Film as Film,
    SolvedPress as SolvedPress,
    film_frames as film_frames,
    gauge_readings as gauge_readings,
    rest_pictures as rest_pictures,
    solve_press as solve_press,
    write_film as write_film,
)
from palpate.lab.bench.tutorial import (
    Print as Print,
    TutorialSize as TutorialSize,
    make_tutorial as make_tutorial,
)

"""The measurement itself: an arm that probes, sensors that are read, files that are written.

Purpose    : carry out all probings, or the steps of a stage, that a configuration asks for.
Takes      : configurations with a folder each; or a session that is not yet measured.
Gives      : session folders with their truth; or pictures of what the cameras will see.
Depends on : `lab.bodies`, `lab.pictures`, `vision`, `records`, `geometry`.
Read first : `facility.py`, then `arm.py`, `session_text.py`.
"""

from palpate.lab.bench.facility import make_session as make_session, make_sessions as make_sessions
from palpate.lab.bench.planned_pictures import planned_pictures as planned_pictures

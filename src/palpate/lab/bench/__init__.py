"""bench."""

from palpate.lab.bench.facility import make_session as make_session, make_sessions as make_sessions
from palpate.lab.bench.planned_pictures import planned_pictures as planned_pictures
from palpate.lab.bench.readings import force_std as force_std, read_force as read_force

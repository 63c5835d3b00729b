"""The viewer: an object, its probings and its model in a browser, or as pictures without one.

Purpose    : look at a session or a result, query the model at other constants, press the object,
             set support and contacts by clicking.
Takes      : a session, or a result folder of `palpate fit`.
Gives      : `Viewer`, a web page on a port of this computer; a picture, a turntable video; what
             other pages are made of.
Depends on : `figures`, `contact`, `simulation`, `pipeline`, `vision`, `estimation`, `records`,
             `geometry`.
Read first : `server.py`, then `panels.py`, `stage.py` and `subject.py`.
"""

from palpate.viewer.clicking import flat_face as flat_face
from palpate.viewer.scenes import (
    draw_arrows as draw_arrows,
    draw_camera as draw_camera,
    light as light,
    look as look,
    rgb as rgb,
)
from palpate.viewer.server import (
    Viewer as Viewer,
    open_server as open_server,
    stop_server as stop_server,
)
from palpate.viewer.stage import text_html as text_html
from palpate.viewer.stills import (
    write_screenshot as write_screenshot,
    write_turntable as write_turntable,
)
from palpate.viewer.subject import read_subject as read_subject

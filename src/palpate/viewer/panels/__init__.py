"""The controls beside the object, a file each.

Purpose    : what can be chosen and done in one browser tab.
Takes      : a tab's handles of viser, a `Workshop`, a `Stage`.
Gives      : sliders, lists and texts that change the stage.
Depends on : `estimation`, `pipeline`, `records`, `geometry`; files of its room.
Read first : `look.py`, then `material.py` and `touching.py`.
"""

from palpate.viewer.panels.look import LookPanel as LookPanel
from palpate.viewer.panels.material import MaterialPanel as MaterialPanel
from palpate.viewer.panels.pictures import PicturesPanel as PicturesPanel
from palpate.viewer.panels.setting import SettingPanel as SettingPanel
from palpate.viewer.panels.touching import TouchPanel as TouchPanel

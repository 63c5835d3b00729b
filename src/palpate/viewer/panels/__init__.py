"""Control panels next to the object, one file each.

Purpose    : the controls of one browser tab.
Takes      : a tab's viser handles, a `BackgroundWork`, a `Stage`.
Gives      : sliders, lists and texts that change the stage.
Depends on : `estimation`, `pipeline`, `records`, `geometry`; files of its room.
Read first : `look.py`, then `material.py` and `touching.py`.
"""

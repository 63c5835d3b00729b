"""Programs of others whose calibrations and displacements Palpate reads, one file each.

Purpose    : every program's names, units, signs of failure and camera conventions in one place.
Takes      : their result and calibration files; a program more is one new file with a `Program` and
             its name in the list of `registry.py`.
Gives      : a `Rig`, or `MeasuredPoints` in metres.
Depends on : records/program.py, records/measured_points.py, records/text.
Read first : `registry.py`, then `opencorr.py` (the shortest).
"""

from palpate.records.programs.registry import (
    import_kinds as import_kinds,
    kinds_text as kinds_text,
    read_calibration as read_calibration,
    read_measured as read_measured,
)

"""Files for simulators, one file each.

Purpose    : write an estimated object in the format of each simulator.
Takes      : `SolidModel` or `EstimatedObject`, a folder.
Gives      : the simulator's files; `FORMATS`, the list of all.
Depends on : `records`, `geometry`.
Read first : `registry.py`, then `calculix.py`.
"""

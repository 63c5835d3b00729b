"""Readers of other programs' calibrations and displacements, a file for each kind of program.

Purpose    : each program's names, units, failure marks and camera conventions in one place.
Takes      : its result and calibration files. To add a program: one new `Program`, in a file
             of its own or beside its kin, and its name in the list `PROGRAMS` of `registry.py`.
Gives      : a `Rig`, or `MeasuredPoints` in metres.
Depends on : `records.text`, `foreign`, `optional_imports`, `shapes`, `errors`.
Read first : `registry.py`, then `point_tables.py`, the shortest readers.
"""

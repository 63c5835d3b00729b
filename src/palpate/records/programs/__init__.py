"""Readers of other programs' calibrations and displacements, one file for each program.

Purpose    : each program's names, units, failure marks and camera conventions in one place.
Takes      : its result and calibration files. To add a program: one new file that ends in a
             `Program`, and one line for it in the list `PROGRAMS` of `registry.py`.
Gives      : a `Rig`, or `MeasuredPoints` in metres.
Depends on : `records.text`, `geometry`, `optional_imports`, `shapes`, `errors`.
Read first : `registry.py`, then `opencorr.py`, the shortest.
"""

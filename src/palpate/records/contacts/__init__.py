"""Contacts of tools.

Purpose    : what presses, where, and how its pressure is distributed.
Takes      : shapes and sizes of tools, points, radii.
Gives      : `Contact`, `Tool`, `PressureMap`, pressure profiles.
Depends on : `geometry`, `arrays`, `shapes`, `errors`.
Read first : `contact.py`.
"""

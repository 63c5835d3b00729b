"""Evaluation of a force gauge's log: times of contact, plateaus, and the force on each.

Purpose    : forces on the object, corrected for tool weight and zero drift, with standard
             deviations.
Takes      : a table of times and forces, or a robot's bag, and how to read it (`Gauge`).
Gives      : `ForceLog`, `Touch`, `Zero`, `Reading`.
Depends on : `records`.
Read first : `log.py`, `bags.py`, `touches.py`, `plateaus.py`.
"""

"""Checks of a session beyond its syntax: physical consistency and plausibility.

Purpose    : refuse what no experiment can give, and point out what is probably a mistake.
Takes      : the records of a session.
Gives      : nothing, an `InputError`, or notes in full sentences.
Depends on : `records.contacts`, `geometry`, `shapes`, `errors`.
Read first : `plausibility.py`.
"""

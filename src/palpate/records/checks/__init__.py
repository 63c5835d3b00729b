"""Checks of a session beyond its syntax: physical consistency and plausibility.

Purpose    : refuse what no experiment can give, and point out what is probably a mistake.
Takes      : the records of a session.
Gives      : nothing, an `InputError`, or notes in full sentences.
Depends on : `records.contacts`, `geometry`, `shapes`, `errors`.
Read first : `plausibility.py`.
"""

from palpate.records.checks.displacements import (
    check_copies as check_copies,
    check_observed_points as check_observed_points,
    copied_rows as copied_rows,
)
from palpate.records.checks.loads import check_contact as check_contact, check_load as check_load
from palpate.records.checks.plausibility import (
    check_error_lengths as check_error_lengths,
    plausibility_notes as plausibility_notes,
)

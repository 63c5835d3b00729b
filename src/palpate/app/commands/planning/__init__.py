"""Commands for a measurement that is still to be made.

Purpose    : read a session, have its further probings or its pictures planned, say what to expect.
Takes      : arguments of the command line, already of the right types.
Gives      : an exit code, tables, pictures.
Depends on : `app.terminal`, `bem`, `figures`, `lab`, `pipeline`, `records`.
Read first : `next_probings.py`, then `plan.py`.
"""

"""Commands about what other commands left: reports of results, words for a shell.

Purpose    : read what a command needs, have it made, say where it is.
Takes      : arguments of the command line, already of the right types.
Gives      : an exit code; report.html; a script for a shell.
Depends on : `app.terminal`, `report`.
Read first : `report.py`.
"""

"""Commands about what other commands left: reports of results, and whether results are unchanged.

Purpose    : read what a command needs, have it made, say where it is.
Takes      : arguments of the command line, already of the right types.
Gives      : an exit code; report.html.
Depends on : `app.terminal`, `records`, `report`.
Read first : `report.py`.
"""

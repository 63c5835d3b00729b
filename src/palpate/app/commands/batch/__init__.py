"""Commands about many sessions at once.

Purpose    : read what a command needs, have it done, print the table or draw it.
Takes      : arguments of the command line, already of the right types.
Gives      : an exit code; a campaign's folder, its table, its picture.
Depends on : `app.terminal`, `campaign`, `pipeline`, `figures`, `records`.
Read first : `campaign.py`.

Nothing is imported here: `palpate --help` must not load the numerics.
"""

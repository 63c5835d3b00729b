"""The command line: thin, no numerics.

Purpose    : the commands `palpate fit`, `check`, `flow`, `import`, `poke`, `compression`, `lab`,
             `calibrate`, `mesh`, `scan`, `record`, `measure`, `init`, `view`, `export`,
             `report`, `completion`, `compile`, `campaign` and `reproduce`.
Takes      : arguments of a shell.
Gives      : text on the terminal, a result folder, an exit code (0, 2 bad input, 3 not ok, 70 an
             error of the program, 128 and a signal's number).
Depends on : `paper`, `report`, `viewer`, `campaign`, `bench`, `figures`, `simulation`,
             `pipeline`, `calibration`, `scanning`, `recording`, `lab`, `field`, `estimation`,
             `bem`, `probe`, `records`, `geometry`.
Read first : `cli.py`, `arguments.py`, then `commands/fit.py`.

Nothing is imported here: `palpate --help` must not load the numerics.
"""

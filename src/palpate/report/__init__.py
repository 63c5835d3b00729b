"""The report of a fit: one self-contained HTML file.

Purpose    : present a result folder so that a reader can judge, print and reproduce the fit.
Takes      : a result folder of `palpate fit`.
Gives      : report.html: verdict, constants, an interactive 3-D view, probings, likelihood,
             predictions, errors, rejected points, and all settings needed to reproduce it; text
             and tables for a paper.
Depends on : `figures`, `pipeline`, `estimation`, `records`, `geometry`, `files`, `disk`.
Read first : `report.py`, then `scene.py` and `templates/page.html`.
"""

from palpate.report.for_paper import write_for_paper as write_for_paper
from palpate.report.report import (
    write_report as write_report,
    write_result_files as write_result_files,
)

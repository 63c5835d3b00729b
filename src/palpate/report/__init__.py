"""The report of a fit: one HTML file that needs nothing else.

Purpose    : say what a result folder holds so that a person can judge it, print it and repeat it.
Takes      : a result folder of `palpate fit`.
Gives      : report.html: verdict, constants, a view that turns, probings, likelihood, predictions,
             errors, what was rejected, and all that is needed to repeat it.
Depends on : `figures`, `pipeline`, `estimation`, `records`, `geometry`, `files`, `disk`.
Read first : `report.py`, then `scene.py` and `templates/page.html`.
"""

from palpate.report.report import (
    REPORT_FILE as REPORT_FILE,
    checked_result as checked_result,
    write_report as write_report,
    write_result_files as write_result_files,
)

"""The paper's experiments, reproduced on the virtual bench.

Purpose    : reproduce tables 1 to 3 and figures 2 to 4 of Lang and Pai (2001), with an error
             budget of table 3.
Takes      : built-in configurations of the lab.
Gives      : `PaperResult`: text, tables and pictures, as files and as a page.
Depends on : `figures`, `pipeline`, `lab`, `estimation`, `vision`, `solids`, `records`,
             `geometry`.
Read first : `sessions.py`, then `experiments.py`.
"""

from palpate.paper.experiments import (
    EXPERIMENTS as EXPERIMENTS,
    ExperimentRun as ExperimentRun,
    run_experiments as run_experiments,
)
from palpate.paper.result import (
    check_page as check_page,
    shown_rows as shown_rows,
    write_page as write_page,
    write_result as write_result,
)
from palpate.paper.sessions import true_material as true_material

"""paper."""

from palpate.paper.experiments import (
    EXPERIMENTS as EXPERIMENTS,
    Experiment as Experiment,
    Workplace as Workplace,
)
from palpate.paper.motion import (
    PaperSession as PaperSession,
    measured_session as measured_session,
    quickened as quickened,
)
from palpate.paper.result import (
    PaperResult as PaperResult,
    check_page as check_page,
    write_page as write_page,
    write_result as write_result,
)
from palpate.paper.result_table import terminal_table as terminal_table

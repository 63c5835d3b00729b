"""What commands write on the terminal.

Purpose    : tables, notes and a progress bar that look alike in every command, or as JSON.
Takes      : texts; `Estimate`, `MotionFigures`.
Gives      : rich tables; lines on stdout and stderr.
Depends on : `pipeline`, `records`.
Read first : `tables.py`.
"""

from palpate.app.terminal.notes import (
    print_file_notes as print_file_notes,
    print_notes as print_notes,
)
from palpate.app.terminal.output import (
    print_tables as print_tables,
    print_text as print_text,
)
from palpate.app.terminal.progress import StageLog as StageLog, progress_bar as progress_bar
from palpate.app.terminal.tables import (
    budget_sentences as budget_sentences,
    constants_table as constants_table,
    flow_table as flow_table,
    number_text as number_text,
    probes_table as probes_table,
    terminal_table as terminal_table,
)

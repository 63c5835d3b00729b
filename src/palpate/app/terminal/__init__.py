"""terminal."""

from palpate.app.terminal.flow_table import flow_table as flow_table
from palpate.app.terminal.notes import print_notes as print_notes
from palpate.app.terminal.progress import progress_bar as progress_bar
from palpate.app.terminal.tables import (
    constants_table as constants_table,
    probes_table as probes_table,
)

"""Many sessions at once, on the cores of one machine or on many machines.

Purpose    : fit every session of a list, resume after any interruption, and summarise the results.
Takes      : a list of sessions, or a folder tree with sessions; workers.
Gives      : a folder with a table in SQLite and CSV and every result; a summary figure.
Depends on : `pipeline`, `estimation`, `bem`, `figures`, `records`.
Read first : `campaign.py`, then `work.py`, `engine.py`.
"""

from palpate.campaign.campaign import (
    run_campaign as run_campaign,
)
from palpate.campaign.engine import (
    check_workers as check_workers,
    started_engine as started_engine,
)
from palpate.campaign.rows import (
    DONE as DONE,
    FAILED as FAILED,
    WAITING as WAITING,
    Row as Row,
    campaign_figure as campaign_figure,
    groups_of as groups_of,
    outliers as outliers,
    write_table as write_table,
)
from palpate.campaign.store import (
    Store as Store,
    read_items as read_items,
)
from palpate.campaign.work import (
    FitOptions as FitOptions,
)

"""Runs a campaign: many sessions on many workers, resumable after any interruption."""

import posixpath
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from palpate.campaign.engine import Engine, started_engine
from palpate.campaign.items import CampaignItem
from palpate.campaign.package import PackedSession, pack_session, packed
from palpate.campaign.rows import DONE, Row
from palpate.campaign.store import TABLE_TEXT, Store
from palpate.campaign.table import table_text
from palpate.campaign.work import FitOptions, Outcome, Work
from palpate.disk import folder_made, placed
from palpate.errors import InputError, PalpateError
from palpate.progress import Progress, silent
from palpate.records import read_toml


def run_campaign(
    items: Sequence[CampaignItem],
    folder: Path,
    *,
    options: FitOptions = FitOptions(),
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress = silent,
) -> tuple[Row, ...]:
    """Fit all sessions of a list; results of an earlier run of the same campaign are reused.

    Local workers are processes that import the calling script again: in a script, call this
    function below `if __name__ == "__main__":`.

    Parameters
    ----------
    items : sequence of CampaignItem
    folder : Path                   of the campaign: created, or continued
    options : FitOptions
    scheduler, workers              as in `started_engine`
    progress : callable             called with the number of sessions that have ended (text), and
                                    their fraction, 0 to 1

    Returns
    -------
    tuple of Row                    one per session; a session that cannot be fitted has a message

    Raises
    ------
    InputError                      the folder is not a campaign's, or another process works on it;
                                    no workers, or workers with other versions
    RecordError                     the disk is full or fails; existing results are kept
    """
    store = Store(folder)
    if not store.may_begin():
        raise InputError(
            f"{folder}: is there and no campaign; choose another place with --out, or remove it"
        )
    # The lock on the table file is the lock on the whole campaign.
    with (
        folder_made(folder),
        placed([folder / TABLE_TEXT]) as (staged,),
        ExitStack() as stack,
    ):
        stack.callback(store.clear)
        store.begin(items)
        run = _Run(store, options, lambda: stack.enter_context(started_engine(scheduler, workers)))
        run.work_through(items, progress)
        rows = store.rows()
        staged.write_text(table_text(rows), encoding="utf-8")
    return rows


class _Run:
    """One run of a campaign: the work in progress, and the sessions that it belongs to."""

    def __init__(self, store: Store, options: FitOptions, start_engine: Any) -> None:
        self.store, self.options = store, options
        self._start_engine = start_engine
        self._engine: Engine | None = None
        self._whose: dict[str, list[CampaignItem]] = {}
        self._bodies: set[str] = set()
        self._known = {row.session: row for row in store.rows()}

    def work_through(self, items: Sequence[CampaignItem], progress: Progress) -> None:
        """Process all sessions, until each has its row in the table."""
        waiting = deque(items)
        while waiting or (self._engine is not None and self._engine.is_busy):
            while waiting and (self._engine is None or self._engine.has_room):
                self._begin(waiting.popleft())
            in_hand = sum(map(len, self._whose.values()))
            ended = len(items) - len(waiting) - in_hand
            progress(f"{ended} of {len(items)} sessions", ended / len(items))
            if self._engine is not None and self._engine.is_busy:
                for work, outcome in self._engine.ended():
                    self._take(work, outcome)
        progress(f"{len(items)} of {len(items)} sessions", 1.0)

    def _begin(self, item: CampaignItem) -> None:
        """Start the work on a session, unless its result exists or it cannot be read."""
        try:
            session = pack_session(item.path)
            blind, body = _described(item.path, session)
        except PalpateError as error:
            failed = Outcome(packed({}), str(error), 0.0)
            self.store.set_row(self.store.row_of(item, None, failed))
            return
        work = Work("fit", session, self.options, shared_body=body in self._bodies)
        self._bodies |= {body} - {""}
        if self.store.is_done(work):
            row = self._known[item.name]
            if (row.state, row.address) != (DONE, work.address):
                self.store.set_row(self.store.row_of(item, work, None))
            return
        whose = self._whose.setdefault(work.address, [])
        whose.append(item)
        if len(whose) == 1:
            motion = replace(work, kind="motion")
            known = self.store.motion(motion) if blind else None
            self._hand_out(motion if blind and known is None else replace(work, motion=known))

    def _hand_out(self, work: Work) -> None:
        if self._engine is None:
            self._engine = self._start_engine()
        self._engine.begin(work)

    def _take(self, work: Work, outcome: Outcome) -> None:
        """Store the outcome of a piece of work; a motion is followed by the fit."""
        if not outcome.failure:
            self.store.keep(work, outcome.package)
        if work.kind == "motion" and not outcome.failure:
            self._hand_out(replace(work, kind="fit", motion=self.store.motion(work)))
            return
        fit = replace(work, kind="fit")
        for item in self._whose.pop(fit.address):
            self.store.set_row(self.store.row_of(item, fit, outcome))


def _described(path: Path, session: PackedSession) -> tuple[bool, str]:
    """Whether a session's motion must still be measured in pictures; checksum of its mesh."""
    file = path / "session.toml" if path.is_dir() else path
    values = read_toml(file).values
    probes = values.get("probe")
    blind = isinstance(probes, list) and any(
        isinstance(one, dict) and "images" in one and "displacement" not in one for one in probes
    )
    body = values.get("object")
    mesh = str(body.get("mesh")) if isinstance(body, dict) else ""
    place = posixpath.normpath(posixpath.join(posixpath.dirname(session.session), mesh))
    return blind, session.package.sums.get(place, "")

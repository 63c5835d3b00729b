"""Runs a campaign: many sessions on many workers, resumable after any interruption."""

import posixpath
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from palpate.campaign.engine import Engine, started_engine, worker_share
from palpate.campaign.items import CampaignItem
from palpate.campaign.package import PackedSession, pack_files, pack_session
from palpate.campaign.rows import DONE, Row
from palpate.campaign.store import TABLE_TEXT, Store
from palpate.campaign.table import table_text
from palpate.campaign.work import FitOptions, Outcome, Work, do_work
from palpate.disk import atomic_replacement, created_folder
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
        created_folder(folder),
        atomic_replacement([folder / TABLE_TEXT]) as (staged,),
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
        self._items_of: dict[str, list[CampaignItem]] = {}
        self._known_meshes: set[str] = set()
        self._known_rows = {row.session: row for row in store.rows()}

    def work_through(self, items: Sequence[CampaignItem], progress: Progress) -> None:
        """Process all sessions, until each has its row in the table."""
        waiting = deque(items)
        while waiting or (self._engine is not None and self._engine.is_busy):
            while waiting and (self._engine is None or self._engine.has_room):
                self._start(waiting.popleft())
            in_progress = sum(map(len, self._items_of.values()))
            ended = len(items) - len(waiting) - in_progress
            progress(f"{ended} of {len(items)} sessions", ended / len(items))
            if self._engine is not None and self._engine.is_busy:
                for work, found in self._engine.wait_for_ended():
                    self._store_outcome(work, _outcome(found))
        progress(f"{len(items)} of {len(items)} sessions", 1.0)

    def _start(self, item: CampaignItem) -> None:
        """Start the work on a session, unless its result exists or it cannot be read."""
        try:
            session = pack_session(item.path)
            needs_motion, mesh_sum = _inspect(item.path, session)
        except PalpateError as error:
            failed = Outcome(pack_files({}), str(error), 0.0)
            self.store.set_row(self.store.row_of(item, None, failed))
            return
        work = Work("fit", session, self.options, shared_body=mesh_sum in self._known_meshes)
        self._known_meshes |= {mesh_sum} - {""}
        if self.store.is_done(work):
            row = self._known_rows[item.name]
            if (row.state, row.address) != (DONE, work.digest):
                self.store.set_row(self.store.row_of(item, work, None))
            return
        waiting = self._items_of.setdefault(work.digest, [])
        waiting.append(item)
        if len(waiting) == 1:
            motion = replace(work, kind="motion")
            known = self.store.motion(motion) if needs_motion else None
            self._submit(motion if needs_motion and known is None else replace(work, motion=known))

    def _submit(self, work: Work) -> None:
        if self._engine is None:
            self._engine = self._start_engine()
        self._engine.submit(work_on_worker, work)

    def _store_outcome(self, work: Work, outcome: Outcome) -> None:
        """Store the outcome of a piece of work; a motion is followed by the fit."""
        if not outcome.failure:
            self.store.save_result(work, outcome.package)
        if work.kind == "motion" and not outcome.failure:
            self._submit(replace(work, kind="fit", motion=self.store.motion(work)))
            return
        fit = replace(work, kind="fit")
        for item in self._items_of.pop(fit.digest):
            self.store.set_row(self.store.row_of(item, fit, outcome))


def work_on_worker(work: Work) -> Outcome:
    """Do a piece of work on a worker, in its own folder and within its share of the memory.

    Parameters
    ----------
    work : Work

    Returns
    -------
    Outcome                         as in `do_work`
    """
    folder, memory = worker_share()
    return do_work(work, folder=folder, memory=memory)


def _outcome(found: Outcome | PalpateError) -> Outcome:
    """What a worker gave, as an outcome."""
    return found if isinstance(found, Outcome) else Outcome(pack_files({}), str(found), 0.0)


def _inspect(path: Path, session: PackedSession) -> tuple[bool, str]:
    """Whether a session's motion must still be measured in pictures; checksum of its mesh."""
    file = path / "session.toml" if path.is_dir() else path
    values = read_toml(file).values
    probes = values.get("probe")
    needs_motion = isinstance(probes, list) and any(
        isinstance(probe, dict) and "images" in probe and "displacement" not in probe
        for probe in probes
    )
    body = values.get("object")
    mesh = str(body.get("mesh")) if isinstance(body, dict) else ""
    place = posixpath.normpath(posixpath.join(posixpath.dirname(session.session), mesh))
    return needs_motion, session.package.sums.get(place, "")

"""Runs a campaign: many sessions on many workers, resumable after any interruption."""

import posixpath
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from palpate.campaign.cluster import started_engine
from palpate.campaign.engine import Engine, worker_share
from palpate.campaign.items import CampaignItem
from palpate.campaign.motions import motion_works
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


@dataclass(slots=True, eq=False)
class _WaitingFit:
    """A fit that waits for motions to be measured.

    Attributes
    ----------
    work : Work                     the fit
    keys : dict of str to str       of all motions that it needs, by probing
    missing : set of str            digests of the works that measure them and have not ended
    """

    work: Work
    keys: dict[str, str]
    missing: set[str]


class _Run:
    """One run of a campaign: the work in progress, and the sessions that it belongs to."""

    def __init__(self, store: Store, options: FitOptions, start_engine: Any) -> None:
        self.store, self.options = store, options
        self._start_engine = start_engine
        self._engine: Engine | None = None
        self._items_of: dict[str, list[CampaignItem]] = {}
        self._ready: deque[Work] = deque()
        self._fits_after: dict[str, list[_WaitingFit]] = {}
        self._known_meshes: set[str] = set()
        self._known_rows = {row.session: row for row in store.rows()}

    def work_through(self, items: Sequence[CampaignItem], progress: Progress) -> None:
        """Process all sessions, until each has its row in the table."""
        waiting = deque(items)
        while waiting or self._ready or (self._engine is not None and self._engine.is_busy):
            while (self._ready or waiting) and (self._engine is None or self._engine.has_room):
                if self._ready:
                    self._submit(self._ready.popleft())
                else:
                    self._start(waiting.popleft())
            in_progress = sum(map(len, self._items_of.values()))
            ended = len(items) - len(waiting) - in_progress
            progress(f"{ended} of {len(items)} sessions", ended / len(items))
            if self._engine is not None and self._engine.is_busy:
                for work, found in self._engine.wait_for_ended():
                    self._store_outcome(work, _outcome(found))
        progress(f"{len(items)} of {len(items)} sessions", 1.0)

    def _start(self, item: CampaignItem) -> None:
        """Prepare the work on a session, unless its result exists or it cannot be read."""
        try:
            session = pack_session(item.path)
            needs_motion, mesh_sum = _inspect(item.path, session)
        except PalpateError as error:
            self._fail(item, error)
            return
        fit = Work("fit", session, self.options, shared_body=mesh_sum in self._known_meshes)
        self._known_meshes |= {mesh_sum} - {""}
        if self.store.is_done(fit):
            row = self._known_rows[item.name]
            if (row.state, row.address) != (DONE, fit.digest):
                self.store.set_row(self.store.row_of(item, fit, None))
            return
        if fit.digest not in self._items_of:
            try:
                motions = motion_works(item.path, session, self.options) if needs_motion else ()
            except PalpateError as error:
                self._fail(item, error)
                return
            self._prepare(fit, motions)
        self._items_of.setdefault(fit.digest, []).append(item)

    def _fail(self, item: CampaignItem, error: PalpateError) -> None:
        """Write the row of a session that cannot be read."""
        failed = Outcome(pack_files({}), str(error), 0.0)
        self.store.set_row(self.store.row_of(item, None, failed))

    def _prepare(self, fit: Work, motions: Sequence[Work]) -> None:
        """Prepare a fit and the motions that it needs and that are not known yet."""
        keys = {name: key for work in motions for name, key in work.keys.items()}
        waiting = _WaitingFit(fit, keys, set())
        for work in motions:
            unknown = {n: key for n, key in work.keys.items() if self.store.motion(key) is None}
            work = replace(work, keys=unknown)
            if unknown and work.digest not in self._fits_after:
                self._ready.append(work)
            if unknown:
                self._fits_after.setdefault(work.digest, []).append(waiting)
                waiting.missing.add(work.digest)
        self._continue(waiting)

    def _continue(self, fit: _WaitingFit) -> None:
        """Let a fit begin whose motions are all known."""
        if not fit.missing:
            motions = {name: self.store.motion(key) for name, key in fit.keys.items()}
            known = {name: motion for name, motion in motions.items() if motion is not None}
            self._ready.append(replace(fit.work, motions=known))

    def _submit(self, work: Work) -> None:
        if self._engine is None:
            self._engine = self._start_engine()
        self._engine.submit(work_on_worker, work)

    def _store_outcome(self, work: Work, outcome: Outcome) -> None:
        """Store the outcome of a piece of work; the last motion is followed by the fit."""
        if not outcome.failure:
            self.store.save_result(work, outcome.package)
        if work.kind == "fit":
            self._end(work, outcome)
            return
        for fit in self._fits_after.pop(work.digest):
            if outcome.failure:
                self._end(fit.work, outcome)
            else:
                fit.missing.remove(work.digest)
                self._continue(fit)

    def _end(self, fit: Work, outcome: Outcome) -> None:
        """Write the rows of a fit's sessions, unless another of its motions had failed before."""
        for item in self._items_of.pop(fit.digest, ()):
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

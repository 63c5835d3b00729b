"""Runs a campaign: many sessions on many workers, resumable after any interruption.

Before a session's fit come the motion in its pictures and its body, as pieces of work. A motion is
that of probings that share pictures at rest. An instant is followed from the one before it, and the
start from the pictures at rest takes as long as several instants: pieces of fewer would cost more
than they bring.
"""

import shutil
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from palpate.campaign.engine import Engine, started_engine, worker_share
from palpate.campaign.rows import DONE, Row, table_text
from palpate.campaign.store import TABLE_TEXT, CampaignItem, Store
from palpate.campaign.work import (
    FitOptions,
    Outcome,
    PackedSession,
    Work,
    do_work,
    pack_session,
    real_session_file,
    without_files,
)
from palpate.disk import atomic_replacement, created_folder
from palpate.errors import InputError, PalpateError
from palpate.pipeline import kept_motion_keys, picture_files, unread_probings
from palpate.progress import Progress, silent
from palpate.records import file_sum, read_session, read_toml

# Fits per worker thread that are submitted at a time, those that wait for motions and bodies
# included: their sessions take memory.
_FITS_PER_THREAD = 6
# Instants in a piece, if the probings with the same pictures at rest have as many: the start, which
# takes as long as five, is then a sixth of it.
_LEAST_INSTANTS = 25
# Folder of what is computed of bodies, in that of the campaign until the command ends.
_BODIES = "bodies"


def run_campaign(
    items: Sequence[CampaignItem],
    folder: Path,
    *,
    options: FitOptions = FitOptions(),
    scheduler: str | None = None,
    workers: int | None = None,
    insecure: bool = False,
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
    scheduler, workers, insecure    as in `started_engine`
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
        atomic_replacement(folder / TABLE_TEXT) as staged,
        ExitStack() as stack,
    ):
        stack.callback(store.clear)
        store.begin(items)
        engine = started_engine(scheduler, workers, insecure=insecure)
        # On workers that share no folder, what is computed of a body would have to travel, which
        # takes longer than to compute it: each of them keeps what its own fits compute.
        cache = None if scheduler else (folder / _BODIES).absolute()
        stack.callback(shutil.rmtree, folder / _BODIES, ignore_errors=True)
        run = _Run(store, options, cache, lambda: stack.enter_context(engine))
        run.work_through(items, progress)
        rows = store.rows()
        staged.write_text(table_text(rows), encoding="utf-8")
    return rows


class _Run:
    """One run of a campaign: the work in progress, and the sessions that it belongs to."""

    def __init__(
        self,
        store: Store,
        options: FitOptions,
        cache: Path | None,
        start_engine: Callable[[], Engine],
    ) -> None:
        self.store, self.options, self.cache = store, options, cache
        self._start_engine = start_engine
        self._engine: Engine | None = None
        self._works: dict[Any, Work] = {}
        self._items_of: dict[str, list[CampaignItem]] = {}
        # Futures of motions and bodies, by digest; None: the body is there.
        self._before: dict[str, Any] = {}
        self._known_rows = {row.session: row for row in store.rows()}

    def work_through(self, items: Sequence[CampaignItem], progress: Progress) -> None:
        """Process all sessions, until each has its row in the table."""
        meshes = shared_meshes(items)
        waiting = deque(items)
        while waiting or self._works:
            while waiting and self._has_room:
                item = waiting.popleft()
                self._start(item, meshes.get(item.name, ""))
            in_progress = sum(map(len, self._items_of.values()))
            ended = len(items) - len(waiting) - in_progress
            progress(f"{ended} of {len(items)} sessions", ended / len(items))
            if self._engine is not None and self._works:
                for future in self._engine.wait_for_ended(self._works):
                    self._store_outcome(self._works.pop(future), self._engine.result(future))
        progress(f"{len(items)} of {len(items)} sessions", 1.0)

    @property
    def _has_room(self) -> bool:
        """Whether another session should be read."""
        # The scheduler is asked for its threads only where their number may matter.
        if self._engine is None or len(self._items_of) < _FITS_PER_THREAD:
            return True
        return len(self._items_of) < _FITS_PER_THREAD * self._engine.threads

    def _start(self, item: CampaignItem, mesh: str) -> None:
        """Submit the work on a session, unless its result exists or it cannot be read.

        `mesh`: checksum of the one that it shares with other sessions, or empty.
        """
        try:
            session = pack_session(item.path)
            is_unmeasured = _needs_motion(item.path)
        except PalpateError as error:
            self.store.set_row(self.store.row_of(item, None, error))
            return
        fit = Work("fit", session, self.options, shared_body=bool(mesh))
        if self.store.is_done(fit):
            row = self._known_rows[item.name]
            if (row.state, row.address) != (DONE, fit.digest):
                self.store.set_row(self.store.row_of(item, fit, None))
            return
        if fit.digest not in self._items_of:
            try:
                motions = motion_works(item.path, session, self.options) if is_unmeasured else ()
            except PalpateError as error:
                self.store.set_row(self.store.row_of(item, None, error))
                return
            self._submit_fit(fit, motions, mesh)
        self._items_of.setdefault(fit.digest, []).append(item)

    def _submit_fit(self, fit: Work, motions: Sequence[Work], mesh: str) -> None:
        """Submit a fit, after its body and those of its motions that are not known yet."""
        keys = {name: key for work in motions for name, key in work.keys.items()}
        stored = {key: self.store.motion(key) for key in keys.values()}
        known = {key: motion for key, motion in stored.items() if motion is not None}
        before = []
        if self.cache is not None and mesh:
            before.append(body_work(fit.session, self.options, mesh))
        for work in motions:
            unknown = {name: key for name, key in work.keys.items() if key not in known}
            if unknown:
                before.append(replace(work, keys=unknown))
        for work in before:
            if work.digest not in self._before:
                self._before[work.digest] = self._submit(work, [])
        self._submit(
            replace(fit, keys=keys, motions=known), [self._before[work.digest] for work in before]
        )

    def _submit(self, work: Work, before: Sequence[Any]) -> Any:
        """Submit a piece of work that begins when others have ended; gives its future."""
        if self._engine is None:
            self._engine = self._start_engine()
        future = self._engine.submit(work_on_worker, work, self.cache, before)
        self._works[future] = work
        return future

    def _store_outcome(self, work: Work, outcome: Outcome | PalpateError) -> None:
        """Store what a piece of work gave; where a motion failed, so did the fits after it."""
        if work.kind == "fit":
            if isinstance(outcome, Outcome):
                self.store.save_result(work, outcome.files)
            for item in self._items_of.pop(work.digest):
                self.store.set_row(self.store.row_of(item, work, outcome))
        elif work.kind == "motion":
            del self._before[work.digest]
            if isinstance(outcome, Outcome):
                for key, motion in outcome.files.items():
                    self.store.save_motion(key, motion)
        else:
            self._before[work.digest] = None


def work_on_worker(work: Work, cache: Path | None, before: Sequence[Outcome | None]) -> Outcome:
    """Do a piece of work on a worker, in its own folder and within its share of the memory.

    Parameters
    ----------
    work : Work
    cache : Path or None            as in `do_work`
    before : sequence               outcomes of motions that a fit needs; others are ignored

    Returns
    -------
    Outcome                         as in `do_work`; of a body that failed none, as the fits that
                                    need it fail with a message of their own
    """
    folder, memory = worker_share()
    motions = dict(work.motions)
    for outcome in before:
        motions |= outcome.files if outcome else {}
    try:
        return do_work(replace(work, motions=motions), folder=folder, cache=cache, memory=memory)
    except PalpateError:
        if work.kind != "body":
            raise
        return Outcome({}, 0.0)


def motion_works(path: Path, packed: PackedSession, options: FitOptions) -> tuple[Work, ...]:
    """Pieces of work that measure the motion in a session's pictures.

    Parameters
    ----------
    path : Path                     folder of the session, or a session file in it
    packed : PackedSession          its files
    options : FitOptions

    Returns
    -------
    tuple of Work                   each of probings with the same pictures at rest, at least 25
                                    instants if they have as many, without the other probings'
                                    pictures; empty where all displacements are in files

    Raises
    ------
    InputError                      pictures without a rig
    RecordError, CalibrationError   the session or its rig cannot be read
    """
    session = read_session(path)
    groups: dict[str, dict[str, int]] = {}
    for probing in unread_probings(session):
        if probing.images is not None:
            group = groups.setdefault(probing.images.rest, {})
            group[probing.name] = len(probing.images.loaded)
    if not groups:
        return ()
    keys, files = kept_motion_keys(session, options.pose), picture_files(session)
    works = []
    for names in (piece for group in groups.values() for piece in _pieces(group)):
        needed = {file for name in names for file in files[name]}
        others = {file for pictures in files.values() for file in pictures} - needed
        motions = {name: keys[name] for name in names}
        works.append(Work("motion", without_files(packed, others), options, motions))
    return tuple(works)


def _needs_motion(path: Path) -> bool:
    """Whether a session's motion must still be measured in pictures.

    Parameters
    ----------
    path : Path                     folder of the session, or a session file in it

    Raises
    ------
    RecordError                     the session file cannot be read
    """
    probes = _tables(path).get("probe")
    return isinstance(probes, list) and any(
        isinstance(probe, dict) and "images" in probe and "displacement" not in probe
        for probe in probes
    )


def body_work(packed: PackedSession, options: FitOptions, mesh: str) -> Work:
    """The piece of work that computes what the fits of a session's body share.

    Parameters
    ----------
    packed : PackedSession          one of the sessions of this body
    options : FitOptions
    mesh : str                      checksum of the mesh

    Returns
    -------
    Work                            the same digest for all sessions of this body
    """
    return Work("body", packed, options, {"mesh": mesh})


def shared_meshes(items: Sequence[CampaignItem]) -> dict[str, str]:
    """Checksums of the meshes that several sessions have.

    Parameters
    ----------
    items : sequence of CampaignItem

    Returns
    -------
    dict of str to str              SHA-256 of the mesh, 64 digits, by the name of each session that
                                    shares it with another one; none for sessions that cannot be
                                    read
    """
    mesh_of: dict[str, str] = {}
    for item in items:
        with suppress(PalpateError, OSError):
            mesh_of[item.name] = _mesh_checksum(item.path)
    counts = Counter(mesh_of.values())
    return {name: mesh for name, mesh in mesh_of.items() if counts[mesh] > 1}


def _mesh_checksum(path: Path) -> str:
    """SHA-256 of a session's mesh."""
    body = _tables(path).get("object")
    mesh = body.get("mesh") if isinstance(body, dict) else None
    return file_sum(real_session_file(path).parent / str(mesh))


def _tables(path: Path) -> Mapping[str, Any]:
    """The tables of a session file."""
    return read_toml(real_session_file(path)).values


def _pieces(instants: Mapping[str, int]) -> Iterator[Sequence[str]]:
    """Probings by name in pieces of enough instants; those that are left join the last piece."""
    piece, count, left = list[str](), 0, sum(instants.values())
    for name, instant_count in instants.items():
        piece.append(name)
        count, left = count + instant_count, left - instant_count
        if min(count, left) >= _LEAST_INSTANTS:
            yield piece
            piece, count = [], 0
    yield piece

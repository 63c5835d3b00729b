"""Runs a campaign: many sessions on many workers, resumable after any interruption.

Before a session's fit come the motion in its pictures and its body, as pieces of work. A motion is
that of probings that share pictures at rest. An instant is followed from the one before it, and the
start from the pictures at rest takes as long as several instants: pieces of fewer would cost more
than they bring.
"""

from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
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
    pack_files,
    pack_session,
    real_session_file,
    without_files,
)
from palpate.disk import atomic_replacement, created_folder
from palpate.errors import InputError, PalpateError
from palpate.pipeline import kept_motion_keys, picture_files, unread_probings
from palpate.progress import Progress, silent
from palpate.records import file_sum, read_session, read_toml

# Fits per worker thread that may wait for motions and bodies: their sessions take memory.
_HELD_PER_THREAD = 8
# Instants in a piece, if the probings with the same pictures at rest have as many: the start, which
# takes as long as five, is then a sixth of it.
_LEAST_INSTANTS = 25


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
        atomic_replacement([folder / TABLE_TEXT]) as (staged,),
        ExitStack() as stack,
    ):
        stack.callback(store.clear)
        store.begin(items)
        engine = started_engine(scheduler, workers, insecure=insecure)
        run = _Run(store, options, lambda: stack.enter_context(engine))
        # On workers that share no folder, what is computed of a body would have to travel, which
        # takes longer than to compute it: each of them keeps what its own fits compute.
        run.work_through(items, progress, bodies_first=scheduler is None)
        rows = store.rows()
        staged.write_text(table_text(rows), encoding="utf-8")
    return rows


@dataclass(slots=True, eq=False)
class _WaitingFit:
    """A fit that waits for motions to be measured, and for what it shares with others of its body.

    Attributes
    ----------
    work : Work                     the fit
    keys : dict of str to str       of all motions that it needs, by probing
    missing : set of str            digests of the works before it that have not ended
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
        self._ended_bodies: set[str] = set()
        self._known_rows = {row.session: row for row in store.rows()}

    def work_through(
        self, items: Sequence[CampaignItem], progress: Progress, *, bodies_first: bool
    ) -> None:
        """Process all sessions, until each has its row in the table.

        `bodies_first`: what fits of one body share is a piece of work that they wait for.
        """
        meshes = shared_meshes(items)
        waiting = deque(items)
        while waiting or self._ready or (self._engine is not None and self._engine.is_busy):
            while (self._ready or waiting) and (self._engine is None or self._engine.has_room):
                if self._ready:
                    self._submit(self._ready.popleft())
                elif self._holds_enough:
                    break
                else:
                    item = waiting.popleft()
                    self._start(item, meshes.get(item.name, ""), bodies_first=bodies_first)
            in_progress = sum(map(len, self._items_of.values()))
            ended = len(items) - len(waiting) - in_progress
            progress(f"{ended} of {len(items)} sessions", ended / len(items))
            if self._engine is not None and self._engine.is_busy:
                for work, found in self._engine.wait_for_ended():
                    self._store_outcome(work, _outcome(found))
        progress(f"{len(items)} of {len(items)} sessions", 1.0)

    @property
    def _holds_enough(self) -> bool:
        """Whether so many fits wait for other work that no more sessions should be read yet."""
        held = sum(map(len, self._fits_after.values()))
        # The scheduler is asked for its threads only where their number may matter.
        if self._engine is None or held < _HELD_PER_THREAD:
            return False
        return held >= _HELD_PER_THREAD * self._engine.threads

    def _start(self, item: CampaignItem, mesh: str, *, bodies_first: bool) -> None:
        """Prepare the work on a session, unless its result exists or it cannot be read.

        `mesh`: checksum of the one that it shares with other sessions, or empty.
        """
        try:
            session = pack_session(item.path)
            is_unmeasured = _needs_motion(item.path)
        except PalpateError as error:
            self._fail(item, error)
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
                self._fail(item, error)
                return
            body = body_work(session, self.options, mesh) if bodies_first and mesh else None
            self._prepare(fit, motions, body)
        self._items_of.setdefault(fit.digest, []).append(item)

    def _fail(self, item: CampaignItem, error: PalpateError) -> None:
        """Write the row of a session that cannot be read."""
        failed = Outcome(pack_files({}), str(error), 0.0)
        self.store.set_row(self.store.row_of(item, None, failed))

    def _prepare(self, fit: Work, motions: Sequence[Work], body: Work | None) -> None:
        """Prepare a fit, and its body and motions that are not known yet."""
        keys = {name: key for work in motions for name, key in work.keys.items()}
        waiting = _WaitingFit(fit, keys, set())
        if body is not None and body.digest not in self._ended_bodies:
            self._hold(waiting, body)
        for work in motions:
            unknown = {n: key for n, key in work.keys.items() if self.store.motion(key) is None}
            if unknown:
                self._hold(waiting, replace(work, keys=unknown))
        self._continue(waiting)

    def _hold(self, fit: _WaitingFit, work: Work) -> None:
        """Have a fit wait for a piece of work, which other fits may wait for already."""
        if work.digest not in self._fits_after:
            self._ready.append(work)
        self._fits_after.setdefault(work.digest, []).append(fit)
        fit.missing.add(work.digest)

    def _continue(self, fit: _WaitingFit) -> None:
        """Let a fit begin that waits for nothing more."""
        if not fit.missing:
            motions = {name: self.store.motion(key) for name, key in fit.keys.items()}
            known = {name: motion for name, motion in motions.items() if motion is not None}
            self._ready.append(replace(fit.work, motions=known))

    def _submit(self, work: Work) -> None:
        if self._engine is None:
            self._engine = self._start_engine()
        self._engine.submit(work_on_worker, work)

    def _store_outcome(self, work: Work, outcome: Outcome) -> None:
        """Store the outcome of a piece of work; the last one before a fit is followed by it.

        Of a body, the workers keep what was computed. Where that failed, so will the fits that need
        it, each with a message of its own.
        """
        if work.kind == "body":
            self._ended_bodies.add(work.digest)
        elif not outcome.failure:
            self.store.save_result(work, outcome.package)
        if work.kind == "fit":
            self._end(work, outcome)
            return
        for fit in self._fits_after.pop(work.digest):
            if outcome.failure and work.kind == "motion":
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
        own = {file for name in names for file in files[name]}
        others = {file for each in files.values() for file in each} - own
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
    for name, own in instants.items():
        piece.append(name)
        count, left = count + own, left - own
        if min(count, left) >= _LEAST_INSTANTS:
            yield piece
            piece, count = [], 0
    yield piece

"""One piece of a campaign's work: the motion in some of a session's pictures, what the fits of one
body share, or a session's fit.

A session's files are sent to a worker with the work. The result depends only on the input: not on
the machine, the working folder or the time.
"""

import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Literal

from palpate.bem import check_memory
from palpate.checkpoints import content_digest
from palpate.errors import PalpateError
from palpate.estimation import FitSettings
from palpate.files import read_bytes
from palpate.pipeline import (
    MOTION_FILE,
    PoseChoice,
    ProbingMotion,
    fit_session,
    keep_motion,
    kept_motion,
    measure_pictures,
    prepare_body,
    with_motions,
    write_fitted_surface,
)
from palpate.records import (
    Session,
    disk_errors,
    path_below,
    read_session,
    require_probings,
    result_folder,
    session_files,
    write_estimate,
)
from palpate.threads import one_thread

ESTIMATE_FILE = "estimate.json"


@dataclass(frozen=True, slots=True)
class FitOptions:
    """Options of the fits in a campaign.

    Attributes
    ----------
    poisson_range : (float, float)      range in which Poisson's ratio is searched
    surface : "smooth" or "flat"        interpretation of the meshes: smooth or faceted surface
    strain : "small" or "finite"        finite: `finite_strain` of `fit_session`
    pose : "auto", "given" or "register"    as in `measure_pictures`
    """

    poisson_range: tuple[float, float] = (0.0, 0.4999)
    surface: Literal["smooth", "flat"] = "smooth"
    strain: Literal["small", "finite"] = "small"
    pose: PoseChoice = "auto"

    @property
    def fit_settings(self) -> FitSettings:
        """As `fit_session` takes them."""
        return FitSettings(poisson_range=self.poisson_range)


@dataclass(frozen=True, slots=True, eq=False)
class PackedSession:
    """A session's files, with their original location.

    Attributes
    ----------
    files : mapping of str to bytes     content by path, with `/`, relative to one folder
    sums : mapping of str to str        SHA-256 of each, 64 hexadecimal digits
    session : str                   path of the session file among them
    root : str                      original folder that the paths are relative to
    """

    files: Mapping[str, bytes]
    sums: Mapping[str, str]
    session: str
    root: str


@dataclass(frozen=True, slots=True, eq=False)
class Work:
    """A piece of work with all its input.

    Attributes
    ----------
    kind : "motion", "body" or "fit"
    session : PackedSession         of a motion: without the pictures of other probings
    options : FitOptions
    keys : mapping of str to str    the probings whose motion is measured, or used by a fit, with
                                    the digests of what their motions depend on; of a body: the
                                    checksum of its "mesh"
    motions : mapping of str to bytes   of a fit: motions by these digests
    shared_body : bool              of a fit: other sessions have the same mesh, so what is computed
                                    of it is cached: factors, reduced models
    """

    kind: Literal["motion", "body", "fit"]
    session: PackedSession
    options: FitOptions
    keys: Mapping[str, str] = field(default_factory=dict)
    motions: Mapping[str, bytes] = field(default_factory=dict)
    shared_body: bool = False

    @property
    def digest(self) -> str:
        """Digest of everything that determines the outcome: files, options, version; 64 digits."""
        if self.kind != "fit":
            return content_digest((self.kind, dict(self.keys), self.options))
        sums = dict(self.session.sums)
        return content_digest((self.kind, self.session.session, sums, self.options))


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """Outcome of a piece of work.

    Attributes
    ----------
    files : mapping of str to bytes     of a fit: its result, by path; of a motion: by its digest
    seconds : float [s]             duration of the work
    """

    files: Mapping[str, bytes]
    seconds: float


def do_work(
    work: Work, *, folder: Path, cache: Path | None = None, memory: float | None = None
) -> Outcome:
    """Do a piece of work, with one thread.

    BLAS uses as many threads as its process allows; another number changes the last digits.

    Parameters
    ----------
    work : Work
    folder : Path                   working folder; several workers may share it
    cache : Path or None            folder of what is computed of bodies; None: `bodies` in the
                                    working folder
    memory : float or None [byte]   memory limit; None: all of the machine's

    Returns
    -------
    Outcome

    Raises
    ------
    PalpateError                    invalid input, in original places; memory ran out
    """
    start = time.perf_counter()
    with _work_folder(folder) as own_folder, one_thread():
        try:
            unpack(work.session.files, own_folder / "given")
            files = _make_result(work, own_folder, cache or folder / "bodies", memory)
        except PalpateError as error:
            text = _with_original_paths(str(error), work, own_folder)
            raise PalpateError(text) from error
        except MemoryError as error:
            text = "memory ran out; use a coarser mesh, or workers with more memory"
            raise PalpateError(text) from error
    return Outcome(files, time.perf_counter() - start)


@contextmanager
def _work_folder(folder: Path) -> Iterator[Path]:
    """A temporary folder for one piece of work."""
    folder.mkdir(parents=True, exist_ok=True)
    own_folder = Path(tempfile.mkdtemp(prefix="work-", dir=folder))
    (own_folder / "given").mkdir()
    try:
        yield own_folder
    finally:
        shutil.rmtree(own_folder, ignore_errors=True)


def _make_result(
    work: Work, own_folder: Path, cache: Path, memory: float | None
) -> Mapping[str, bytes]:
    """Do the work; gives the files of the outcome."""
    allow = partial(check_memory, available=memory)
    given = read_session(own_folder / "given" / work.session.session, allow=allow)
    given = replace(given, smooth=work.options.surface == "smooth")
    require_probings(given)
    result = own_folder / "result"
    result.mkdir()
    if work.kind == "motion":
        return _measured(work, given, own_folder)
    if work.kind == "body":
        prepare_body(given, settings=work.options.fit_settings, cache=cache)
    else:
        measured = _with_motion(work, given, own_folder)
        _fit(work, measured, result, own_folder, cache if work.shared_body else None)
    return {
        file.relative_to(result).as_posix(): read_bytes(file)
        for file in sorted(result.rglob("*"))
        if file.is_file()
    }


def _measured(work: Work, given: Session, own_folder: Path) -> Mapping[str, bytes]:
    """Measure the motion of some probings; gives each by its digest."""
    chosen = [probing for probing in given.probings if probing.name in work.keys]
    alone = replace(given, probings=tuple(chosen))
    files = {}
    for name, motion in measure_pictures(alone, pose=work.options.pose).items():
        folder = own_folder / "result" / work.keys[name]
        folder.mkdir()
        original = {name: _with_original_notes(motion, work, own_folder)}
        keep_motion(folder, _only(given, name), original, pose=work.options.pose)
        files[work.keys[name]] = read_bytes(folder / MOTION_FILE)
    return files


def _with_motion(work: Work, given: Session, own_folder: Path) -> Session:
    """The session with the displacements measured in its pictures."""
    pose, known = work.options.pose, dict[str, ProbingMotion]()
    for k, (name, key) in enumerate(work.keys.items()):
        folder = own_folder / f"motion {k}"
        with result_folder(folder, kind="fit") as motion_folder:
            (motion_folder / MOTION_FILE).write_bytes(work.motions[key])
        known |= kept_motion(_only(given, name), folder, pose=pose)
    return with_motions(given, measure_pictures(given, known=known, pose=pose))


def _only(session: Session, name: str) -> Session:
    """The session with one probing: the pictures of the others are not read for its digest."""
    return replace(session, probings=tuple(p for p in session.probings if p.name == name))


def _fit(work: Work, session: Session, result: Path, own_folder: Path, cache: Path | None) -> None:
    """Fit a session and write the result, identical on every machine."""
    options = work.options
    fitted = fit_session(
        session,
        settings=options.fit_settings,
        cache=cache,
        finite_strain=options.strain == "finite",
    )
    notes, details = (
        tuple(_with_original_paths(note, work, own_folder) for note in every)
        for every in (fitted.estimate.notes, fitted.estimate.details)
    )
    # Durations are not part of the result; they are in the table.
    estimate = replace(fitted.estimate, notes=notes, details=details, seconds={})
    write_estimate(result / ESTIMATE_FILE, estimate)
    # This file also holds the residuals: fewer files are stored faster.
    write_fitted_surface(result, session, fitted)


def _with_original_notes(motion: ProbingMotion, work: Work, own_folder: Path) -> ProbingMotion:
    return replace(
        motion,
        notes=motion.notes.mapped(lambda note: _with_original_paths(note, work, own_folder)),
    )


def _with_original_paths(text: str, work: Work, own_folder: Path) -> str:
    """A text in which file names refer to the session's original location."""
    # With the separator: the folder itself is named where the worker's own disk is full.
    unpacked, original = (
        os.path.join(folder, "") for folder in (own_folder / "given", work.session.root)
    )
    return text.replace(unpacked, original)


def pack_session(path: Path) -> PackedSession:
    """Read all files of a session.

    Parameters
    ----------
    path : Path                     folder of the session, or a session file in it

    Returns
    -------
    PackedSession                   paths include the name of the session's folder, which is the
                                    default name of the session

    Raises
    ------
    RecordError                     no session, or one of its files cannot be read
    """
    session = real_session_file(path)
    files = sorted(Path(os.path.realpath(file)) for file in session_files(session))
    root = Path(os.path.commonpath([session.parent.parent, *(file.parent for file in files)]))
    content = {file.relative_to(root).as_posix(): read_bytes(file) for file in files}
    sums = {name: hashlib.sha256(text).hexdigest() for name, text in content.items()}
    return PackedSession(content, sums, session.relative_to(root).as_posix(), str(root))


def real_session_file(path: Path) -> Path:
    """Where the session file that a path stands for really lies, whether it is there or not.

    Parameters
    ----------
    path : Path                     folder of the session, or a session file in it

    Returns
    -------
    Path
    """
    return Path(os.path.realpath(path / "session.toml" if path.is_dir() else path))


def without_files(packed: PackedSession, files: Iterable[Path]) -> PackedSession:
    """A packed session without some of its files.

    Parameters
    ----------
    packed : PackedSession
    files : iterable of Path        in their original places; others are ignored

    Returns
    -------
    PackedSession
    """
    dropped = {Path(os.path.relpath(os.path.realpath(file), packed.root)) for file in files}
    remaining = {name: text for name, text in packed.files.items() if Path(name) not in dropped}
    return replace(packed, files=remaining, sums={name: packed.sums[name] for name in remaining})


def unpack(files: Mapping[str, bytes], folder: Path) -> None:
    """Write the files of a session.

    Parameters
    ----------
    files : mapping of str to bytes     content by path
    folder : Path                   an existing folder, to which the paths are relative

    Raises
    ------
    RecordError                     a path that leads out of the folder; a file cannot be written
    """
    for name, content in files.items():
        target = path_below(folder, name)
        with disk_errors(folder):
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)

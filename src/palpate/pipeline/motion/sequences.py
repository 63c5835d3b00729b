"""Sequences of pictures that a session names, and digests of what their motions depend on."""

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from palpate.errors import InputError, RecordError
from palpate.parts import content_digest
from palpate.pipeline.object_pose import PoseChoice
from palpate.records import Images, Rig, Session, file_sums, read_rig
from palpate.vision import FlowMethod, picture_path


@dataclass(frozen=True, slots=True)
class Instant:
    """An instant of which there are pictures.

    Attributes
    ----------
    name : str                      of the motion to it
    whose : str                     step or probing, for messages
    pattern : str                   of its picture files
    last : bool                     whether at full force
    """

    name: str
    whose: str
    pattern: str
    last: bool


@dataclass(frozen=True, slots=True)
class PictureSequence:
    """Instants whose motions are measured one after the other, all from the first one.

    Attributes
    ----------
    probing : str or None           the probing that they are of; None: a session's steps
    first : Instant
    later : tuple of Instant        in temporal order
    """

    probing: str | None
    first: Instant
    later: tuple[Instant, ...]


def picture_sequences(session: Session) -> Sequence[PictureSequence]:
    """The sequences of a session.

    Parameters
    ----------
    session : Session               with steps, or with probings of which some have images

    Returns
    -------
    sequence of PictureSequence     one of all steps, or one for each probing with images

    Raises
    ------
    InputError                      no images
    """
    if session.steps:
        first, *later = (
            Instant(step.name, f"step '{step.name}'", step.images, True) for step in session.steps
        )
        return [PictureSequence(None, first, tuple(later))]
    sequences = [
        _probing_sequence(probing.name, probing.images)
        for probing in session.probings
        if probing.images is not None
    ]
    if not sequences:
        raise InputError(
            f"{session.path}: none of its probings has images; give `images` and a [rig], or"
            " estimate from its displacement files with `palpate fit`"
        )
    return sequences


def motion_names(session: Session) -> list[str]:
    """Names of the motions of a session, in the order in which they are measured.

    Parameters
    ----------
    session : Session               with steps, or with probings of which some have images

    Returns
    -------
    list of str                     of every step but the first, or of every loaded image

    Raises
    ------
    InputError                      no images
    """
    return [instant.name for each in picture_sequences(session) for instant in each.later]


def motion_keys(session: Session, method: FlowMethod, pose: PoseChoice) -> dict[str | None, str]:
    """Digests of everything that the motions of each sequence depend on: method, pose, mesh,
    cameras, its pictures and what the session says of them; forces, contacts, supports and other
    probings may change.

    Parameters
    ----------
    session : Session               with steps, or with probings of which some have images
    method : FlowMethod             with its settings
    pose : PoseChoice

    Returns
    -------
    dict of str or None to str      probing, or None for the steps -> 64 hexadecimal digits; a
                                    picture that cannot be read has a part in them as such

    Raises
    ------
    InputError                      no images, no rig
    RecordError, CalibrationError   the rig cannot be read
    """
    sequences, folder, rig = picture_sequences(session), session.path.parent, session_rig(session)
    # Notes name the rig's file; a session that was moved as a whole is the same.
    rig = replace(rig, source=os.path.relpath(rig.source, folder))
    common = content_digest((rig, session.mesh, method, pose))
    patterns = {one.pattern for each in sequences for one in (each.first, *each.later)}
    # Once for each pattern: the pictures at rest may be those of all probings.
    sums = {pattern: _picture_sums(rig, pattern, folder) for pattern in patterns}
    return {
        each.probing: content_digest(
            (common, each, [sums[one.pattern] for one in (each.first, *each.later)])
        )
        for each in sequences
    }


def picture_files(session: Session) -> dict[str | None, tuple[Path, ...]]:
    """Picture files of each sequence.

    Parameters
    ----------
    session : Session               with steps, or with probings of which some have images

    Returns
    -------
    dict of str or None to tuple of Path    probing, or None for the steps -> files, whether they
                                    exist or not

    Raises
    ------
    InputError                      no images, no rig
    RecordError, CalibrationError   the rig cannot be read
    """
    rig, folder = session_rig(session), session.path.parent
    return {
        each.probing: tuple(
            picture_path(camera, one.pattern, folder)
            for one in (each.first, *each.later)
            for camera in rig.cameras
        )
        for each in picture_sequences(session)
    }


def session_rig(session: Session) -> Rig:
    """The cameras of a session with images.

    Parameters
    ----------
    session : Session

    Returns
    -------
    Rig

    Raises
    ------
    InputError                      no rig
    RecordError, CalibrationError   the rig cannot be read
    """
    if session.rig is None:
        raise InputError(f"{session.path}: has images and no [rig] table; name the camera file")
    return read_rig(session.rig)


def _probing_sequence(name: str, images: Images) -> PictureSequence:
    """A probing at rest, and its later instants, the last of them at full force."""
    whose, count = f"probing '{name}'", len(images.loaded)
    later = tuple(
        Instant(name if k == count else f"{name}_{k}", whose, pattern, k == count)
        for k, pattern in enumerate(images.loaded, start=1)
    )
    return PictureSequence(name, Instant("rest", whose, images.rest, False), later)


def _picture_sums(rig: Rig, pattern: str, folder: Path) -> list[dict[str, str]]:
    """Checksum of each camera's picture; empty where it cannot be read."""
    sums = []
    for camera in rig.cameras:
        found: dict[str, str] = {}
        with suppress(RecordError):
            found = file_sums([picture_path(camera, pattern, folder)], start=folder)
        sums.append(found)
    return sums

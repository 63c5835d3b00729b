"""A session's pictures as pieces of work: each measures the probings that share pictures at rest.

An instant is followed from the one before it, and the start from the pictures at rest takes as long
as several instants: smaller pieces would cost more than they bring.
"""

from pathlib import Path

from palpate.campaign.package import PackedSession, without_files
from palpate.campaign.work import FitOptions, Work
from palpate.pipeline import kept_motion_keys, picture_files, unread_probings
from palpate.records import read_session


def motion_works(path: Path, packed: PackedSession, options: FitOptions) -> tuple[Work, ...]:
    """Pieces of work that measure the motion in a session's pictures.

    Parameters
    ----------
    path : Path                     folder of the session, or a session file in it
    packed : PackedSession          its files
    options : FitOptions

    Returns
    -------
    tuple of Work                   one for all probings with the same pictures at rest, without
                                    the other probings' pictures; empty where all displacements
                                    are in files

    Raises
    ------
    InputError                      pictures without a rig
    RecordError, CalibrationError   the session or its rig cannot be read
    """
    session = read_session(path)
    groups: dict[str, list[str]] = {}
    for probing in unread_probings(session):
        if probing.images is not None:
            groups.setdefault(probing.images.rest, []).append(probing.name)
    if not groups:
        return ()
    keys, files = kept_motion_keys(session, options.pose), picture_files(session)
    works = []
    for names in groups.values():
        own = {file for name in names for file in files[name]}
        others = {file for each in files.values() for file in each} - own
        motions = {name: keys[name] for name in names}
        works.append(Work("motion", without_files(packed, others), options, motions))
    return tuple(works)

"""A session's pictures as pieces of work: each measures probings that share pictures at rest.

An instant is followed from the one before it, and the start from the pictures at rest takes as long
as several instants: pieces of fewer would cost more than they bring.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from palpate.campaign.package import PackedSession, without_files
from palpate.campaign.work import FitOptions, Work
from palpate.pipeline import kept_motion_keys, picture_files, unread_probings
from palpate.records import read_session

# Instants in a piece, if the probings with the same pictures at rest have as many: the start, which
# takes as long as five, is then a sixth of it.
_LEAST_INSTANTS = 25


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

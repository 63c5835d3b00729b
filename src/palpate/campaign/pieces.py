"""What comes before a session's fit, as pieces of work: the motion in its pictures, its body.

A motion is that of probings that share pictures at rest. An instant is followed from the one before
it, and the start from the pictures at rest takes as long as several instants: pieces of fewer would
cost more than they bring.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from palpate.campaign.items import CampaignItem
from palpate.campaign.package import PackedSession, real_session_file, without_files
from palpate.campaign.work import FitOptions, Work
from palpate.errors import PalpateError
from palpate.pipeline import kept_motion_keys, picture_files, unread_probings
from palpate.records import file_sum, read_session, read_toml

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


def needs_motion(path: Path) -> bool:
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

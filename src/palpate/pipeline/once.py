"""What fits of a growing session make of each probing once."""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import TypeVar

from palpate.checkpoints import Cache, Memory, content_digest
from palpate.pipeline.model.supports import compliant_supports
from palpate.records import Session

T = TypeVar("T")


def made_once(
    session: Session,
    kind: object,
    make: Callable[[Session], Sequence[T]],
    cache: Cache | None,
) -> list[T]:
    """What is made of each probing; in a memory, of those alone that the last fit had not.

    Live, a session of many probings is fitted after each. What the model says of one depends on its
    contact, its loads and its points, and on no other probing, except on springs, whose model is
    taken at the modulus that fits all.

    Parameters
    ----------
    session : Session                     k probings
    kind : any                            what else decides what is made; plain values
    make : function                       session of some of the probings -> as many items
    cache : Cache or None                 a memory keeps the items of this session's probings,
                                          and no others

    Returns
    -------
    list of k items
    """
    if not isinstance(cache, Memory) or compliant_supports(session):
        return list(make(session))
    rest = {field.name: getattr(session, field.name) for field in fields(session)}
    for name in ("name", "path", "notes", "probings"):
        del rest[name]
    place = content_digest(("made once", kind, rest))
    digests = [content_digest(probing) for probing in session.probings]
    kept: dict[str, T] = cache.pushes.get(place, {})
    new = [k for k, digest in enumerate(digests) if digest not in kept]
    if new:
        probings = tuple(session.probings[k] for k in new)
        items = make(replace(session, probings=probings))
        kept = kept | {digests[k]: item for k, item in zip(new, items, strict=True)}
    cache.pushes[place] = {digest: kept[digest] for digest in digests}
    return [kept[digest] for digest in digests]

"""Notes on measured motions: what looks wrong in them, and which of them a session has."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import chain

import numpy as np

from palpate.vision import Outcome, RangeFlow

# A few points without texture are at outlines or blots; a larger fraction means a surface without
# speckle.
_MAX_TEXTURELESS = 0.1
# An earlier image with more than this many times the motion of the last one is out of order.
_MAX_EARLIER_MOTION = 1.2


@dataclass(frozen=True, slots=True)
class MotionNotes:
    """Notes on one motion, or on all motions of one probing.

    Attributes
    ----------
    start : tuple of str            on the first pictures and the object's pose in them
    pictures : tuple of str         on the later pictures
    texture : tuple of str          on too little texture
    order : tuple of str            on images that seem to be out of order
    """

    start: tuple[str, ...] = ()
    pictures: tuple[str, ...] = ()
    texture: tuple[str, ...] = ()
    order: tuple[str, ...] = ()

    def mapped(self, change: Callable[[str], str]) -> "MotionNotes":
        """With every note changed.

        Parameters
        ----------
        change : callable           takes a note, gives the changed one

        Returns
        -------
        MotionNotes
        """
        every = (self.start, self.pictures, self.texture, self.order)
        return MotionNotes(*(tuple(map(change, notes)) for notes in every))


@dataclass(frozen=True, slots=True)
class SessionNotes:
    """Notes on the motions of a session so far.

    Attributes
    ----------
    pictures : tuple of str         on pictures and the object's pose, each once
    texture : tuple of str          of the first motion with too little
    order : tuple of str            on images that seem to be out of order
    started : frozenset of str      patterns of the first pictures whose notes are among these
    """

    pictures: tuple[str, ...] = ()
    texture: tuple[str, ...] = ()
    order: tuple[str, ...] = ()
    started: frozenset[str] = frozenset()

    @property
    def all(self) -> tuple[str, ...]:
        """All notes, each once."""
        return _each_once(self.pictures, self.texture, self.order)

    def extended(self, first: str, notes: MotionNotes) -> "SessionNotes":
        """With the notes on one more motion or probing.

        Parameters
        ----------
        first : str                 pattern of the first pictures; notes on these are taken once,
                                    from the first of the probings that share them
        notes : MotionNotes

        Returns
        -------
        SessionNotes
        """
        start = () if first in self.started else notes.start
        return SessionNotes(
            pictures=_each_once(self.pictures, start, notes.pictures),
            texture=self.texture or notes.texture,
            order=_each_once(self.order, notes.order),
            started=self.started | {first},
        )


def joined_notes(notes: Iterable[MotionNotes]) -> MotionNotes:
    """Notes on all motions of one probing.

    Parameters
    ----------
    notes : iterable of MotionNotes     on each motion, in temporal order

    Returns
    -------
    MotionNotes                     each once; of those on texture the first motion's that has any
    """
    every = list(notes)
    return MotionNotes(
        start=_each_once(*(one.start for one in every)),
        pictures=_each_once(*(one.pictures for one in every)),
        texture=next((one.texture for one in every if one.texture), ()),
        order=_each_once(*(one.order for one in every)),
    )


def _each_once(*notes: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(chain.from_iterable(notes)))


def texture_notes(name: str, flow: RangeFlow) -> tuple[str, ...]:
    """A note on where the surface has too little texture to be tracked, and how much it needs.

    Parameters
    ----------
    name : str                      of the motion
    flow : RangeFlow

    Returns
    -------
    tuple of str                    empty if hardly any points lack texture
    """
    poor = flow.outcome == Outcome.TEXTURE
    if len(poor) == 0 or poor.mean() <= _MAX_TEXTURELESS:
        return ()
    column, row = np.median(flow.pixel[poor], axis=0)
    needed = 3.0 * float(np.max(flow.noise))
    note = (
        f"'{name}': {100 * poor.mean():.0f} % of the points have too little texture to be followed"
        f" (around column {column:.0f}, row {row:.0f} of the reference camera); a window of"
        f" {flow.subset} px needs grey levels that vary by {needed:.1f} or more (1 sigma): speckle"
        " the surface, or light it better"
    )
    return (note,)


def order_notes(probing: str, sizes: Mapping[str, float]) -> tuple[str, ...]:
    """Notes where an earlier image of a probing shows more motion than the last one.

    Parameters
    ----------
    probing : str                   its name
    sizes : mapping of str to float [m]     name of every motion of the probing, the last at full
                                    force, to its `typical_motion`

    Returns
    -------
    tuple of str
    """
    *earlier, (_, last) = sizes.items()
    return tuple(
        f"probing '{probing}': image '{name}' shows more motion"
        f" ({1e3 * size:.3g} mm) than the last one ({1e3 * last:.3g} mm), which must be"
        " the one at full force; is their order right?"
        for name, size in earlier
        if size > _MAX_EARLIER_MOTION * last
    )


def typical_motion(flow: RangeFlow) -> float:
    """Root mean square of the displacement over the valid points.

    Parameters
    ----------
    flow : RangeFlow

    Returns
    -------
    float [m]                       0 if no point is valid
    """
    square = np.nansum(flow.displacement**2, axis=1)[np.isfinite(flow.displacement[:, 0])]
    return float(np.sqrt(square.mean())) if len(square) else 0.0

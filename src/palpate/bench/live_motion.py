"""How far the surface near the tool goes in, while it does: for a person to see, not for a fit."""

from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from palpate.bench.questions import Pictures
from palpate.geometry import TriangleMesh
from palpate.records import Rig
from palpate.shapes import Vector3
from palpate.vision import JointFlow, is_valid

# Spacing of the points [px]: some five hundred, a fifth of a second. Of these, those nearest.
_STEP, _NEAREST = 9, 20


class LiveMotion:
    """Motion of the surface near a place since rest.

    The newest pictures are followed in a thread, as often as they can be: none waits for it. What
    the thread fails on is left out.

    Parameters
    ----------
    rig : Rig
    mesh : TriangleMesh             the object
    rest : Pictures                 before the push
    place : (3,) and (3,) float     point [m], and unit normal into the object
    """

    def __init__(
        self, rig: Rig, mesh: TriangleMesh, rest: Pictures, contact: tuple[Vector3, Vector3]
    ) -> None:
        # When [s], and how far along the normal [m].
        self.trace: list[tuple[float, float]] = []
        self._method, self._place = JointFlow(step=_STEP), contact
        self._pool = ThreadPoolExecutor(1)
        self._work: Future[None] = self._pool.submit(self._begin, rig, mesh, rest)

    def look(self, when: float, pictures: Pictures) -> None:
        """Follow these pictures, unless others are still being followed."""
        if self._work.done() and (not self.trace or when > self.trace[-1][0]):
            self._work = self._pool.submit(self._follow, when, pictures)

    def close(self) -> None:
        """End the thread."""
        self._pool.shutdown()

    def _begin(self, rig: Rig, mesh: TriangleMesh, rest: Pictures) -> None:
        self._state = self._method.start(rig, [p.astype(np.float32) for p in rest], mesh)

    def _follow(self, when: float, pictures: Pictures) -> None:
        point, inward = self._place
        grey = tuple(picture.astype(np.float32) for picture in pictures)
        self._state, flow = self._method.follow(self._state, grey)
        known = np.flatnonzero(is_valid(flow))
        near = known[np.linalg.norm(flow.point[known] - point, axis=1).argsort()[:_NEAREST]]
        if len(near):
            self.trace.append((when, float(np.median(flow.displacement[near] @ inward))))

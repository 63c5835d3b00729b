"""The contract of a method that measures range flow."""

from collections.abc import Sequence
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from palpate.geometry import TriangleMesh
from palpate.records import Rig
from palpate.vision.range_flow.flow import RangeFlow, VertexDisplacement


@runtime_checkable
class FlowMethod(Protocol):
    """A method of measuring range flow: a frozen dataclass whose fields are its settings.

    Every method must satisfy the following, and one test checks them all: no motion gives zero
    displacement, a rigid motion is recovered at points and vertices, the same input gives the same
    output, and `follow` does not modify the state passed to it.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def start(
        self, rig: Rig, pictures: Sequence[Float[np.ndarray, "_ _"]], surface: TriangleMesh
    ) -> Any:
        """Process the first instant and choose the points to track.

        Parameters
        ----------
        rig : Rig                       with the object's pose at the first instant
        pictures : sequence of c (rows, columns) float [grey levels]    in the rig's order
        surface : TriangleMesh          of the object at the first instant

        Returns
        -------
        state                           opaque; its type is the method's own

        Raises
        ------
        InputError, CalibrationError    pictures or cameras that the method cannot use
        """
        ...

    def follow(
        self, state: Any, pictures: Sequence[Float[np.ndarray, "_ _"]]
    ) -> tuple[Any, RangeFlow]:
        """Track the points to the next instant.

        Parameters
        ----------
        state                           of the previous instant
        pictures : sequence of c (rows, columns) float [grey levels]

        Returns
        -------
        state                           of this instant
        flow : RangeFlow                from the first instant to this one

        Raises
        ------
        InputError                      pictures that the method cannot use
        """
        ...

    def vertices(self, flow: RangeFlow, rig: Rig, surface: TriangleMesh) -> VertexDisplacement:
        """Displacement of the mesh's vertices from range flow of any method.

        Parameters
        ----------
        flow : RangeFlow
        rig : Rig                       as given to `start`
        surface : TriangleMesh          as given to `start`

        Returns
        -------
        VertexDisplacement
        """
        ...

    def averaged(
        self, found: VertexDisplacement, flow: RangeFlow, rig: Rig, surface: TriangleMesh
    ) -> VertexDisplacement:
        """Add the averaging of the surface's displacement by the windows, if the method knows it.

        Parameters
        ----------
        found : VertexDisplacement      from `vertices`
        flow : RangeFlow
        rig : Rig                       as given to `start`
        surface : TriangleMesh          as given to `start`

        Returns
        -------
        VertexDisplacement              `found` with its `average` set, or unchanged
        """
        ...

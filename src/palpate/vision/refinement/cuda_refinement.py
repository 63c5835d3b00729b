"""The refinement on a CUDA device: what travels there and back."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import cuda

from palpate.errors import InputError
from palpate.vision.images import SplinePicture
from palpate.vision.refinement.cuda_kernel import BlockWork, Task, refine_kernel
from palpate.vision.refinement.scene import Scene
from palpate.vision.refinement.window_match import (
    BLOCKS,
    Limits,
    Match,
    first_instant,
    nothing_found,
    padded_to_four,
    surface_points,
)
from palpate.vision.refinement.window_share import SLOPES

# Threads of a block, and blocks at most: many times what any device runs at once.
_THREADS, _MOST_BLOCKS = 64, 2048
# Parts of a sum over the pixels of a window: threads side by side read pixels side by side.
_PARTS = 32
# Work arrays of all blocks together [bytes].
_MOST_WORK = 2**29
# Arrays begin at multiples of this [bytes].
_ALIGNMENT = 256

# Shape and type of an array.
_Layout = Mapping[str, tuple[tuple[int, ...], type]]


class CudaRefinement:
    """The refinement on a CUDA device; a `Refine`.

    What is sent stays there as long as it serves: the pictures of the first instant for all later
    ones, and memory for points and work.

    Raises
    ------
    InputError                      no device, or no driver for it
    """

    def __init__(self) -> None:
        try:
            cuda.current_context()
        except cuda.CudaSupportError as error:
            said = " ".join(str(error).split()).rstrip(" .:")
            raise InputError(
                "no CUDA device was found to measure the motion on; use the CPU (--device cpu), or"
                f" see to the driver, which says: {said}"
            ) from error
        self._pictures: dict[int, tuple[np.ndarray, Any]] = {}
        self._points: _Exchange | None = None
        self._work: dict[tuple[int, int, int], BlockWork] = {}

    def __call__(
        self,
        scene: Scene,
        rows: Int[np.ndarray, " n"],
        moved: Sequence[SplinePicture],
        start: Float[np.ndarray, "n 6 3"],
        cameras: Bool[np.ndarray, "n c"],
        noise: Float[np.ndarray, " c"],
        limits: Limits,
        /,
    ) -> Match:
        """Refine the motion of some points of a scene; see `Refine`."""
        found, (count, views) = nothing_found(cameras), cameras.shape
        if count == 0:
            return found
        pictures = self._sent(
            first_instant(scene), padded_to_four([picture.coefficients for picture in moved])
        )
        points = self._points
        if points is None or points.count < count or points.views != views:
            points = self._points = _Exchange(max(count, len(scene.point)), views)
        known = np.isfinite(start).all(axis=(1, 2))
        points.send(Task(*surface_points(scene, rows), start, known, noise), found)
        work = self._work_arrays(views, limits)
        with warnings.catch_warnings():
            # A few points leave most of a device idle.
            warnings.filterwarnings("ignore", message=".*Grid size")
            refine_kernel[min(count, len(work.outcome)), _THREADS](
                count, *pictures, points.task, limits, points.found, work
            )
        points.fetch(found)
        return found

    def _sent(self, *arrays: Any) -> Any:
        """Tuples of arrays on the device; those of the last call are not sent again."""
        kept: dict[int, tuple[np.ndarray, Any]] = {}

        def sent(array: np.ndarray) -> Any:
            if id(array) not in kept:
                # Held as well: another array must not get the same identity.
                kept[id(array)] = self._pictures.get(id(array)) or (array, cuda.to_device(array))
            return kept[id(array)][1]

        there = _mapped(sent, arrays)
        self._pictures = kept
        return there

    def _work_arrays(self, views: int, limits: Limits) -> BlockWork:
        """Work arrays of many blocks."""
        key = views, limits.half, limits.bases
        if key not in self._work:
            layout = _work_layout(*key)
            blocks = max(min(_MOST_BLOCKS, _MOST_WORK // _size(layout)), 1)
            each = {name: ((blocks, *shape), kind) for name, (shape, kind) in layout.items()}
            self._work[key] = BlockWork(**_views(cuda.device_array(_size(each), np.uint8), each))
        return self._work[key]


class _Exchange:
    """Memory for up to some number of points here and, laid out alike, on the device."""

    def __init__(self, count: int, views: int) -> None:
        self.count, self.views = count, views
        task = {
            "point": ((count, 3), np.float64),
            "tangent": ((count, 2, 3), np.float64),
            "half_window": ((count,), np.float64),
            "start": ((count, 6, 3), np.float64),
            "known": ((count,), np.bool_),
            "noise": ((views,), np.float64),
        }
        empty = nothing_found(np.zeros((count, views), dtype=bool))._asdict()
        match = {name: (array.shape, array.dtype.type) for name, array in empty.items()}
        self._here = np.empty(_size(task) + _size(match), np.uint8)
        self._there = cuda.device_array(len(self._here), np.uint8)
        cut = _size(task)
        self._task_here = Task(**_views(self._here[:cut], task))
        self._found_here = Match(**_views(self._here[cut:], match))
        self.task = Task(**_views(self._there[:cut], task))
        self.found = Match(**_views(self._there[cut:], match))

    def send(self, task: Task, found: Match) -> None:
        """Copy a task, and what is found before it is begun, in one transfer."""
        for ours, given in ((self._task_here, task), (self._found_here, found)):
            for mine, array in zip(ours, given, strict=True):
                mine[: len(array)] = array
        self._there.copy_to_device(self._here)

    def fetch(self, found: Match) -> None:
        """Copy what was found into `found`, in one transfer."""
        self._there.copy_to_host(self._here)
        for mine, array in zip(self._found_here, found, strict=True):
            array[...] = mine[: len(array)]


def _mapped(function: Any, arrays: Any) -> Any:
    """A function of each array in nested tuples, named or not."""
    if isinstance(arrays, tuple):
        values = [_mapped(function, each) for each in arrays]
        return type(arrays)(*values) if hasattr(arrays, "_fields") else tuple(values)
    return function(arrays)


def _views(memory: Any, layout: _Layout) -> dict[str, Any]:
    """Arrays one after the other in a piece of memory, here or on the device."""
    begin, views = 0, {}
    for name, (shape, kind) in layout.items():
        size = _bytes(shape, kind)
        views[name] = memory[begin : begin + size].view(kind).reshape(shape)
        begin += _padded(size)
    return views


def _size(layout: _Layout) -> int:
    """Bytes that `_views` takes."""
    return sum(_padded(_bytes(shape, kind)) for shape, kind in layout.values())


def _bytes(shape: tuple[int, ...], kind: type) -> int:
    """Bytes of an array."""
    return int(np.prod(shape)) * np.dtype(kind).itemsize


def _padded(size: int) -> int:
    """A number of bytes, rounded up to where the next array may begin."""
    return -(-size // _ALIGNMENT) * _ALIGNMENT


def _work_layout(views: int, half: int, bases: int) -> _Layout:
    """Work arrays of one block, see `BlockWork`."""
    pixels = (2 * half + 1) ** 2
    # A window that only shifts has no tilt that its pixels' heights could follow.
    unknowns = 2 * (bases + 1) if bases > 1 else 2
    single = {
        "planes": (views, SLOPES + unknowns, pixels),
        "places": (views, 3, pixels),
        "sampled": (views, 2, pixels),
        "partial": (SLOPES + unknowns, _PARTS),
    }
    double = {
        "statistics": (views, 3),
        "sums": (views, unknowns, SLOPES),
        "normal": (views, unknowns, unknowns),
        "own": (2 * bases, 2 * bases),
        "mapping": (views, unknowns, 3 * bases),
        "jacobian": (2, 3),
        "hessian": (3 * bases, 3 * bases),
        "inverse": (3 * bases, 3 * bases),
        "right": (views, unknowns),
        "total": (3 * bases,),
        "q": (6, 3),
        "frame": (3, 3),
        "blocks": (BLOCKS * BLOCKS, unknowns),
        "influence": (unknowns,),
        "illumination": (views, 4),
        "polynomial": (7, 3),
        "products": (SLOPES + unknowns,),
    }
    return {
        **{name: (shape, np.float32) for name, shape in single.items()},
        **{name: (shape, np.float64) for name, shape in double.items()},
        "active": ((views,), np.bool_),
        "outcome": ((1,), np.int64),
    }

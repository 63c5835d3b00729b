"""Initial displacement of every pixel, found without a guess.

Dense inverse search (Kroeger et al., Fast optical flow using dense inverse search, ECCV 2016) is
fast and finds most motions by itself. The areas it explains are kept. If texture in both pictures
remains unexplained, the motion is extrapolated into it from the explained areas, then from feature
matches, which do not depend on the size of the motion. A final dense search on the moved picture,
warped back by the motion found so far, gives the accuracy.

All searches work on pictures with locally normalised mean and contrast, so that lighting and gain
do not matter. The result does not depend on the number of threads.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from palpate.errors import InputError
from palpate.vision.matching.features import (
    NOT_GIVEN,
    Samples,
    feature_matches,
    interpolated,
    nodes,
    sampled,
)
from palpate.vision.normalisation import (
    WINDOW,
    NormalisedImage,
    cropped,
    make_normalised_image,
    moments,
)

# Correlation above which two windows count as the same. The variance of the texture is then three
# times that of the noise, as `textured` requires too; windows with a dozen independent speckles,
# whose chance correlation has a standard deviation of 1 / sqrt(12) = 0.3, exceed it in about one
# place in a hundred.
_MIN_CORRELATION = 0.75
# Texture wider than this [px, sigma of Gaussian speckles] leaves fewer than a dozen independent
# speckles in a window: the pictures are then halved.
_MAX_SPECKLE_PX = 3.0
# Largest forward-backward inconsistency [px]. At first: the reach of the final search. At the end:
# each direction should be accurate to half a pixel.
_MAX_FIRST_GAP_PX, _MAX_LAST_GAP_PX = 2.0, 1.0
# Largest difference between the motion and its local mean [px], as large as the gap above; it is
# zero for an affine motion and large for one fitted to noise.
_MAX_FIRST_ROUGHNESS_PX, _MAX_LAST_ROUGHNESS_PX = 2.0, 1.0
# Fraction of the texture that may stay unexplained before more is tried: at worst a patch of 55 px
# in a picture of 640 x 480.
_MAX_UNEXPLAINED = 0.01
# If less than this fraction is explained, it may be by chance: features are then used at once.
_MIN_EXPLAINED = 0.1
# Features are added, once, when a round of extrapolation leaves more than this fraction of what was
# lost before. Two rounds usually extend the motion from a few features; a third is in reserve.
_MAX_REMAINDER = 0.7
_ROUNDS = 3
# Smallest side of a picture: two windows.
_MIN_SIDE_PX = 2 * WINDOW
# Finest pyramid levels of the searches: a quarter of the resolution is fast, half gives accuracy.
_ROUGH_SCALE, _FINE_SCALE = 2, 1
# Smoothness weight of the final search. OpenCV's 20 oversmooths edges of the object, 5 fits noise.
_STIFFNESS = 10.0
# Columns into which a list of places is folded for `cv2.remap`.
_FOLD = 1024


@dataclass(frozen=True, slots=True, eq=False)
class DenseStart:
    """A displacement of every pixel of the rest picture, for a refinement to start from.

    Attributes
    ----------
    flow : (rows, columns, 2) float32 [px]  column and row components; finite everywhere, also where
                                            not trusted
    trusted : (rows, columns) bool          looks alike in both pictures, passes the
                                            forward-backward check, and moves like its surroundings
    """

    flow: Float[np.ndarray, "rows columns 2"]
    trusted: Bool[np.ndarray, "rows columns"]

    def at(
        self, point: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Flow and its trust flag at sub-pixel places, interpolated bilinearly.

        Parameters
        ----------
        point : (n, 2) float [px]       column and row

        Returns
        -------
        flow : (n, 2) float32 [px]
        trusted : (n,) bool             False outside the picture
        """
        # `cv2.remap` takes at most 32767 columns, so the list is folded into rows.
        folded = np.full((1 + len(point) // _FOLD, _FOLD, 2), -_FOLD, dtype=np.float32)
        folded.reshape(-1, 2)[: len(point)] = point
        layers = np.dstack([self.flow, self.trusted.astype(np.float32)])
        layers_there = cv2.remap(layers, folded, NOT_GIVEN, cv2.INTER_LINEAR)
        layers_there = layers_there.reshape(-1, 3)[: len(point)]
        return layers_there[:, :2], layers_there[:, 2] > 0.5


# For every pixel of the rest picture, and of the moved one: the motion into the other [px]; a flag.
_Motions = tuple[Float[np.ndarray, "rows columns 2"], Float[np.ndarray, "rows columns 2"]]
_Flags = tuple[Bool[np.ndarray, "rows columns"], Bool[np.ndarray, "rows columns"]]


def dense_start(
    rest: Float[np.ndarray, "_ _"],
    moved: Float[np.ndarray, "_ _"],
    *,
    mask: Bool[np.ndarray, "_ _"] | None = None,
) -> DenseStart:
    """Find the displacement of every pixel to about half a pixel, without an initial guess.

    Works for motions of 100 px and more combined with rotation and strain; gain and offset may
    differ. Windows of 21 px must contain texture (larger ones where the texture is coarse). Pixels
    that leave the picture, are hidden, or lie within half a window of a discontinuity of the motion
    are not trusted. Use a mask for a small object that moves far over a textured background.

    Parameters
    ----------
    rest, moved : (rows, columns) float [grey levels]   of any scale
    mask : (rows, columns) bool or None     pixels of interest in the rest picture; the others are
                                            not trusted, and the slower searches skip them

    Returns
    -------
    DenseStart

    Raises
    ------
    InputError      pictures differ in size, are too small, or have grey levels that are not finite
    """
    shape = rest.shape
    _check(rest, moved, mask)
    a, b = make_normalised_image(rest), make_normalised_image(moved)
    wanted = a.textured if mask is None else a.textured & mask
    if not wanted.any():
        return DenseStart(np.zeros((*shape, 2), dtype=np.float32), np.zeros(shape, dtype=bool))
    box = _bounds(wanted | b.textured)
    a, b, wanted = cropped(a, box), cropped(b, box), np.ascontiguousarray(wanted[box])
    sure = wanted
    if a.width > _MAX_SPECKLE_PX and min(wanted.shape) >= 2 * _MIN_SIDE_PX:
        half = dense_start(cv2.pyrDown(a.grey), cv2.pyrDown(b.grey), mask=wanted[::2, ::2])
        motions, sure = _doubled(half, wanted)
    else:
        motions, _ = _motions(a, b, (wanted, b.textured))
    flow, trusted = _finished(a, b, motions)
    return _embedded(flow, trusted & sure, box, shape)


def _check(
    rest: Float[np.ndarray, "_ _"],
    moved: Float[np.ndarray, "_ _"],
    mask: Bool[np.ndarray, "_ _"] | None,
) -> None:
    """Raise if the pictures cannot be compared."""
    shapes = [rest.shape, moved.shape] + ([] if mask is None else [mask.shape])
    if len(set(shapes)) > 1:
        raise InputError(
            f"the pictures (and the mask) have shapes {shapes}; must be one shape: check that both"
            " pictures are of one camera"
        )
    if min(rest.shape) < _MIN_SIDE_PX:
        raise InputError(
            f"the pictures have {rest.shape[0]} rows and {rest.shape[1]} columns; must have"
            f" {_MIN_SIDE_PX} or more of each: windows of {WINDOW} px are compared"
        )
    for name, grey in (("rest", rest), ("moved", moved)):
        bad = int((~np.isfinite(grey)).sum())
        if bad:
            raise InputError(
                f"{bad} of {grey.size} grey levels of the {name} picture are not finite; all must"
                " be: fill them, and leave them out by the mask"
            )


def _bounds(area: Bool[np.ndarray, "rows columns"]) -> tuple[slice, slice]:
    """Rows and columns of an area enlarged by a window, at least `_MIN_SIDE_PX` of each."""
    bounds = []
    for axis, size in ((1, area.shape[0]), (0, area.shape[1])):
        used = np.flatnonzero(area.any(axis=axis))
        low = max(0, min(int(used[0]) - WINDOW, size - _MIN_SIDE_PX))
        bounds.append(slice(low, min(size, max(int(used[-1]) + WINDOW + 1, low + _MIN_SIDE_PX))))
    return bounds[0], bounds[1]


def _embedded(
    flow: Float[np.ndarray, "r c 2"],
    trusted: Bool[np.ndarray, "r c"],
    box: tuple[slice, slice],
    shape: tuple[int, ...],
) -> DenseStart:
    """Extend the result to the whole picture; outside the searched box the flow is constant."""
    edges = (box[0].start, shape[0] - box[0].stop, box[1].start, shape[1] - box[1].stop)
    whole = np.zeros(shape, dtype=bool)
    whole[box] = trusted
    return DenseStart(cv2.copyMakeBorder(flow, *edges, cv2.BORDER_REPLICATE), whole)


def _doubled(
    start: DenseStart, wanted: Bool[np.ndarray, "rows columns"]
) -> tuple[Float[np.ndarray, "rows columns 2"], Bool[np.ndarray, "rows columns"]]:
    """Upsample flow and trust by a factor of two; pixel i of the half-size picture is pixel 2 i."""
    half = np.float32(0.5) * _grid(wanted.shape)
    trust = sampled(start.trusted.astype(np.float32), half) > 0.5
    return np.float32(2.0) * sampled(start.flow, half), trust & wanted


def _grid(shape: tuple[int, ...]) -> Float[np.ndarray, "rows columns 2"]:
    """Column and row of every pixel, float32."""
    grid = np.empty((shape[0], shape[1], 2), dtype=np.float32)
    grid[..., 0] = np.arange(shape[1])
    grid[..., 1] = np.arange(shape[0])[:, None]
    return grid


def _composed(
    first: Float[np.ndarray, "rows columns 2"], second: Float[np.ndarray, "rows columns 2"]
) -> Float[np.ndarray, "rows columns 2"]:
    """Composition of two motions, the first applied first [px]."""
    return first + sampled(second, _grid(first.shape) + first)


def _inside(position: Float[np.ndarray, "rows columns 2"]) -> Bool[np.ndarray, "rows columns"]:
    """True where a place lies within a picture of the same size."""
    rows, columns = position.shape[:2]
    column, row = position[..., 0], position[..., 1]
    return (column >= 0.0) & (row >= 0.0) & (column <= columns - 1) & (row <= rows - 1)


def _search(
    rest: UInt8[np.ndarray, "rows columns"], moved: UInt8[np.ndarray, "rows columns"], scale: int
) -> Float[np.ndarray, "rows columns 2"]:
    """Dense inverse search down to pyramid level `scale`; float32 [px]."""
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    search.setFinestScale(scale)
    if scale == _FINE_SCALE:
        search.setVariationalRefinementAlpha(_STIFFNESS)
    return search.calc(rest, moved, NOT_GIVEN)


def _fits(
    a: NormalisedImage,
    b: NormalisedImage,
    flow: Float[np.ndarray, "rows columns 2"],
    gap: Float[np.ndarray, "rows columns 2"],
    limits: tuple[float, float],
) -> Bool[np.ndarray, "rows columns"]:
    """True where the textures correlate, forward and backward agree, and the motion is smooth.

    `gap` is the forward-backward residual; `limits` apply to it and to the roughness [px].
    """
    position = _grid(a.grey.shape) + flow
    grey = sampled(b.grey, position)
    mean, variance = moments(grey)
    common = cv2.blur(a.grey * grey, (WINDOW, WINDOW)) - a.mean * mean
    # The constant avoids 0 / 0; it is negligible beside the quantisation noise.
    score = common / np.sqrt(a.variance * variance + np.float32(1e-6))
    roughness = flow - cv2.blur(flow, (WINDOW, WINDOW))
    return (
        (score > _MIN_CORRELATION)
        & (_square(gap) < limits[0] ** 2)
        & (_square(roughness) < limits[1] ** 2)
        & _inside(position)
    )


def _square(vectors: Float[np.ndarray, "rows columns 2"]) -> Float[np.ndarray, "rows columns"]:
    """Squared length of each vector."""
    return vectors[..., 0] ** 2 + vectors[..., 1] ** 2


def _motions(a: NormalisedImage, b: NormalisedImage, textured: _Flags) -> _Motions:
    """Forward and backward motion, accurate enough for the final search wherever found."""
    motions = _search(a.levels, b.levels, _ROUGH_SCALE), _search(b.levels, a.levels, _ROUGH_SCALE)
    features: Samples | None = None
    staying, before = textured, np.inf
    for _ in range(_ROUNDS):
        explained = _explained(a, b, motions)
        lost, fraction = _lost(staying, explained, textured)
        # What is lost in only one picture is hidden in the other.
        if fraction < _MAX_UNEXPLAINED:
            break
        samples = _known(motions, explained, textured[0])
        chance = explained[0][textured[0]].mean() < _MIN_EXPLAINED
        if features is None and (chance or fraction > _MAX_REMAINDER * before):
            features = feature_matches(a.levels, b.levels, *_feature_areas(textured, lost))
        samples = samples if features is None else samples.joined(features)
        if not len(samples.point):
            break
        before = fraction
        motions, inside = _repaired(a, b, motions, explained, samples)
        staying = (textured[0] & inside[0], textured[1] & inside[1])
    return motions


def _explained(a: NormalisedImage, b: NormalisedImage, motions: _Motions) -> _Flags:
    """Pixels of each picture that the two motions match to the other."""
    limits = (_MAX_FIRST_GAP_PX, _MAX_FIRST_ROUGHNESS_PX)
    forward, back = motions
    return (
        _fits(a, b, forward, _composed(forward, back), limits),
        _fits(b, a, back, _composed(back, forward), limits),
    )


def _lost(staying: _Flags, explained: _Flags, textured: _Flags) -> tuple[_Flags, float]:
    """Unexplained areas of at least one window, and the size of the smaller one.

    The size is a fraction of the textured pixels of interest in the rest picture: around a mask the
    moved picture has more of them.
    """
    kernel = np.ones((WINDOW, WINDOW), dtype=np.uint8)
    rest, moved = (
        cv2.morphologyEx((flag & ~known).astype(np.uint8), cv2.MORPH_OPEN, kernel) > 0
        for flag, known in zip(staying, explained, strict=True)
    )
    smaller = min(int(rest.sum()), int(moved.sum()))
    return (rest, moved), smaller / max(1, int(textured[0].sum()))


def _feature_areas(textured: _Flags, lost: _Flags) -> _Flags:
    """Where to look for features: around lost areas, or everywhere if most of a picture is lost."""
    kernel = np.ones((2 * WINDOW + 1, 2 * WINDOW + 1), dtype=np.uint8)
    rest, moved = (
        whole
        if int(part.sum()) > 0.5 * int(whole.sum())
        else whole & (cv2.dilate(part.astype(np.uint8), kernel) > 0)
        for whole, part in zip(textured, lost, strict=True)
    )
    return rest, moved


def _known(
    motions: _Motions, explained: _Flags, wanted: Bool[np.ndarray, "rows columns"]
) -> Samples:
    """Explained displacements at the nodes, from both pictures.

    Only those of wanted points of the rest picture: what lies outside the mask moves differently.
    """
    both = []
    for flow, known in zip(motions, explained, strict=True):
        row, column = (axis.ravel() for axis in nodes(known.shape))
        at = known[row, column]
        point = np.stack([column[at], row[at]], axis=1).astype(np.float64)
        both.append(Samples(point, flow[row[at], column[at]].astype(np.float64)))
    samples = both[0].joined(both[1].reversed())
    last = np.array(wanted.shape[::-1]) - 1
    column, row = np.clip(np.rint(samples.point).astype(np.int64), 0, last).T
    at = wanted[row, column]
    return samples.chosen(at)


def _repaired(
    a: NormalisedImage, b: NormalisedImage, motions: _Motions, explained: _Flags, samples: Samples
) -> tuple[_Motions, _Flags]:
    """Extrapolate the motions from samples into unexplained areas, and search again.

    The flags mark pixels whose extrapolated motion stays within the other picture.
    """
    repaired, inside = [], []
    for here, other, known, before, given in (
        (a, b, explained[0], motions[0], samples),
        (b, a, explained[1], motions[1], samples.reversed()),
    ):
        start = np.where(known[..., None], before, interpolated(given, known.shape))
        inside.append(_inside(_grid(known.shape) + start))
        change = _search(here.levels, _brought_back(other, start), _ROUGH_SCALE)
        repaired.append(_composed(change, start))
    return (repaired[0], repaired[1]), (inside[0], inside[1])


def _brought_back(
    moved: NormalisedImage, flow: Float[np.ndarray, "rows columns 2"]
) -> UInt8[np.ndarray, "rows columns"]:
    """The moved picture warped back to rest, uniform grey where that lies beyond its edge."""
    source = _grid(moved.grey.shape) + flow
    edge, even_grey = cv2.BORDER_CONSTANT, 128
    return cv2.remap(
        moved.levels, source, NOT_GIVEN, cv2.INTER_LINEAR, borderMode=edge, borderValue=even_grey
    )


def _finished(
    a: NormalisedImage, b: NormalisedImage, start: Float[np.ndarray, "rows columns 2"]
) -> tuple[Float[np.ndarray, "rows columns 2"], Bool[np.ndarray, "rows columns"]]:
    """Final search, forward and backward, on the moved picture warped back; flow and trust."""
    moved = _brought_back(b, start)
    change = _search(a.levels, moved, _FINE_SCALE)
    flow = _composed(change, start)
    # Backward at another scale: a motion fitted to noise at one scale does not recur at the other.
    gap = _composed(change, _search(moved, a.levels, _ROUGH_SCALE))
    return flow, _fits(a, b, flow, gap, (_MAX_LAST_GAP_PX, _MAX_LAST_ROUGHNESS_PX))

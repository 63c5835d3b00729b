"""Feature matches between pictures, of one camera or of several, without calibration or a guess.

Scale-invariant features are matched after motions of any size, rotations and strains, and under
different lighting; but there are only about a thousand of them, they are accurate to about a pixel,
and a few per cent of the matches are wrong: on speckle patterns the ratio test leaves one in a
hundred. The displacements of one camera's features are interpolated to its pixels.

Source: Lowe, Distinctive image features from scale-invariant keypoints, IJCV 60(2), 2004: the
features, and the ratio test.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import cKDTree

from palpate.errors import InputError
from palpate.records import Rig
from palpate.vision.normalisation import NormalisedImage, make_normalised_image

# Neighbouring displacements agree if they differ by less than two pixels plus this times their
# distance: a rotation of 30 degrees or a strain of 50 %.
_MAX_SLOPE, _MAX_GAP_PX = 0.5, 2.0
# Area per feature [px], with limits on the number: fewer would miss small objects, more would take
# over a second. About half of them agree with their neighbours, one in a square of 35 px.
_PIXELS_EACH = 600
_MIN_FEATURES, _MAX_FLOW_FEATURES = 500, 1500
# Factor for the second picture, so that its features include those of the first.
_SECOND_FACTOR = 2
# The strongest feature of each square of this side [px] is taken first, for even coverage.
_CELL = 32
# Margin around the area of interest [px]: the extent of the descriptor of a fine feature.
_MARGIN = 20
# Spacing of the nodes between which a motion is interpolated [px]: less than a usual window.
_SPACING = 16
# Samples per node for the affine fit: four times its three unknowns per component.
_SAMPLES = 12
# OpenCV accepts None for an array that is not given; its type stubs do not say so.
NOT_GIVEN: Any = None
# Larger pictures are halved: a speckle of two pixels is then still a feature.
_MAX_PIXELS = 2_500_000
# Number of strongest features compared: about a thousand of them are matched.
_MAX_FEATURES = 4000
# Half of OpenCV's threshold: contrast has been normalised, and the ratio test follows.
_MIN_CONTRAST = 0.02
# Largest ratio of the nearest to the second-nearest descriptor distance: Lowe's value.
_MAX_RATIO = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Displacements of scattered points.

    Attributes
    ----------
    point : (n, 2) float [px]           column, row
    displacement : (n, 2) float [px]
    """

    point: Float[np.ndarray, "n 2"]
    displacement: Float[np.ndarray, "n 2"]

    @property
    def moved(self) -> Float[np.ndarray, "n 2"]:
        """The displaced points, (n, 2) [px]."""
        return self.point + self.displacement

    def chosen(self, rows: np.ndarray) -> "Samples":
        """Some of them, by indices, (k,) int, or flags, (n,) bool."""
        return Samples(self.point[rows], self.displacement[rows])

    def reversed(self) -> "Samples":
        """The inverse displacements, at the displaced points."""
        return Samples(self.moved, -self.displacement)

    def joined(self, other: "Samples") -> "Samples":
        """These samples followed by those of `other`."""
        return Samples(
            np.concatenate([self.point, other.point]),
            np.concatenate([self.displacement, other.displacement]),
        )


def feature_matches(
    rest: UInt8[np.ndarray, "rows columns"],
    moved: UInt8[np.ndarray, "rows columns"],
    rest_area: Bool[np.ndarray, "rows columns"],
    moved_area: Bool[np.ndarray, "rows columns"],
) -> Samples:
    """Displacements of features that are mutual best matches and agree with their neighbours.

    Parameters
    ----------
    rest, moved : (rows, columns) uint8
    rest_area, moved_area : (rows, columns) bool    where features may lie

    Returns
    -------
    Samples     empty if there is no texture or no displacements agree
    """
    point, descriptors = _features(rest, rest_area, 1)
    other, other_descriptors = _features(moved, moved_area, _SECOND_FACTOR)
    if not (len(point) and len(other)):
        return Samples(np.zeros((0, 2)), np.zeros((0, 2)))
    choice, mutual, _ = _nearest_descriptors(descriptors, other_descriptors)
    point, displacement = point[mutual], other[choice[mutual]] - point[mutual]
    agree = _agreeing(point, displacement)
    return Samples(point[agree], displacement[agree])


def _features(
    picture: UInt8[np.ndarray, "rows columns"], area: Bool[np.ndarray, "rows columns"], times: int
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 128"]]:
    """Positions and descriptors of the strongest features of an area, evenly distributed."""
    nothing = np.zeros((0, 2)), np.zeros((0, 128), dtype=np.float32)
    if not area.any():
        return nothing
    row, column = np.flatnonzero(area.any(axis=1)), np.flatnonzero(area.any(axis=0))
    corner = np.array([max(column[0] - _MARGIN, 0), max(row[0] - _MARGIN, 0)])
    crop = picture[corner[1] : row[-1] + _MARGIN + 1, corner[0] : column[-1] + _MARGIN + 1]
    crop = np.ascontiguousarray(crop)
    # Half of OpenCV's threshold: contrast has been normalised, and agreement is tested later.
    sift = cv2.SIFT.create(contrastThreshold=0.02)
    keys = sift.detect(crop, None)
    if not keys:
        return nothing
    point = np.array(cv2.KeyPoint.convert(keys), dtype=np.float64) + corner
    pixel = np.minimum(np.rint(point).astype(np.int64), np.array(area.shape[::-1]) - 1)
    keep = np.flatnonzero(area[pixel[:, 1], pixel[:, 0]])
    strength = np.array([key.response for key in keys])
    limit = times * min(max(int(area.sum()) // _PIXELS_EACH, _MIN_FEATURES), _MAX_FLOW_FEATURES)
    keep = keep[_spread(point[keep], strength[keep], limit)]
    if not len(keep):
        return nothing
    # `compute` may drop features; it returns the remaining ones with their descriptors.
    described, descriptors = sift.compute(crop, [keys[int(i)] for i in keep])
    return np.array(cv2.KeyPoint.convert(described), dtype=np.float64) + corner, descriptors


def _spread(
    point: Float[np.ndarray, "n 2"], strength: Float[np.ndarray, " n"], limit: int
) -> np.ndarray:
    """Indices of each cell's strongest point, then each cell's second strongest, up to `limit`."""
    cell = (point // _CELL).astype(np.int64) @ np.array([1, 1 << 20])
    order = np.lexsort((-strength, cell))
    rank = np.arange(len(order)) - np.searchsorted(cell[order], cell[order])
    return order[np.argsort(rank, kind="stable")][:limit]


def _agreeing(
    point: Float[np.ndarray, "n 2"], displacement: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, " n"]:
    """True for displacements confirmed by at least three of their eight nearest neighbours.

    The end point of a wrong match is random within the picture, so the probability that three
    neighbours 30 px away agree with it is below 1e-5.
    """
    if len(point) < 4:
        return np.zeros(len(point), dtype=bool)
    distance, index = cKDTree(point).query(point, min(9, len(point)))
    gap = ((displacement[index[:, 1:]] - displacement[:, None]) ** 2).sum(axis=2)
    return (gap < (_MAX_GAP_PX + _MAX_SLOPE * distance[:, 1:]) ** 2).sum(axis=1) >= 3


def nodes(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the nodes between which a motion is interpolated.

    Parameters
    ----------
    shape : (rows, columns) [px]    of the picture

    Returns
    -------
    row, column : two (_, _) int [px]   16 px apart, the first at 8
    """
    row, column = np.mgrid[_SPACING // 2 : shape[0] : _SPACING, _SPACING // 2 : shape[1] : _SPACING]
    return row, column


def interpolated(samples: Samples, shape: tuple[int, int]) -> Float[np.ndarray, "rows columns 2"]:
    """Motion of every pixel from scattered samples: fitted at nodes, bilinear between them.

    At each node an affine motion is fitted robustly to the nearest dozen samples, so that at a
    discontinuity one side wins. Far from all samples the fit extrapolates.

    Parameters
    ----------
    samples : Samples               one or more
    shape : (rows, columns)

    Returns
    -------
    (rows, columns, 2) float32 [px]
    """
    row, column = nodes(shape)
    node = np.stack([column.ravel(), row.ravel()], axis=1).astype(np.float64)
    motion = _fitted(samples, node).reshape(*row.shape, 2).astype(np.float32)
    # Constant beyond the outermost nodes.
    position = np.empty((*shape, 2), dtype=np.float32)
    position[..., 0] = (np.arange(shape[1], dtype=np.float32) - _SPACING // 2) / _SPACING
    position[..., 1] = ((np.arange(shape[0], dtype=np.float32) - _SPACING // 2) / _SPACING)[:, None]
    return sampled(motion, position)


def sampled(
    values: Float[np.ndarray, "_ _ *k"], position: Float[np.ndarray, "rows columns 2"]
) -> Float[np.ndarray, "rows columns *k"]:
    """Bilinear interpolation between pixels; beyond the picture, the value at its edge.

    Parameters
    ----------
    values : (_, _) or (_, _, k) float32    of any unit
    position : (rows, columns, 2) float32 [px]  column and row

    Returns
    -------
    (rows, columns) or (rows, columns, k) float32
    """
    return cv2.remap(values, position, NOT_GIVEN, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _fitted(samples: Samples, node: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k 2"]:
    """Motion at the nodes, by robust affine fits to the nearest samples."""
    count = min(_SAMPLES, len(samples.point))
    distance, index = cKDTree(samples.point).query(node, np.arange(1, count + 1))
    reach = np.maximum(distance[:, count // 2], 0.5 * _SPACING)[:, None]
    near = np.exp(-0.5 * (distance / reach) ** 2)
    offset = (samples.point[index] - node[:, None]) / reach[..., None]
    terms = np.concatenate([np.ones((*offset.shape[:2], 1)), offset], axis=2)
    wanted = samples.displacement[index]
    # A slight ridge on the slope, for collinear samples.
    ridge = np.diag([1e-6, 0.002, 0.002])
    weight = near
    for _ in range(4):
        weighted = (terms * weight[..., None]).swapaxes(1, 2)
        normal = weighted @ terms + ridge * weight.sum(axis=1)[:, None, None]
        fitted = np.linalg.solve(normal, weighted @ wanted)
        gap = ((wanted - terms @ fitted) ** 2).sum(axis=2)
        weight = near / (1.0 + gap / _MAX_GAP_PX**2) ** 2  # Geman and McClure's robust weight
    return fitted[:, 0]


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Features of one picture.

    Attributes
    ----------
    point : (n, 2) float [px]       column, row
    descriptor : (n, 128) float32   whole numbers from 0 to 255
    """

    point: Float[np.ndarray, "n 2"]
    descriptor: Float[np.ndarray, "n 128"]


def find_features(picture: NormalisedImage) -> Features:
    """Find the strongest features of a picture.

    Parameters
    ----------
    picture : NormalisedImage

    Returns
    -------
    Features                        empty if there is no texture

    Source
    ------
    Lowe (2004), in OpenCV's implementation.
    """
    grey: np.ndarray = picture.levels
    area: np.ndarray = picture.textured.astype(np.uint8)
    scale = 1
    while grey.size > _MAX_PIXELS:
        size = (grey.shape[1] // 2, grey.shape[0] // 2)
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        area = cv2.resize(area, size, interpolation=cv2.INTER_NEAREST)
        scale *= 2
    sift = cv2.SIFT.create(
        nfeatures=_MAX_FEATURES, contrastThreshold=_MIN_CONTRAST, enable_precise_upscale=True
    )
    keys, descriptor = sift.detectAndCompute(grey, area)
    if not keys:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), dtype=np.float32))
    point = np.array(cv2.KeyPoint.convert(keys), dtype=np.float64)
    return Features((point + 0.5) * scale - 0.5, descriptor)


def match_features(first: Features, second: Features) -> Samples:
    """Pairs of features that are mutual nearest neighbours and pass the ratio test.

    Parameters
    ----------
    first, second : Features

    Returns
    -------
    Samples                         from the first to the second, accurate to half a pixel; about
                                    one in a hundred may be wrong

    Source
    ------
    Lowe (2004), section 7.1: the ratio test.
    """
    if len(first.point) < 2 or len(second.point) < 2:
        return Samples(np.zeros((0, 2)), np.zeros((0, 2)))
    choice, mutual, distance = _nearest_descriptors(first.descriptor, second.descriptor)
    row = np.arange(len(choice))
    nearest = distance[row, choice]
    distance[row, choice] = np.inf
    good = mutual & (nearest < _MAX_RATIO**2 * distance.min(axis=1))
    return Samples(first.point[good], second.point[choice[good]] - first.point[good])


def _nearest_descriptors(
    first: Float[np.ndarray, "n 128"], second: Float[np.ndarray, "m 128"]
) -> tuple[Int[np.ndarray, " n"], Bool[np.ndarray, " n"], Float[np.ndarray, "n m"]]:
    """Nearest neighbour of each descriptor in a second set.

    Parameters
    ----------
    first, second : (n, 128), (m, 128) float32      whole numbers from 0 to 255; one or more each

    Returns
    -------
    choice : (n,) int               index of the nearest in the second set
    mutual : (n,) bool              whether each is also the nearest to its choice
    distance : (n, m) float32       squared distances
    """
    # All sums of squares stay below 2^24, so they are exact in any order. For thousands of features
    # the matrix takes 100 MB, so it is modified in place.
    distance = first @ second.T
    distance *= -2.0
    distance += (first**2).sum(axis=1)[:, None]
    distance += (second**2).sum(axis=1)
    choice, row = distance.argmin(axis=1), np.arange(len(distance))
    # The minimum of each column is cheap; its index would take twenty times as long.
    nearest = distance[row, choice] == distance.min(axis=0)[choice]
    earliest = np.full(distance.shape[1], len(row))
    np.minimum.at(earliest, choice[nearest], row[nearest])
    return choice, nearest & (earliest[choice] == row), distance


@dataclass(frozen=True, slots=True, eq=False)
class PreparedPictures:
    """Pictures of one instant, with their normalised versions and features.

    Attributes
    ----------
    rig : Rig                       c cameras
    grey : tuple of c (rows, columns) float [grey levels]   in the rig's order
    normalised : tuple of c NormalisedImage
    features : tuple of c Features
    """

    rig: Rig
    grey: tuple[Float[np.ndarray, "_rows _columns"], ...]
    normalised: tuple[NormalisedImage, ...]
    features: tuple[Features, ...]


def prepare_pictures(rig: Rig, pictures: Sequence[Float[np.ndarray, "_ _"]]) -> PreparedPictures:
    """Normalise the pictures of one instant and find their features.

    Parameters
    ----------
    rig : Rig                       c cameras
    pictures : sequence of c (rows, columns) float [grey levels]    in the rig's order, finite

    Returns
    -------
    PreparedPictures

    Raises
    ------
    InputError                      the number of pictures differs from that of the cameras
    """
    if len(pictures) != len(rig.cameras):
        raise InputError(f"{len(pictures)} pictures for {len(rig.cameras)} cameras; give one each")
    normalised = tuple(make_normalised_image(picture) for picture in pictures)
    features = tuple(find_features(image) for image in normalised)
    return PreparedPictures(rig, tuple(pictures), normalised, features)

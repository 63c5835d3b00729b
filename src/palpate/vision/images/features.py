"""Feature matches between the pictures of several cameras, without using their calibration.

Source: Lowe, Distinctive image features from scale-invariant keypoints, IJCV 60(2), 2004: the
features, and the ratio test, which on speckle patterns leaves about one wrong match in a hundred.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.errors import InputError
from palpate.records import Rig
from palpate.vision.images.normalisation import NormalisedImage, make_normalised_image

# Larger pictures are halved: a speckle of two pixels is then still a feature.
_MAX_PIXELS = 2_500_000
# Number of strongest features compared: about a thousand of them are matched.
_MAX_FEATURES = 4000
# Half of OpenCV's threshold: contrast has been normalised, and the ratio test follows.
_MIN_CONTRAST = 0.02
# Largest ratio of the nearest to the second-nearest descriptor distance: Lowe's value.
_MAX_RATIO = 0.8


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


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Positions of matched features in two pictures.

    Attributes
    ----------
    first, second : (n, 2) float [px]   column, row
    """

    first: Float[np.ndarray, "n 2"]
    second: Float[np.ndarray, "n 2"]

    def chosen(self, rows: np.ndarray) -> "Matches":
        """Select some of the matches.

        Parameters
        ----------
        rows : (k,) int or (n,) bool    indices or flags

        Returns
        -------
        Matches
        """
        return Matches(self.first[rows], self.second[rows])


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


def match_features(first: Features, second: Features) -> Matches:
    """Pairs of features that are mutual nearest neighbours and pass the ratio test.

    Parameters
    ----------
    first, second : Features

    Returns
    -------
    Matches                         accurate to half a pixel; about one in a hundred may be wrong

    Source
    ------
    Lowe (2004), section 7.1: the ratio test.
    """
    if len(first.point) < 2 or len(second.point) < 2:
        return Matches(np.zeros((0, 2)), np.zeros((0, 2)))
    choice, mutual, distance = nearest_descriptors(first.descriptor, second.descriptor)
    row = np.arange(len(choice))
    nearest = distance[row, choice]
    distance[row, choice] = np.inf
    good = mutual & (nearest < _MAX_RATIO**2 * distance.min(axis=1))
    return Matches(first.point[good], second.point[choice[good]])


def nearest_descriptors(
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

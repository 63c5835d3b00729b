"""Pictures of one instant as the rig check and stereo matching need them: made once for both."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.records import Rig
from palpate.vision.images import (
    Features,
    NormalisedImage,
    find_features,
    make_normalised_image,
)


@dataclass(frozen=True, slots=True, eq=False)
class PreparedPictures:
    """Pictures of one instant, normalised, with their features.

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
    InputError                      another number of pictures than cameras
    """
    if len(pictures) != len(rig.cameras):
        raise InputError(f"{len(pictures)} pictures for {len(rig.cameras)} cameras; give one each")
    normalised = tuple(make_normalised_image(picture) for picture in pictures)
    features = tuple(find_features(image) for image in normalised)
    return PreparedPictures(rig, tuple(pictures), normalised, features)
